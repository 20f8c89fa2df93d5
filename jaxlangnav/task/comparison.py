"""Comparison of a grounded sentence with its labelled meaning (section 4.1).

The label is grounded directly from its form. The two agree if they have the same types and
relations, and if their commands infer the same behaviors, repeated commands left out. Behaviors are
compared in a world of the label's objects, related as the label says, with an unrelated distractor
of the type of each figure.
"""

import dataclasses
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from jaxlangnav.grounding.annotated import form_instruction
from jaxlangnav.grounding.command_summary import infer_commands
from jaxlangnav.grounding.form import Form, FormReading
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.grounding.worlds import World
from jaxlangnav.inputs.object_types import noun_of
from jaxlangnav.messages import ACTIONS, MODES, NEAR, NONE, REGIONS, ROBOT
from jaxlangnav.relations.table import REGISTRY, SYMBOL_OF
from jaxlangnav.task.labelled import MIN_MEANT_PROB, TIE_RATIO, Meaning

_TOLERANCE = 0.01
"""Tolerance of a distance against the label's, metres; a label may leave it out."""


class _Behavior(NamedTuple):
    """Behavior that one command infers in a world."""

    action: str
    mode: str
    goals: frozenset[tuple[int, int]]  # region and slot of each goal tied with the best
    avoided: frozenset[int]
    metres: float  # stated distance from the landmark
    frame: tuple[float, ...]  # viewpoint of the command, in the robot's frame


def difference(meaning: Meaning, instruction: Instruction, names: tuple[str, ...]) -> str:
    """Describe the first difference between an instruction and its label; empty if none."""
    try:
        types = tuple(names.index(meaning.type_names[code]) for code in meaning.reading.types)
    except ValueError:
        return "speaks of other types"
    reading = dataclasses.replace(meaning.reading, types=types)
    label = form_instruction(Form((reading,), ()))
    for actual, expected in zip(_content(instruction, names), _content(label, names), strict=True):
        if actual != expected:
            return f"says {_join(actual)}, not {_join(expected)}"
    world = _world(reading)
    inferred, labelled = _behaviors(instruction, world), _behaviors(label, world)
    if len(inferred) != len(labelled):
        return f"gives {len(inferred)} commands, not {len(labelled)}"
    for index, pair in enumerate(zip(inferred, labelled, strict=True), start=1):
        if text := _compare(*pair, world, names):
            return f"command {index} {text}"
    return ""


def _compare(actual: _Behavior, expected: _Behavior, world: World, names: tuple[str, ...]) -> str:
    """Describe the first difference between the behaviors of a command; empty if none."""

    def classes(goals: Iterable[tuple[int, int]]) -> set[tuple[Any, ...]]:
        """Group goals into classes of objects with the same type and relations."""
        types, related, ranked = world.object_type, world.is_related, world.is_ranked
        return {
            (region, types[slot], related[:, slot].tobytes(), ranked[:, :, slot].tobytes())
            for region, slot in goals
        }

    for value, label in ((actual.action, expected.action), (actual.mode, expected.mode)):
        if value != label:
            return f"asks for {value}, not {label}"
    if not actual.goals or not classes(actual.goals) <= classes(expected.goals):
        nouns = [noun_of(index, names) if index >= 0 else "robot" for index in world.object_type]
        actual_ends, expected_ends = (
            ", ".join(f"{REGIONS[region]} {nouns[slot]} ({slot})" for region, slot in sorted(goals))
            for goals in (actual.goals, expected.goals)
        )
        return f"ends {actual_ends or 'nowhere'}, not {expected_ends}"
    if expected.metres and abs(actual.metres - expected.metres) > _TOLERANCE:
        return f"goes {actual.metres:.3g} m, not {expected.metres:.3g} m"
    if actual.avoided != expected.avoided:
        return f"keeps away from {len(actual.avoided)} things, not {len(expected.avoided)}"
    return ""


def _content(instruction: Instruction, names: tuple[str, ...]) -> tuple[set[str], set[str]]:
    """Collect the types and relations of the most probable interpretation."""
    readings = instruction.readings
    types = np.asarray(readings.mention_type[0])

    def name(mention: int) -> str:
        return "robot" if types[mention] == ROBOT else noun_of(types[mention], names)

    relations = set()
    for figure, relation, landmark, rank in readings.edges():
        if relation == NONE:
            continue
        first, second = name(figure), name(landmark)
        converse = REGISTRY[relation].converse
        # Canonical order: "tree behind cone" and "cone in front of tree" are the same relation.
        if second < first and not rank and "robot" not in (first, second) and converse is not None:
            first, relation, second = second, converse, first
        suffix = f", rank {rank}" if rank else ""
        relations.add(f"{first} {REGISTRY[relation].name} {second}{suffix}")
    return {noun_of(index, names) for index in types if index >= 0}, relations


def _join(parts: Iterable[str]) -> str:
    return "; ".join(sorted(parts)) or "nothing"


def _behaviors(instruction: Instruction, world: World) -> list[_Behavior]:
    """Infer the behavior of each command; a repetition of the previous one is left out."""
    behaviors: list[_Behavior] = []
    for clause, behavior in enumerate(infer_commands(instruction, world)):
        goal = behavior.goal
        limit = max(MIN_MEANT_PROB, TIE_RATIO * float(goal.max()))
        current = _Behavior(
            action=ACTIONS[int(behavior.action.argmax())],
            mode=MODES[int(behavior.mode.argmax())],
            goals=frozenset((region, slot) for region, slot in np.argwhere(goal >= limit).tolist()),
            avoided=frozenset(np.flatnonzero(behavior.constraint.max(axis=0) > 0.5).tolist()),
            metres=float(instruction.metres[clause]),
            frame=tuple(np.asarray(instruction.frame)[clause].tolist()),
        )
        if not behaviors or current != behaviors[-1]:
            behaviors.append(current)
    return behaviors


def _world(reading: FormReading) -> World:
    """Build a world in which exactly the label's relations hold; the robot has the last slot."""
    # The label's objects, then one distractor of the type of each figure.
    figures = dict.fromkeys(reading.types[edge.figure] for edge in reading.relations)
    types, related, ranked = [*reading.types, *figures], [], []
    for figure, relation, landmark, rank in reading.relations:
        edge = SYMBOL_OF[relation], figure, len(types) if landmark == ROBOT else landmark
        converse = REGISTRY[relation].converse
        if rank == 0 or relation == NEAR:
            related.append(edge)
        if rank > 0:  # all ranks above 1 share one table
            ranked.append((min(rank, 2) - 1, *edge))
        elif converse is not None and landmark != ROBOT:
            related.append((SYMBOL_OF[converse], landmark, figure))
    return World.of_edges([*types, ROBOT], related, ranked)
