"""Candidates of a clarification question, and the one that an answer selects."""

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
_RANKS: dict[Wording | None, int] = {Wording[name]: n for n, name in enumerate(_ORDINALS)}
_RANKS |= {Wording.NEAREST: 0, Wording.FARTHEST: -1, Wording.LAST: -1}
_MIN_READING_PROB = 1e-3  # minimum probability of an interpretation whose types are listed
_MIN_GOAL_PROB = 0.01  # minimum goal probability of a candidate

_in_map = jax.jit(to_map_frame)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Candidate:
    """An observed object that may be the goal."""

    slot: int  # observed slot
    type_name: str  # of its object type, for people
    x: float  # metres, map frame
    y: float
    probability: float  # that it is the goal


def candidates(state: NavigatorState, names: Sequence[str]) -> list[Candidate]:
    """List the observed objects that may be the goal, the nearest first."""
    prob, pose = np.asarray(state.talk.candidate), believed_pose(state)
    items = [object_at(state, int(slot), names) for slot in np.flatnonzero(prob >= _MIN_GOAL_PROB)]
    return sorted(items, key=lambda item: np.hypot(item.x - pose[0], item.y - pose[1]))


def object_at(state: NavigatorState, slot: int, names: Sequence[str]) -> Candidate:
    """Describe the object in an observed slot of the belief; ``names`` are of object types."""
    particles = state.belief.particles
    weight = np.exp(np.asarray(state.belief.log_weight))
    weight = weight * (np.asarray(particles.object_type)[slot] != NONE)
    total = max(float(weight.sum()), 1e-9)
    return Candidate(
        slot=slot,
        type_name=name_of(type_at(state, slot), names),
        x=float((weight * np.asarray(particles.mean_x)[slot]).sum() / total),
        y=float((weight * np.asarray(particles.mean_y)[slot]).sum() / total),
        probability=float(np.asarray(state.talk.candidate)[slot]),
    )


def select_candidate(
    wording: Wording | None, options: Sequence[Candidate], pose: np.ndarray
) -> Candidate | None:
    """Resolve an answer to a candidate; None if it names none."""
    if not options:
        return None
    if wording == Wording.YES:
        return options[0] if len(options) == 1 else None
    if wording in _RANKS:
        rank = _RANKS[wording]
        return options[rank] if rank < len(options) else None
    heading = float(pose[2])

    def leftward(item: Candidate) -> float:
        return (item.y - pose[1]) * np.cos(heading) - (item.x - pose[0]) * np.sin(heading)

    return (max if wording == Wording.LEFT else min)(options, key=leftward)


def type_at(state: NavigatorState, slot: int) -> int:
    """Look up the type of an observed slot in the particle of highest weight."""
    best = int(np.argmax(np.asarray(state.belief.log_weight)))
    return int(np.asarray(state.belief.particles.object_type)[slot, best])


def believed_pose(state: NavigatorState) -> np.ndarray:
    """Compute the robot pose, f32[3], map frame."""
    return np.asarray(_in_map(state.belief, state.belief.last_pose))


def mentioned_types(state: NavigatorState) -> list[int]:
    """List the object types that probable interpretations mention, each once."""
    readings = state.instruction.readings
    is_probable = np.asarray(readings.log_probability) >= np.log(_MIN_READING_PROB)
    types = np.asarray(readings.mention_type)[is_probable].reshape(-1).tolist()
    return [index for index in dict.fromkeys(types) if index >= 0]


def unseen_types(state: NavigatorState) -> list[int]:
    """List the types that the task mentions and that no particle has observed."""
    readings, is_asked = state.instruction.readings, np.asarray(state.talk.words.is_asked)
    mentioned = np.where(is_asked, np.asarray(readings.mention_type), NONE)
    types = np.asarray(state.belief.particles.object_type)
    return missing_types(replace(readings, mention_type=mentioned), types)
