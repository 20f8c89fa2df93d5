"""What a sentence asks for, in a world that is just as it says (section 3.3).

The behavior model infers what is asked for among objects. Before any has been seen there are those
that the sentence speaks of, placed as it places them. What the model infers among these is what the
robot has understood of its commands: action, manner, goal, and what to keep away from.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxlangnav.grounding.behavior import BehaviorProgram, infer_behavior
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.grounding.worlds import World, to_device
from jaxlangnav.inputs.object_types import name_of
from jaxlangnav.inputs.program_cache import cached_jit
from jaxlangnav.messages import (
    ACTIONS,
    MODES,
    NONE,
    REGIONS,
    ROBOT,
    Behavior,
    BehaviorWorld,
    Readings,
)
from jaxlangnav.relations.table import NUM_RANKS

_LEAST_PREVIOUS_GOAL = 0.05
"""A goal less probable than this is none: the command after it has no previous goal."""
_LEAST_KEPT = 0.5
"""What is to be kept away from with less probability than this is not told."""
_SLOTS = 9
"""Those of a world of eight objects and the robot, so that one compiled program serves all."""


@dataclasses.dataclass(frozen=True)
class Asked:
    """What one command asks for; mentions are those of the likeliest reading, NONE for nothing."""

    action: str  # of messages.ACTIONS
    mode: str  # of messages.MODES
    region: int  # index into messages.REGIONS: where at the mention it ends
    mention: int
    probability: float  # of action, mode and goal together
    avoid: tuple[tuple[int, int, float], ...]  # region, mention, probability
    against: tuple[int, ...] = ()  # mentions that the goal is placed against, and theirs


@cached_jit()
def _infer_once(program: BehaviorProgram, world: BehaviorWorld) -> Behavior:
    return infer_behavior(program, world, num_phrases=program.num_phrases)


def asked(instruction: Instruction) -> list[Asked]:
    """Tell what each command asks for, in order, in a world as the likeliest reading says."""
    readings = jax.tree.map(np.asarray, instruction.readings)
    best = int(np.argmax(readings.log_probability))
    slots, world = _as_said(readings, best)
    found = []
    for behavior in infer_commands(instruction, world):
        goal, constraint = behavior.goal, behavior.constraint
        region, slot = np.unravel_index(int(goal.argmax()), goal.shape)
        action, mode = int(behavior.action.argmax()), int(behavior.mode.argmax())
        share = float(goal[region, slot])
        mention = slots[slot] if share >= _LEAST_PREVIOUS_GOAL else NONE
        one = Asked(
            action=ACTIONS[action],
            mode=MODES[mode],
            region=int(region),
            mention=mention,
            probability=share * float(behavior.action[action]) * float(behavior.mode[mode]),
            avoid=tuple(
                (int(where), slots[kept], float(constraint[where, kept]))
                for where, kept in np.argwhere(constraint >= _LEAST_KEPT)
            ),
            against=_tied(readings, best, mention),
        )
        found.append(one)
    return found


def infer_commands(instruction: Instruction, world: World) -> list[Behavior]:
    """Infer what each command asks for in a world of which everything is known.

    One behavior a command, NumPy leaves of n + 1 slots, the robot's last; "the other one" is other
    than the likeliest goal of the command before it.
    """
    size, found = len(world.object_type), []
    # Padded like any other world, so that one compiled program serves them all.
    num_slots = max(_SLOTS, size)
    slots = np.append(np.arange(size - 1), num_slots - 1)
    programs = jax.tree.map(np.asarray, instruction.program)
    for clause in range(int(instruction.num_clauses)):
        program = jax.tree.map(lambda leaf, index=clause: leaf[index], programs)
        behavior = jax.device_get(_infer_once(program, to_device(world, num_slots)))
        goal, constraint = behavior.goal[:, slots], behavior.constraint[:, slots]
        found.append(dataclasses.replace(behavior, goal=goal, constraint=constraint))
        best = goal.max(axis=0)
        is_previous = (np.arange(size) == best.argmax()) & (best.max() >= _LEAST_PREVIOUS_GOAL)
        world = dataclasses.replace(world, is_previous=is_previous)
    return found


def list_commands(instruction: Instruction, names: Sequence[str]) -> list[dict[str, Any]]:
    """Describe what each command asks for, as ``ground --json`` prints it.

    Args:
        instruction: the grounded sentence.
        names: object types by index.

    Returns:
        A command each, in order: ``action``, ``mode``, ``goal`` (``region``, ``object``; None where
        it is another one than before), ``probability``, and ``avoid``, a list of ``region``,
        ``object``, ``probability``.
    """
    readings = jax.tree.map(np.asarray, instruction.readings)
    kinds = readings.mention_type[int(np.argmax(readings.log_probability))]

    def place(region: int, mention: int) -> dict[str, str]:
        kind = ROBOT if mention == ROBOT else int(kinds[mention])
        return {
            "region": REGIONS[region],
            "object": "robot" if kind == ROBOT else name_of(kind, names),
        }

    return [
        {
            "action": one.action,
            "mode": one.mode,
            "goal": None if one.mention == NONE else place(one.region, one.mention),
            "probability": one.probability,
            "avoid": [
                {**place(region, mention), "probability": share}
                for region, mention, share in one.avoid
            ],
        }
        for one in asked(instruction)
    ]


def _as_said(readings: Readings, best: int) -> tuple[list[int], World]:
    """Build the world of a reading: the mention of each slot, and the things; the robot is last."""
    kinds = readings.mention_type[best]
    things, robots = (np.flatnonzero(of).tolist() for of in (kinds >= 0, kinds == ROBOT))
    slot_of = {mention: slot for slot, mention in enumerate(things)}
    slot_of |= dict.fromkeys(robots, len(things))
    edges = [
        (rank, relation, slot_of[figure], slot_of[landmark])
        for figure, relation, landmark, rank in readings.edges(best).tolist()
        if relation != NONE
    ]
    ranked = [(min(rank, NUM_RANKS) - 1, *edge) for rank, *edge in edges if rank > 0]
    world = World.of_edges([*kinds[things], ROBOT], [edge for _, *edge in edges], ranked)
    return [*things, robots[0] if robots else ROBOT], world


def _tied(readings: Readings, best: int, mention: int) -> tuple[int, ...]:
    """List the mentions that relations tie to one, through others too; the robot ties nothing."""
    told = readings.edges(best)
    edges = told[told[:, 1] != NONE][:, [0, 2]].tolist()
    edges = [edge for edge in edges if ROBOT not in readings.mention_type[best][edge]]
    tied = {mention}
    for _ in edges:
        tied |= {end for edge in edges if tied & set(edge) for end in edge}
    return tuple(sorted(tied - {mention}))
