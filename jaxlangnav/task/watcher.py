"""A simulated person at hand in ``follow``: the law of ``world.person``, put into words."""

import dataclasses
from collections.abc import Sequence

import jax
from jax import Array

from jaxlangnav.episode import EpisodeState
from jaxlangnav.experiments.watched import seen_of
from jaxlangnav.kept import kept
from jaxlangnav.listening import Candidate
from jaxlangnav.world.person import (
    PERSONS,
    Person,
    PersonParams,
    Says,
    params_of,
    say,
    unspoken,
)

_SPEECH = 31
"""Folded into the episode's key for the person; beyond the steps' own splits of it."""
_PLACES = ("the first", "the second", "the third")


@kept()
def _say(
    progress: EpisodeState, person: Person, params: PersonParams
) -> tuple[Person, Array, Array]:
    """Decide what to say, compiled."""
    key = jax.random.fold_in(jax.random.fold_in(progress.task.key, _SPEECH), _SPEECH)
    seen = seen_of(progress.navigator, progress.steps)
    return say(key, person, seen, progress.task.scenario, params=params)


@dataclasses.dataclass
class Watcher:
    """A person who watches the robot in one episode."""

    params: PersonParams
    person: Person = dataclasses.field(default_factory=unspoken)
    _step: int = -1

    @classmethod
    def named(cls, name: str) -> "Watcher":
        """Call one of ``PERSONS``."""
        return cls(jax.device_put(params_of(**PERSONS[name])))

    def is_there(self, progress: EpisodeState) -> bool:
        """Tell whether the person will yet speak, if things stay as they are."""
        return bool(_say(progress, self.person, self.params)[0].intends)

    def speak(self, step: int, progress: EpisodeState, doubt: Sequence[Candidate]) -> str | None:
        """Say what the law has the person say, once before each decision."""
        if step == self._step:
            return None
        self._step = step
        self.person, said, slot = _say(progress, self.person, self.params)
        if int(said) == Says.OTHER:
            return "no, the other one"
        if int(said) == Says.NONE_OF_THEM:
            return "no"
        if int(said) == Says.THIS:
            return _pointing(int(slot), doubt)
        return None


def _pointing(slot: int, doubt: Sequence[Candidate]) -> str | None:
    """Name a candidate by its place in the list, the nearest first; None beyond words for it."""
    place = next((at for at, one in enumerate(doubt) if one.slot == slot), len(_PLACES))
    if place < len(_PLACES):
        return _PLACES[place]
    return "the farthest" if doubt and doubt[-1].slot == slot else None
