"""From labelled instructions to training examples of the log-linear model (section 4.1).

Training is teacher-forced: the groundings of child phrases are the gold ones. One example of the
paper is one factor, (phrase, symbol); one of ours is a phrase with the factors of its symbols.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from jaxlangnav.grounding import behavior_features as bf
from jaxlangnav.grounding.features import senses_of
from jaxlangnav.grounding.graph import Node, bottom_up
from jaxlangnav.grounding.properties import (
    KIND_OF,
    Path,
    annotation_properties,
    behavior_properties,
    child_groundings,
    ranks_meant,
)
from jaxlangnav.grounding.symbols import (
    Annotation,
    AnnotationSpace,
    BehaviorSpace,
    BehaviorSymbol,
)
from jaxlangnav.language.phrase import Parse, Phrase
from jaxlangnav.relations.table import NUM_RANKS


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
class PhraseExample:
    """One phrase with the factors of its symbols."""

    phrase: Phrase
    rows: Mapping[str, Rows]  # kind → factors
    instruction: int  # which instruction it comes from


def annotation_examples(
    instructions: Sequence[LabelledInstruction], type_names: tuple[str, ...]
) -> list[PhraseExample]:
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


def _annotation_example(
    index: int,
    labelled: LabelledInstruction,
    nodes: tuple[Node, ...],
    node: Node,
    space: AnnotationSpace,
    type_names: tuple[str, ...],
) -> PhraseExample:
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
    return PhraseExample(node.phrase, rows, index)


def behavior_examples(
    instructions: Sequence[LabelledInstruction], type_names: tuple[str, ...]
) -> list[PhraseExample]:
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
) -> PhraseExample:
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
    return PhraseExample(node.phrase, rows, index)
