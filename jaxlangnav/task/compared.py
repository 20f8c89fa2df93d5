"""What a label means against what the trained graph makes of its sentence (section 4.1).

They agree where the sentence says of the world what its label says, and where each of its commands
asks for the same, nothing asked twice: that is tried in a world made of the things of the label,
which are related as the label has it, and of one more of each type of which something is said,
which is not.
"""

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import jax
import numpy as np

from jaxlangnav.grounding.asked import infer_once
from jaxlangnav.grounding.behavior_features import World
from jaxlangnav.grounding.form import FormRelation
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.grounding.symbols import NUM_RELATIONS
from jaxlangnav.grounding.worlds import to_device
from jaxlangnav.kinds import noun_of
from jaxlangnav.messages import (
    ACTIONS,
    MODES,
    NEAR,
    NONE,
    REGIONS,
    ROBOT,
    relation_name,
)
from jaxlangnav.relations.table import CONVERSE, NUM_RANKS
from jaxlangnav.task.labelled import Meaning
from jaxlangnav.world.scenario import NUM_SLOTS

_LEAST = 0.05
"""Goals less probable than this are not meant."""
_ALIKE = 0.8
"""Goals of at least this share of the best one's probability fit as well."""
_EXACT = 0.01
"""Metres by which a distance may differ from the label's, which may leave it out."""
Relation = tuple[str, str, str, int]
"""Types of figure and landmark around the relation's name, and the rank."""


class Understood(Protocol):
    """What was understood, and the object types that it speaks of."""

    @property
    def instruction(self) -> Instruction:
        """For the navigator."""
        ...

    @property
    def type_names(self) -> tuple[str, ...]:
        """Object types by index."""
        ...


@dataclasses.dataclass(frozen=True)
class _Asked:
    """What one command asks for in a world."""

    action: int
    mode: int
    ends: frozenset[tuple[int, int]]  # region and slot of each goal that fits as well as any
    avoided: frozenset[int]
    metres: float  # from its landmark, where they are told
    frame: tuple[float, ...]  # from where it is meant, in the robot's frame


def difference(meaning: Meaning, understood: Understood) -> str:
    """Say how a sentence differs from what it means.

    Args:
        meaning: of its label.
        understood: what is made of it.

    Returns:
        What differs first, in one line; empty where nothing does.
    """
    meaning = _as_said(meaning, understood)
    return _difference_in_world(meaning, understood) or _difference_in_commands(meaning, understood)


def _as_said(meaning: Meaning, understood: Understood) -> Meaning:
    """Turn round what is said the other way round: a tree behind a cone, a cone before a tree."""
    _, said = _said(understood)

    def turned(one: FormRelation) -> FormRelation:
        if one.rank or one.landmark == ROBOT:
            return one
        other = FormRelation(one.landmark, CONVERSE[one.relation], one.figure, 0)
        own, instead = (_named(meaning, it) for it in (one, other))
        return other if instead in said and own not in said else one

    relations = tuple(turned(one) for one in meaning.reading.relations)
    return dataclasses.replace(
        meaning, reading=dataclasses.replace(meaning.reading, relations=relations)
    )


def _named(meaning: Meaning, one: FormRelation) -> Relation:
    """Write a relation with the names of its types."""
    figure, landmark = (
        "robot" if thing == ROBOT else meaning.type_of(thing)
        for thing in (one.figure, one.landmark)
    )
    return figure, relation_name(one.relation, one.rank), landmark, max(one.rank, 0)


def _difference_in_world(meaning: Meaning, understood: Understood) -> str:
    """Say how what is said of the world differs; empty where it does not."""
    types, relations = _said(understood)
    names = {meaning.type_of(thing) for thing in range(len(meaning.reading.types))}
    if types != names:
        return f"speaks of {_listed(types)}, not of {_listed(names)}"

    meant = {_named(meaning, one) for one in meaning.reading.relations}
    if relations != meant:
        return f"says {_listed(map(_worded, relations))}, not {_listed(map(_worded, meant))}"
    return ""


def _said(understood: Understood) -> tuple[set[str], set[Relation]]:
    """Collect the types and relations of the likeliest reading."""
    fields = understood.instruction.readings
    kinds = np.asarray(fields.mention_type[0])

    def name(mention: int) -> str:
        kind = kinds[mention]
        return "robot" if kind == ROBOT else noun_of(kind, understood.type_names)

    columns = (fields.figure, fields.relation, fields.landmark, fields.rank)
    edges = np.stack([np.asarray(column[0]) for column in columns], axis=1)
    relations = {
        (name(figure), relation_name(relation, rank), name(landmark), max(int(rank), 0))
        for figure, relation, landmark, rank in edges
        if relation != NONE
    }
    return {noun_of(kind, understood.type_names) for kind in kinds if kind >= 0}, relations


def _worded(relation: Relation) -> str:
    """Write a relation: "cone near car, rank 1"."""
    figure, name, landmark, rank = relation
    return f"{figure} {name} {landmark}" + (f", rank {rank}" if rank else "")


def _listed(parts: Any) -> str:
    """Write some names in one order."""
    return "; ".join(sorted(parts)) or "nothing"


def _difference_in_commands(meaning: Meaning, understood: Understood) -> str:
    """Say how what is asked for differs; empty where it does not."""
    try:
        kinds = [understood.type_names.index(meaning.type_of(one)) for one in _slots(meaning)]
    except ValueError:
        return "speaks of other types"
    world = _world(meaning, kinds)
    asked = _asked(understood.instruction, world)
    if len(asked) != len(meaning.reading.commands):
        return f"gives {len(asked)} commands, not {len(meaning.reading.commands)}"
    whys = (_difference(meaning, index, one, world) for index, one in enumerate(asked))
    return next((f"command {i} {why}" for i, why in enumerate(whys, start=1) if why), "")


def _asked(instruction: Instruction, world: World) -> list[_Asked]:
    """Infer what each command asks for; one that asks for what is done already is left out."""
    found: list[_Asked] = []
    size = len(world.object_type)
    num_slots = max(NUM_SLOTS + 1, size)
    slots = np.append(np.arange(size - 1), num_slots - 1)
    for clause in range(int(instruction.num_clauses)):
        program = jax.tree.map(
            lambda leaf, index=clause: np.asarray(leaf)[index], instruction.program
        )
        behavior = jax.device_get(infer_once(program, to_device(world, num_slots)))
        goal, kept_out = behavior.goal[:, slots], behavior.constraint[:, slots]
        least = max(_LEAST, _ALIKE * float(goal.max()))
        asked = _Asked(
            action=int(behavior.action.argmax()),
            mode=int(behavior.mode.argmax()),
            ends=frozenset((int(r), int(slot)) for r, slot in np.argwhere(goal >= least)),
            avoided=frozenset(int(slot) for slot in np.nonzero(kept_out.max(axis=0) > 0.5)[0]),
            metres=float(instruction.metres[clause]),
            frame=tuple(np.asarray(instruction.frame)[clause].tolist()),
        )
        if not found or asked != found[-1]:
            found.append(asked)
        previous = np.arange(size) == int(goal.max(axis=0).argmax())
        world = dataclasses.replace(world, is_previous=previous)
    return found


def _slots(meaning: Meaning) -> list[int]:
    """List whose type each slot has: each thing, and another one of it if something is said."""
    figures = dict.fromkeys(meaning.reading.types[one.figure] for one in meaning.reading.relations)
    return [*range(len(meaning.reading.types)), *map(meaning.reading.types.index, figures)]


def _world(meaning: Meaning, kinds: Sequence[int]) -> World:
    """Build a world in which exactly what the label says holds; the robot has the last slot."""
    size = len(kinds) + 1
    is_related = np.zeros((NUM_RELATIONS, size, size), bool)
    is_ranked = np.zeros((NUM_RANKS, NUM_RELATIONS, size, size), bool)
    for one in meaning.reading.relations:
        landmark = size - 1 if one.landmark == ROBOT else one.landmark
        if one.rank <= 0 or one.relation == NEAR:
            is_related[one.relation, one.figure, landmark] = True
        if one.rank > 0:
            # The device has one table of later ranks: whichever the sentence means.
            is_ranked[min(one.rank, 2) - 1, one.relation, one.figure, landmark] = True
    return World(
        object_type=np.array([*kinds, ROBOT], np.int32),
        is_object=np.ones(size, bool),
        is_related=is_related,
        is_ranked=is_ranked,
        is_previous=np.zeros(size, bool),
    )


def _difference(meaning: Meaning, index: int, asked: _Asked, world: World) -> str:
    """Say how one command differs; empty where it does not."""
    wanted = meaning.reading.commands[index]
    for names, given, meant in (
        (ACTIONS, asked.action, wanted.action),
        (MODES, asked.mode, wanted.mode),
    ):
        if given != meant:
            return f"asks for {names[given]}, not {names[meant]}"
    thing = len(world.object_type) - 1 if wanted.thing == ROBOT else wanted.thing
    alike = {(wanted.region, slot) for slot in _fitting(meaning, wanted.thing, world)}
    if (wanted.region, thing) not in asked.ends or not asked.ends <= alike:
        ends, end = (_ends(one, meaning, world) for one in (asked.ends, {(wanted.region, thing)}))
        return f"ends {ends}, not {end}"
    if wanted.metres and abs(asked.metres - wanted.metres) > _EXACT:
        return f"goes {asked.metres:.3g} m, not {wanted.metres:.3g} m"
    meant = {slot for one in wanted.avoid for slot in _fitting(meaning, one, world)}
    if asked.avoided != meant:
        return f"keeps away from {len(asked.avoided)} things, not {len(meant)}"
    return ""


def _fitting(meaning: Meaning, thing: int, world: World) -> set[int]:
    """Find the slots that fit all that the label says of a thing."""
    last = len(world.object_type) - 1
    if thing == ROBOT:
        return {last}
    fitting = world.object_type == world.object_type[thing]
    for one in meaning.reading.relations:
        if one.figure != thing:
            continue
        landmark = last if one.landmark == ROBOT else one.landmark
        holds = world.is_ranked[min(one.rank, 2) - 1] if one.rank > 0 else world.is_related
        fitting = fitting & holds[one.relation, :, landmark]
    return {int(slot) for slot in np.nonzero(fitting)[0]}


def _ends(ends: Iterable[tuple[int, int]], meaning: Meaning, world: World) -> str:
    """Write goals: region and slot, with its type."""
    written = []
    for region, slot in sorted(ends):
        is_robot = slot == len(world.object_type) - 1
        kind = "robot" if is_robot else meaning.type_of(_slots(meaning)[slot])
        written.append(f"{REGIONS[region]} {kind} ({slot})")
    return ", ".join(written) or "nowhere"
