"""Summary of each command: its likeliest behavior in the world that it describes (section 3.3).

The behavior model infers behaviors among objects. Before any has been observed, the world consists
of the mentioned objects, related as stated. What the model infers in it is shown to people as what
the robot has understood of its commands: action, mode, goal and constraints.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxlangnav.grounding.behavior import CompiledClause, infer_behavior
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
from jaxlangnav.relations.table import SYMBOL_OF

_MIN_GOAL_PROB = 0.05
"""Probability below which a command has no goal, and the next one no previous goal."""
_MIN_CONSTRAINT_PROB = 0.5  # probability below which a constraint is not listed
_NUM_SLOTS = 9
"""Slots of a world, eight objects and the robot, so that one compiled program serves all."""


@dataclasses.dataclass(frozen=True)
class CommandSummary:
    """Likeliest meaning of one command; mentions are of the likeliest reading, NONE for none."""

    action: str  # of messages.ACTIONS
    mode: str  # of messages.MODES
    region: int  # goal region of the mention, index into messages.REGIONS
    mention: int
    probability: float  # of action, mode and goal together
    avoid: tuple[tuple[int, int, float], ...]  # region, mention, probability
    landmarks: tuple[int, ...] = ()  # landmarks of the goal, and their landmarks
    metres: float = 0.0  # from the mention to the goal, as stated; 0: not stated


@cached_jit()
def _infer_once(clause: CompiledClause, world: BehaviorWorld) -> Behavior:
    return infer_behavior(clause, world, num_phrases=clause.num_phrases)


def summarize_commands(instruction: Instruction) -> list[CommandSummary]:
    """Infer each command's likeliest meaning in the world of the likeliest reading, in order."""
    readings = jax.tree.map(np.asarray, instruction.readings)
    reading = int(np.argmax(readings.log_probability))
    slots, world = _described_world(readings, reading)
    summaries = []
    for index, behavior in enumerate(infer_commands(instruction, world)):
        goal, constraint = behavior.goal, behavior.constraint
        region, slot = np.unravel_index(int(goal.argmax()), goal.shape)
        action, mode = int(behavior.action.argmax()), int(behavior.mode.argmax())
        prob = float(goal[region, slot])
        mention = slots[slot] if prob >= _MIN_GOAL_PROB else NONE
        summary = CommandSummary(
            action=ACTIONS[action],
            mode=MODES[mode],
            region=int(region),
            mention=mention,
            probability=prob * float(behavior.action[action]) * float(behavior.mode[mode]),
            avoid=tuple(
                (int(r), slots[s], float(constraint[r, s]))
                for r, s in np.argwhere(constraint >= _MIN_CONSTRAINT_PROB)
            ),
            landmarks=_connected_mentions(readings, reading, mention),
            metres=float(instruction.metres[index]),
        )
        summaries.append(summary)
    return summaries


def infer_commands(instruction: Instruction, world: World) -> list[Behavior]:
    """Infer the behavior of each command in a fully known world.

    One behavior per command, NumPy leaves of n + 1 slots, the robot's last; "the other one"
    excludes the likeliest goal of the previous command.
    """
    size, behaviors = len(world.object_type), []
    # Padded like any other world, so that one compiled program serves them all.
    num_slots = max(_NUM_SLOTS, size)
    slots = np.append(np.arange(size - 1), num_slots - 1)
    clauses = jax.tree.map(np.asarray, instruction.clauses)
    for index in range(int(instruction.num_clauses)):
        clause = jax.tree.map(lambda leaf, i=index: leaf[i], clauses)
        behavior = jax.device_get(_infer_once(clause, to_device(world, num_slots)))
        goal, constraint = behavior.goal[:, slots], behavior.constraint[:, slots]
        behaviors.append(dataclasses.replace(behavior, goal=goal, constraint=constraint))
        best = goal.max(axis=0)
        is_previous = (np.arange(size) == best.argmax()) & (best.max() >= _MIN_GOAL_PROB)
        world = dataclasses.replace(world, is_previous=is_previous)
    return behaviors


def list_commands(instruction: Instruction, names: Sequence[str]) -> list[dict[str, Any]]:
    """List each command's likeliest meaning as JSON objects, as ``ground --json`` prints them.

    Args:
        instruction: the grounded sentence.
        names: object types by index.

    Returns:
        One dict per command: ``action``, ``mode``, ``goal`` (``region``, ``object``: "stop sign or
        exit sign" where a noun may be either; None if it is no mention: "the other cone"),
        ``probability``, and ``avoid``, a list of ``region``, ``object``, ``probability``.
    """
    readings = jax.tree.map(np.asarray, instruction.readings)
    best = int(np.argmax(readings.log_probability))
    edges = np.stack([readings.edges(k) for k in range(len(readings.log_probability))])
    # Readings that differ in the types alone: a noun with several labels has one for each.
    is_alike = np.isclose(readings.log_probability, readings.log_probability[best])
    types = readings.mention_type[is_alike & (edges == edges[best]).all(axis=(1, 2))]

    def target(region: int, mention: int) -> dict[str, str]:
        codes = [ROBOT] if mention == ROBOT else dict.fromkeys(types[:, mention].tolist())
        nouns = ("robot" if code == ROBOT else name_of(code, names) for code in codes)
        return {"region": REGIONS[region], "object": " or ".join(nouns)}

    return [
        {
            "action": command.action,
            "mode": command.mode,
            "goal": None if command.mention == NONE else target(command.region, command.mention),
            "probability": command.probability,
            "avoid": [
                {**target(region, mention), "probability": prob}
                for region, mention, prob in command.avoid
            ],
        }
        for command in summarize_commands(instruction)
    ]


def _described_world(readings: Readings, reading: int) -> tuple[list[int], World]:
    """Build the world that a reading describes, and list each slot's mention; the robot is last."""
    types = readings.mention_type[reading]
    mentions, robots = (np.flatnonzero(mask).tolist() for mask in (types >= 0, types == ROBOT))
    slot_of = {mention: slot for slot, mention in enumerate(mentions)}
    slot_of |= dict.fromkeys(robots, len(mentions))
    edges = [
        (rank, SYMBOL_OF[relation], slot_of[figure], slot_of[landmark])
        for figure, relation, landmark, rank in readings.edges(reading).tolist()
        if relation != NONE
    ]
    # The behavior model has one table beyond the first rank, of the one that is meant.
    ranked = [(min(rank, 2) - 1, *edge) for rank, *edge in edges if rank > 0]
    world = World.of_edges([*types[mentions], ROBOT], [edge for _, *edge in edges], ranked)
    return [*mentions, robots[0] if robots else ROBOT], world


def _connected_mentions(readings: Readings, reading: int, mention: int) -> tuple[int, ...]:
    """List the mentions that relations connect to one, transitively, but not through the robot."""
    all_edges = readings.edges(reading)
    edges = all_edges[all_edges[:, 1] != NONE][:, [0, 2]].tolist()
    edges = [edge for edge in edges if ROBOT not in readings.mention_type[reading][edge]]
    reached = {mention}
    for _ in edges:
        reached |= {end for edge in edges if reached & set(edge) for end in edge}
    return tuple(sorted(reached - {mention}))
