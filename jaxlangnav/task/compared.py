"""What a label means against what the trained graph makes of its sentence (section 4.1).

They agree where the sentence says of the world what its label says, and where each of its commands
asks for the same, nothing asked twice. That is tried in a world of the label's things, related as
the label has it, and of one more of each type of which something is said, which is not.
"""

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from jaxlangnav.grounding.asked import infer_commands
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.grounding.readings import Relation
from jaxlangnav.grounding.worlds import World
from jaxlangnav.inputs.object_types import noun_of
from jaxlangnav.messages import ACTIONS, MODES, NEAR, NONE, REGIONS, ROBOT
from jaxlangnav.relations.table import REGISTRY, SYMBOL
from jaxlangnav.task.labelled import ALIKE, LEAST, Meaning

_EXACT = 0.01
"""Metres by which a distance may differ from the label's, which may leave it out."""
NamedRelation = tuple[str, str, str, int]
"""Types of figure and landmark around the relation's name, and the rank."""


@dataclasses.dataclass(frozen=True)
class _Asked:
    """What one command asks for in a world."""

    action: int
    mode: int
    ends: frozenset[tuple[int, int]]  # region and slot of each goal that fits as well as any
    avoided: frozenset[int]
    metres: float  # from its landmark, where they are told
    frame: tuple[float, ...]  # from where it is meant, in the robot's frame


def difference(meaning: Meaning, instruction: Instruction, names: tuple[str, ...]) -> str:
    """Say how an instruction differs first from what its label means; empty where nothing does."""
    types, relations = _said(instruction, names)

    def turned(one: Relation) -> Relation:
        """Turn round what is said the other way round: a tree behind a cone, a cone before it."""
        converse = REGISTRY[one.relation].converse
        if one.rank or one.landmark == ROBOT or converse is None:
            return one
        other = Relation(one.landmark, converse, one.figure, 0)
        own, instead = (_named(meaning, it) for it in (one, other))
        return other if instead in relations and own not in relations else one

    reading = meaning.reading
    reading = dataclasses.replace(reading, relations=tuple(map(turned, reading.relations)))
    meaning = dataclasses.replace(meaning, reading=reading)
    own_types = {meaning.type_of(thing) for thing in range(len(reading.types))}
    if types != own_types:
        return f"speaks of {_listed(types)}, not of {_listed(own_types)}"
    meant = {_named(meaning, one) for one in reading.relations}
    if relations != meant:
        said, wanted = (
            _listed(
                f"{figure} {name} {landmark}" + (f", rank {rank}" if rank else "")
                for figure, name, landmark, rank in some
            )
            for some in (relations, meant)
        )
        return f"says {said}, not {wanted}"
    try:
        kinds = [names.index(meaning.type_of(one)) for one in _slots(meaning)]
    except ValueError:
        return "speaks of other types"
    world = _world(meaning, kinds)
    asked = _asked(instruction, world)
    if len(asked) != len(reading.commands):
        return f"gives {len(asked)} commands, not {len(reading.commands)}"
    whys = (_difference(meaning, index, one, world) for index, one in enumerate(asked))
    return next((f"command {i} {why}" for i, why in enumerate(whys, start=1) if why), "")


def _named(meaning: Meaning, one: Relation) -> NamedRelation:
    figure, landmark = (
        "robot" if thing == ROBOT else meaning.type_of(thing)
        for thing in (one.figure, one.landmark)
    )
    return figure, REGISTRY[one.relation].name, landmark, one.rank


def _said(instruction: Instruction, names: tuple[str, ...]) -> tuple[set[str], set[NamedRelation]]:
    """Collect the types and relations of the likeliest reading."""
    fields = instruction.readings
    kinds = np.asarray(fields.mention_type[0])

    def name(mention: int) -> str:
        kind = kinds[mention]
        return "robot" if kind == ROBOT else noun_of(kind, names)

    relations = {
        (name(figure), REGISTRY[relation].name, name(landmark), int(rank))
        for figure, relation, landmark, rank in fields.edges()
        if relation != NONE
    }
    return {noun_of(kind, names) for kind in kinds if kind >= 0}, relations


def _listed(parts: Iterable[str]) -> str:
    return "; ".join(sorted(parts)) or "nothing"


def _asked(instruction: Instruction, world: World) -> list[_Asked]:
    """Infer what each command asks for; one that asks for what is done already is left out."""
    found: list[_Asked] = []
    for clause, behavior in enumerate(infer_commands(instruction, world)):
        goal = behavior.goal
        least = max(LEAST, ALIKE * float(goal.max()))
        asked = _Asked(
            action=int(behavior.action.argmax()),
            mode=int(behavior.mode.argmax()),
            ends=frozenset((region, slot) for region, slot in np.argwhere(goal >= least).tolist()),
            avoided=frozenset(np.flatnonzero(behavior.constraint.max(axis=0) > 0.5).tolist()),
            metres=float(instruction.metres[clause]),
            frame=tuple(np.asarray(instruction.frame)[clause].tolist()),
        )
        if not found or asked != found[-1]:
            found.append(asked)
    return found


def _slots(meaning: Meaning) -> list[int]:
    """List whose type each slot has: each thing, and another one of it if something is said."""
    figures = dict.fromkeys(meaning.reading.types[one.figure] for one in meaning.reading.relations)
    return [*range(len(meaning.reading.types)), *map(meaning.reading.types.index, figures)]


def _world(meaning: Meaning, kinds: Sequence[int]) -> World:
    """Build a world in which exactly what the label says holds; the robot has the last slot."""
    last = len(kinds)
    edges = [
        (rank, SYMBOL[relation], figure, last if landmark == ROBOT else landmark)
        for figure, relation, landmark, rank in meaning.reading.relations
    ]
    related = [edge for rank, *edge in edges if rank == 0 or edge[0] == NEAR]
    # The device has one table of later ranks: whichever the sentence means.
    ranked = [(min(rank, 2) - 1, *edge) for rank, *edge in edges if rank > 0]
    return World.of_edges([*kinds, ROBOT], related, ranked)


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
        if one.figure == thing:
            landmark = last if one.landmark == ROBOT else one.landmark
            holds = world.is_ranked[min(one.rank, 2) - 1] if one.rank > 0 else world.is_related
            fitting = fitting & holds[SYMBOL[one.relation], :, landmark]
    return set(np.flatnonzero(fitting).tolist())


def _ends(ends: Iterable[tuple[int, int]], meaning: Meaning, world: World) -> str:
    kinds = [*map(meaning.type_of, _slots(meaning)), "robot"]
    return (
        ", ".join(f"{REGIONS[region]} {kinds[s]} ({s})" for region, s in sorted(ends)) or "nowhere"
    )
