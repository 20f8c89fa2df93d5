"""What is said to a robot while an episode runs: by step, by a person at hand, by a simulated one.

The ear of ``recorder.play`` holds every utterance against the state as it then is, and keeps what
it was taken for and what it changed. What the state refuses is kept too: the robot goes on with
what it was at.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.dialogue import first_words
from jaxlangnav.episode import EpisodeState
from jaxlangnav.episode.recording import Recording, Remark, StaticScene
from jaxlangnav.experiments.dialogue import speak
from jaxlangnav.grounding import Context, Grounder
from jaxlangnav.grounding.asked import summarize_commands
from jaxlangnav.grounding.grounder import names_of
from jaxlangnav.grounding.instruction import Instruction, Understanding
from jaxlangnav.grounding.readings import Capacity, widen
from jaxlangnav.inputs.object_types import ANYTHING
from jaxlangnav.inputs.program_cache import cached_jit
from jaxlangnav.inputs.sanitize import shorten
from jaxlangnav.language.halting import alarm_in, opening_of
from jaxlangnav.language.utterance import Kind, classify
from jaxlangnav.messages import NONE, Status
from jaxlangnav.navigator import NavigatorParams, NavigatorState
from jaxlangnav.navigator.candidates import Candidate, candidates, thing_at
from jaxlangnav.navigator.interpret import Listener
from jaxlangnav.pytree import replace
from jaxlangnav.world.person import PERSONS, Person, PersonParams, Says, params_of, unspoken

QUESTION_COST = 0.1
"""What a question costs, in probability of success, where questions are allowed."""
_PLACES = ("the first", "the second", "the third", "the fourth", "the fifth", "the sixth")
_WORDS = {int(Says.OTHER): "no, the other one", int(Says.NONE_OF_THEM): "no"}
_speak = cached_jit()(speak)


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
        return bool(_speak(progress, self.person, params=self.params)[0].intends)

    def speak(self, step: int, progress: EpisodeState, doubt: Sequence[Candidate]) -> str | None:
        """Say what the law has the person say, once before each decision."""
        if step == self._step:
            return None
        self._step = step
        self.person, said, slot = _speak(progress, self.person, params=self.params)
        if int(said) != Says.THIS:
            return _WORDS.get(int(said))
        return name_candidates(doubt).get(int(slot))


def name_candidates(doubt: Sequence[Candidate]) -> dict[int, str]:
    """Find words that answer which one is meant, by slot: its place, the nearest first."""
    slots = [one.slot for one in doubt]
    named = dict.fromkeys(slots[-1:], "the farthest")
    return named | dict(zip(slots, _PLACES, strict=False))


def allow_questions(params: NavigatorParams) -> NavigatorParams:
    """Give questions a finite cost where they have none yet."""
    if math.isfinite(float(params.planner.question_cost)):
        return params
    cost = jnp.float32(QUESTION_COST)
    return replace(params, planner=replace(params.planner, question_cost=cost))


CHANGE_WHAT_IS_MEANT = frozenset(
    {Kind.COMMAND, Kind.ADDITION, Kind.RETURN, Kind.CANCEL, Kind.CORRECTION, Kind.ANSWER}
)
"""Kinds of utterances after which the goal that a world was opened for need not be meant."""
YOU = "you"

Voice = Callable[[int, EpisodeState, Sequence[Candidate]], str | None]
"""Says something before a step, or nothing more: given the step, the episode, what may be meant."""
_MOST = 8
"""Utterances of one speaker that are heard before a step."""


def roomy(understood: Understanding) -> Understanding:
    """Make room in the arrays of a sentence for what else may be said."""
    told = understood.instruction
    wide = replace(told, readings=jax.device_put(widen(told.readings, Capacity())))
    return dataclasses.replace(understood, instruction=wide)


def check_words(grounder: Grounder, first: Understanding, text: str) -> None:
    """Refuse an utterance that no state of a robot would make understood that began with ``first``.

    Raises:
        ValueError: the words are not understood; one line.
    """
    said = classify(text)
    if said.kind is not None and not said.rest:
        return
    if said.wording is not None or classify(text, is_asked=True).wording is not None:
        return
    if opening_of(text) is not None or alarm_in(text, lambda words: False) is not None:
        return
    about = next((kind for kind in first.spoken.goals if kind not in (NONE, ANYTHING)), NONE)
    grounder.ground(said.rest, Context(is_under_way=True, about=about, is_at=about != NONE))


@dataclasses.dataclass(kw_only=True)
class Earshot:
    """The ear of an episode; ``said`` grows as it runs."""

    grounder: Grounder
    first: Understanding  # what the robot was told before the first step
    scene: StaticScene
    script: Mapping[int, Sequence[str]] = dataclasses.field(default_factory=dict)  # by step
    voices: Mapping[str, Voice] = dataclasses.field(default_factory=dict)  # who else may speak
    is_awaited: Callable[[EpisodeState], bool] = lambda progress: False
    """Whether somebody is there who may yet speak to a robot that stands still."""
    on_said: Callable[[Remark], object] = lambda said: None  # told of every utterance
    said: list[Remark] = dataclasses.field(default_factory=list)
    candidates: tuple[Candidate, ...] = ()  # what may be meant, after the last step that asked
    _step: int = 0

    def begin(self, progress: EpisodeState) -> EpisodeState:
        """Note what the first sentence speaks of, as later ones may refer to it."""
        words = first_words(self.first.instruction, self.first.spoken)
        navigator = progress.navigator
        talk = replace(navigator.talk, words=words)
        return replace(progress, navigator=replace(navigator, talk=talk))

    def hear(self, step: int, progress: EpisodeState) -> EpisodeState:
        """Take in what is said before the decision of a step."""
        self._step = step
        for text in self.script.get(step, ()):
            progress = self._take(step, progress, YOU, text)
        for name, voice in self.voices.items():
            for _ in range(_MOST):
                text = voice(step, progress, self._doubt(progress))
                if text is None:
                    break
                progress = self._take(step, progress, name, text)
        return progress

    def expects(self, progress: EpisodeState) -> bool:
        """Tell whether more may be said to a robot that stands still."""
        self.candidates = tuple(self._doubt(progress))
        is_scripted = any(step > self._step for step in self.script)
        return is_scripted or self.is_awaited(progress)

    def _doubt(self, progress: EpisodeState) -> list[Candidate]:
        state = progress.navigator
        is_asking = int(state.status) == Status.WHICH_ONE
        return candidates(state, names_of(self.grounder)) if is_asking else []

    def _take(self, step: int, progress: EpisodeState, speaker: str, text: str) -> EpisodeState:
        """Take in an utterance, or keep to the task where the state refuses it, and tell of it."""
        before, names = progress.navigator, names_of(self.grounder)
        try:
            after, heard = Listener(self.grounder).take(before, text)
        except ValueError as refusal:
            why = str(refusal).removeprefix(f"{shorten(text)!r}: ")
            line = " ".join(why.split()).rstrip(".")
            said = Remark(step=step, text=text, speaker=speaker, refusal=line)
        else:
            said = Remark(
                step=step,
                text=text,
                kind=str(heard.kind),
                speaker=speaker,
                ruled_out=tuple(thing_at(before, slot, names) for slot in heard.ruled_out),
                notes=heard.notes,
                scene=self._scene_of(before, after),
            )
            progress = replace(progress, navigator=after)
        self.said.append(said)
        self.on_said(said)
        return progress

    def _scene_of(self, before: NavigatorState, after: NavigatorState) -> StaticScene | None:
        """Set the scene anew where words have been joined with those before."""
        told: Instruction
        told, earlier = jax.device_get((after.instruction, before.instruction))
        if jax.tree.all(jax.tree.map(np.array_equal, told, earlier)):
            return None
        return dataclasses.replace(
            self.scene,
            readings=told.readings,
            num_clauses=int(told.num_clauses),
            asks=tuple(summarize_commands(told)),
            type_names=tuple(names_of(self.grounder)),
        )


def with_talk(recording: Recording, ear: Earshot) -> Recording:
    """Add to an episode what was said in it, by the ear that has heard it.

    What a person at hand has said may mean another goal than the one the world was opened for, so
    it cannot be judged then; a simulated person has that goal in mind.
    """
    is_else = any(one.speaker == YOU and one.kind in CHANGE_WHAT_IS_MEANT for one in ear.said)
    scene, result = recording.scene, recording.result
    if is_else and scene.is_judged:
        why = "what was said under way may mean another goal"
        scene = dataclasses.replace(scene, is_judged=False, unjudged=why)
        result = replace(result, is_success=np.asarray(False))
    return dataclasses.replace(
        recording,
        scene=scene,
        result=result,
        said=tuple(ear.said),
        candidates=ear.candidates if int(result.ending) == Status.WHICH_ONE else (),
    )
