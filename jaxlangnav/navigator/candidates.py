"""Candidates of a question: observed objects that may be the goal, and which an answer selects."""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np

from jaxlangnav.inputs.object_types import name_of
from jaxlangnav.language.utterance import Wording
from jaxlangnav.messages import NONE
from jaxlangnav.navigator.records import NavigatorState
from jaxlangnav.planner.termination import missing_types
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import to_map_frame

_ORDINALS = ("FIRST", "SECOND", "THIRD", "FOURTH", "FIFTH", "SIXTH")
_PLACES: dict[Wording | None, int] = {Wording[name]: n for n, name in enumerate(_ORDINALS)}
_PLACES |= {Wording.NEAREST: 0, Wording.FARTHEST: -1, Wording.LAST: -1}
_LEAST_MENTIONED = 1e-3  # probability of a reading below which its types are left out
_LEAST = 0.01  # goal probability below which a thing is no candidate for a question

_in_map = jax.jit(to_map_frame)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Candidate:
    """An object that may be meant, as a question names it."""

    slot: int  # observed slot
    type_name: str
    x: float  # metres, map frame
    y: float
    probability: float


def candidates(state: NavigatorState, names: Sequence[str]) -> list[Candidate]:
    """List the things seen that may be meant, the nearest first: what a question is about."""
    share, pose = np.asarray(state.talk.candidate), believed_pose(state)
    found = [thing_at(state, slot, names) for slot in np.flatnonzero(share >= _LEAST).tolist()]
    return sorted(found, key=lambda one: np.hypot(one.x - pose[0], one.y - pose[1]))


def thing_at(state: NavigatorState, slot: int, names: Sequence[str]) -> Candidate:
    """Describe the object in an observed slot of the belief; ``names`` are of object types."""
    particles = state.belief.particles
    weight = np.exp(np.asarray(state.belief.log_weight))
    own = weight * (np.asarray(particles.object_type)[slot] != NONE)
    total = max(float(own.sum()), 1e-9)
    return Candidate(
        slot=slot,
        type_name=name_of(type_at(state, slot), names),
        x=float((own * np.asarray(particles.mean_x)[slot]).sum() / total),
        y=float((own * np.asarray(particles.mean_y)[slot]).sum() / total),
        probability=float(np.asarray(state.talk.candidate)[slot]),
    )


def chosen_by(
    wording: Wording | None, found: Sequence[Candidate], pose: np.ndarray
) -> Candidate | None:
    """Resolve an answer to a candidate; None if it names none."""
    if not found:
        return None
    if wording == Wording.YES:
        return found[0] if len(found) == 1 else None
    if wording in _PLACES:
        place = _PLACES[wording]
        return found[place] if place < len(found) else None
    turn = float(pose[2])

    def leftward(one: Candidate) -> float:
        return (one.y - pose[1]) * np.cos(turn) - (one.x - pose[0]) * np.sin(turn)

    return (max if wording == Wording.LEFT else min)(found, key=leftward)


def type_at(state: NavigatorState, slot: int) -> int:
    """Look up the type of an observed slot in the particle of highest weight."""
    best = int(np.argmax(np.asarray(state.belief.log_weight)))
    return int(np.asarray(state.belief.particles.object_type)[slot, best])


def believed_pose(state: NavigatorState) -> np.ndarray:
    """Compute the believed robot pose, f32[3], map frame."""
    return np.asarray(_in_map(state.belief, state.belief.last_pose))


def mentioned_types(state: NavigatorState) -> list[int]:
    """List the types that the readings mention, each once; those of improbable readings not."""
    readings = state.instruction.readings
    is_probable = np.asarray(readings.log_probability) >= np.log(_LEAST_MENTIONED)
    kinds = np.asarray(readings.mention_type)[is_probable].reshape(-1).tolist()
    return [kind for kind in dict.fromkeys(kinds) if kind >= 0]


def unseen_types(state: NavigatorState) -> list[int]:
    """List the types that the task mentions and of which no particle has an observed object."""
    readings, is_asked = state.instruction.readings, np.asarray(state.talk.words.is_asked)
    mentioned = np.where(is_asked, np.asarray(readings.mention_type), NONE)
    types = np.asarray(state.belief.particles.object_type)
    return missing_types(replace(readings, mention_type=mentioned), types)
