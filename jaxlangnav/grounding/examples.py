"""From labelled instructions to training examples of the log-linear model (section 4.1).

Training is teacher-forced: the groundings of child phrases are the gold ones. One example of the
paper is one factor, (phrase, symbol); one of ours is a phrase with the factors of its symbols.
"""

import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from jaxlangnav.grounding import annotation_features as af
from jaxlangnav.grounding import behavior_features as bf
from jaxlangnav.grounding.behavior_properties import PROPERTY_NAMES
from jaxlangnav.grounding.features import RESTRICTORS, Senses, senses_of
from jaxlangnav.grounding.graph import Node, bottom_up
from jaxlangnav.grounding.symbols import (
    ACTION,
    CONSTRAINT,
    GOAL,
    MODE,
    NUM_REGIONS,
    OBJECT,
    REGION,
    Annotation,
    AnnotationSpace,
    BehaviorSpace,
    BehaviorSymbol,
)
from jaxlangnav.language.phrase import Parse, Phrase
from jaxlangnav.relations.table import NUM_RANKS

Path = tuple[int, ...]
"""Clause index, then child indices from the root of the clause."""


@dataclasses.dataclass(frozen=True)
class LabelledInstruction:
    """An instruction with gold groundings of every phrase."""

    parse: Parse
    annotation: Mapping[Path, frozenset[Annotation]]
    rank: Mapping[Path, int]  # phrases that say "nearest" have 1, "second" 2; others 0 or absent
    worlds: tuple[bf.World, ...] = ()
    behavior: tuple[Mapping[Path, frozenset[BehaviorSymbol]], ...] = ()  # one per world


@dataclasses.dataclass(frozen=True)
class Rows:
    """Factors of one kind of symbol of one phrase."""

    properties: np.ndarray  # f32[S, F]
    labels: np.ndarray  # bool[S]


@dataclasses.dataclass(frozen=True)
class Example:
    """One phrase with the factors of its symbols."""

    phrase: Phrase
    rows: Mapping[str, Rows]  # kind → factors
    instruction: int  # which instruction it comes from


def annotation_examples(
    instructions: Sequence[LabelledInstruction], type_names: tuple[str, ...]
) -> list[Example]:
    """Build the examples of the annotation model.

    Args:
        instructions: labelled instructions.
        type_names: object types in the order of their indices.

    Returns:
        One example per phrase.
    """
    space = AnnotationSpace(len(type_names))
    return [
        _annotation_example(index, labelled, nodes, node, space, type_names)
        for index, labelled in enumerate(instructions)
        for nodes in _clauses(labelled.parse)
        for node in nodes
    ]


def _clauses(parse: Parse) -> Iterable[tuple[Node, ...]]:
    """Order the phrases of each clause bottom-up."""
    return (bottom_up(root, clause) for clause, root in enumerate(parse.clauses))


def _annotation_tables(
    space: AnnotationSpace, senses: Senses, groundings: list[np.ndarray]
) -> dict[str, af.Table]:
    """Describe every annotation symbol of a phrase; arguments as ``annotation_properties``."""
    child = af.child_sets(space, groundings)
    expressed = np.zeros(space.size, bool)
    for grounding in groundings:
        expressed |= grounding
    tables = {
        "object": af.object_properties(space, senses, child),
        "region": af.region_properties(space, senses, child),
        "relation": af.relation_properties(space, senses, child),
    }
    shared = af.shared_properties(senses, expressed, len(groundings))
    return {"symbol": af.join_kinds(tables, shared), "rank": af.rank_properties(senses)}


def annotation_properties(
    space: AnnotationSpace, senses: Senses, groundings: list[np.ndarray]
) -> dict[str, np.ndarray]:
    """Describe every annotation symbol of a phrase.

    Args:
        space: annotation symbols.
        senses: of the phrase's words.
        groundings: bool[S] of each child phrase.

    Returns:
        "symbol" → f32[S, F], and "rank" → f32[4, F].
    """
    tables = _annotation_tables(space, senses, groundings)
    return {kind: table.values for kind, table in tables.items()}


@functools.cache
def property_names() -> Mapping[str, tuple[str, ...]]:
    """Name the columns of the weights of every kind of symbol; files of weights hold the names.

    Returns:
        Kind, of either model, → F names.
    """
    nothing = Senses(*[frozenset()] * 5, is_robot=False)
    tables = _annotation_tables(AnnotationSpace(1), nothing, [])
    own = {kind: table.names for kind, table in tables.items()}
    return MappingProxyType(own | PROPERTY_NAMES)


def _annotation_example(
    index: int,
    labelled: LabelledInstruction,
    nodes: tuple[Node, ...],
    node: Node,
    space: AnnotationSpace,
    type_names: tuple[str, ...],
) -> Example:
    """Build the example of one phrase."""
    gold = space.mask(labelled.annotation[node.path])
    children = [space.mask(labelled.annotation[nodes[child].path]) for child in node.children]
    senses = senses_of(node.phrase, type_names)
    labels = {
        "symbol": gold,
        "rank": np.arange(1, NUM_RANKS + 1) == labelled.rank.get(node.path, 0),
    }
    properties = annotation_properties(space, senses, children)
    rows = {kind: Rows(properties[kind], labels[kind]) for kind in properties}
    return Example(node.phrase, rows, index)


def child_groundings(
    world: bf.World,
    space: BehaviorSpace,
    children: Sequence[tuple[Phrase, np.ndarray, np.ndarray]],
) -> bf.ChildGroundings:
    """Join what the child phrases express in a world.

    Args:
        world: the world.
        space: its symbols.
        children: (phrase, bool[S] expressed, i[7] rank meant for each relation) each.

    Returns:
        Their groundings, as the properties need them.
    """
    num_objects = world.object_type.shape[0]
    objects = np.zeros(num_objects, bool)
    regions = np.zeros((NUM_REGIONS, num_objects), bool)
    constraints = np.zeros((NUM_REGIONS, num_objects), bool)
    lies = world.is_object.copy()
    is_restricted = False
    for phrase, expressed, rank in children:
        places = space.part(expressed, REGION) | space.part(expressed, GOAL)
        objects |= space.part(expressed, OBJECT)
        regions |= places
        constraints |= space.part(expressed, CONSTRAINT)
        if phrase.label in RESTRICTORS:
            lies &= bf.lies_in(world, places, rank)
            is_restricted = True
    return bf.ChildGroundings(objects, regions, constraints, lies, is_restricted, bool(children))


def behavior_properties(
    world: bf.World, is_verb: bool, senses: Senses, child: bf.ChildGroundings
) -> dict[str, np.ndarray]:
    """Describe every behavior symbol of a phrase.

    Args:
        world: the world.
        is_verb: whether the phrase grounds to actions, modes, goals and constraints.
        senses: of the phrase's words.
        child: groundings of its children.

    Returns:
        Kind → f32[symbols of the kind, F].
    """
    if is_verb:
        return {
            "goal": bf.goal_properties(world, senses, child),
            "constraint": bf.constraint_properties(world, senses, child),
            "action": bf.action_properties(senses),
            "mode": bf.mode_properties(senses),
        }
    return {
        "object": bf.object_properties(world, senses, child),
        "region": bf.region_properties(world, senses, child),
    }


KIND_OF = {
    "object": OBJECT,
    "region": REGION,
    "goal": GOAL,
    "constraint": CONSTRAINT,
    "action": ACTION,
    "mode": MODE,
}
"""Names of the weight blocks of the behavior model → kinds of symbol."""


def ranks_meant(
    phrase: Phrase, path: Path, rank: Mapping[Path, int], type_names: tuple[str, ...]
) -> np.ndarray:
    """Find for which relations a phrase means the extreme object, or the second, ... only.

    A phrase that passes on the region of a child ("that is nearest to the cone") passes on this.

    Args:
        phrase: the phrase.
        path: where it stands.
        rank: of each phrase, gold or inferred; absent is 0.
        type_names: object types.

    Returns:
        i[7], 0 where every object is meant.
    """
    meant = np.zeros(NUM_REGIONS, int)
    relations = sorted(senses_of(phrase, type_names).relations)
    if relations:  # what is below belongs to the landmark: "near the second cone"
        meant[relations] = rank.get(path, 0)
        return meant
    for i, child in enumerate(phrase.children):
        meant = np.maximum(meant, ranks_meant(child, (*path, i), rank, type_names))
    return meant


def behavior_examples(
    instructions: Sequence[LabelledInstruction], type_names: tuple[str, ...]
) -> list[Example]:
    """Build the examples of the behavior model; arguments as ``annotation_examples``.

    Returns:
        One example per phrase and world; symbols of empty object slots are left out.
    """
    return [
        _behavior_example(index, labelled, which, nodes, node, type_names)
        for index, labelled in enumerate(instructions)
        for which in range(len(labelled.worlds))
        for nodes in _clauses(labelled.parse)
        if nodes[-1].path in labelled.behavior[which]
        for node in nodes
    ]


def _behavior_example(
    index: int,
    labelled: LabelledInstruction,
    which: int,
    nodes: tuple[Node, ...],
    node: Node,
    type_names: tuple[str, ...],
) -> Example:
    """Build the example of one phrase in one world."""
    world, gold = labelled.worlds[which], labelled.behavior[which]
    space = BehaviorSpace(world.object_type.shape[0])

    children = [
        (
            nodes[i].phrase,
            space.mask(gold[nodes[i].path]),
            ranks_meant(nodes[i].phrase, nodes[i].path, labelled.rank, type_names),
        )
        for i in node.children
    ]
    properties = behavior_properties(
        world,
        node.is_verb,
        senses_of(node.phrase, type_names),
        child_groundings(world, space, children),
    )
    expressed = space.mask(gold[node.path])
    rows = {}
    for kind, table in properties.items():
        labels = space.part(expressed, KIND_OF[kind])
        real = np.ones(labels.shape, bool)
        if kind not in ("action", "mode"):
            real = np.broadcast_to(world.is_object, labels.shape)
        rows[kind] = Rows(table[real.ravel()], labels[real])
    return Example(node.phrase, rows, index)
