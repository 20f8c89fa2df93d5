"""Labelled instructions, and the training examples that they give (section 4.1).

Training is teacher-forced: the groundings of child phrases are the gold ones. One example of the
paper is one factor, (phrase, symbol); one of ours is a phrase with the factors of its symbols.
"""

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxlangnav.grounding.correspondence import RANK, AnyWorld, Labelled, SymbolSpace
from jaxlangnav.grounding.properties import Annotations, Behaviors
from jaxlangnav.grounding.symbols import (
    KINDS,
    Annotation,
    BehaviorSymbol,
    Path,
    bottom_up,
    object_symbol,
    region_symbol,
    relation_symbol,
)
from jaxlangnav.grounding.worlds import World, place
from jaxlangnav.language.corpus import Example
from jaxlangnav.language.phrase import COMMAND, Parse, Phrase
from jaxlangnav.messages import ACTIONS, MODES, NONE, REGIONS, RELATIONS, ROBOT


@dataclasses.dataclass(frozen=True)
class LabelledInstruction:
    """An instruction with gold groundings of every phrase."""

    parse: Parse
    annotation: Mapping[Path, frozenset[Annotation]]
    rank: Mapping[Path, int]  # phrases that say "nearest" have 1, "second" 2; others 0 or absent
    worlds: tuple[World, ...] = ()
    behavior: tuple[Mapping[Path, frozenset[BehaviorSymbol]], ...] = ()  # one per world

    def annotated(self) -> Iterator[Labelled[None]]:
        """Yield the trees of its clauses with their annotations."""
        for clause, root in enumerate(self.parse.clauses):
            paths = [node.path for node in bottom_up(root, clause)]
            yield Labelled(
                root=root,
                world=None,
                expressed=[self.annotation[path] for path in paths],
                ranks=[self.rank.get(path, 0) for path in paths],
                clause=clause,
            )

    def behaving(self) -> Iterator[Labelled[World]]:
        """Yield the trees of its commands in every world."""
        for world, gold in zip(self.worlds, self.behavior, strict=True):
            for clause, root in enumerate(self.parse.clauses):
                if (clause,) in gold:
                    expressed = [gold[node.path] for node in bottom_up(root, clause)]
                    yield Labelled(root=root, world=world, expressed=expressed, clause=clause)


def read_annotation(text: str, type_names: tuple[str, ...]) -> Annotation:
    """Read an annotation symbol such as ``relation(hydrant,behind,cone)``."""

    def index(name: str) -> int:
        return ROBOT if name == "robot" else type_names.index(name)

    match re.split(r"[(,)]", text)[:-1]:
        case ["object", figure]:
            return object_symbol(index(figure))
        case ["region", relation, landmark]:
            return region_symbol(RELATIONS.index(relation), index(landmark))
        case [_, figure, relation, landmark]:
            return relation_symbol(index(figure), RELATIONS.index(relation), index(landmark))
    raise ValueError(f"'{text}' is no annotation")


def read_behavior(text: str, num_objects: int) -> BehaviorSymbol:
    """Read a behavior symbol such as ``goal(at,3)``; the robot's slot comes after the objects."""
    name, first, *rest = re.split(r"[(,)]", text)[:-1]
    kind = KINDS.index(name)
    if name in ("action", "mode"):
        names = ACTIONS if name == "action" else MODES
        return BehaviorSymbol(kind, NONE, names.index(first))
    slot = rest[0] if rest else first
    region = REGIONS.index(first) if rest else NONE
    return BehaviorSymbol(kind, region, num_objects if slot == "robot" else int(slot))


def labelled_instruction(example: Example, type_names: tuple[str, ...]) -> LabelledInstruction:
    """Turn an example of a corpus into training data; statements have no behavior."""
    paths = [[n.path for n in bottom_up(root, c)] for c, root in enumerate(example.parse.clauses)]
    annotation, rank = {}, {}
    for clause, labels in zip(paths, example.clauses, strict=True):
        for path, symbols, own in zip(clause, labels.annotation, labels.rank, strict=True):
            annotation[path] = frozenset(read_annotation(text, type_names) for text in symbols)
            rank[path] = own
    behaviors = []
    for labelled in example.worlds:
        count, behavior = len(labelled.world.objects), {}
        clauses = zip(paths, labelled.behavior, example.parse.kinds, strict=True)
        for clause, labels, kind in clauses:
            for path, symbols in zip(clause, labels, strict=True) if kind == COMMAND else ():
                behavior[path] = frozenset(read_behavior(text, count) for text in symbols)
        behaviors.append(behavior)
    worlds = tuple(place(labelled.world, type_names) for labelled in example.worlds)
    return LabelledInstruction(example.parse, annotation, rank, worlds, tuple(behaviors))


def read_examples(
    examples: Sequence[Example], type_names: tuple[str, ...]
) -> list[LabelledInstruction]:
    """Turn a corpus into training data; see ``labelled_instruction``."""
    return [labelled_instruction(example, type_names) for example in examples]


class Rows(NamedTuple):
    """Factors of one kind of symbol of one phrase."""

    properties: np.ndarray  # f32[S, F]
    labels: np.ndarray  # bool[S]


@dataclasses.dataclass(frozen=True)
class PhraseExample:
    """One phrase with the factors of its symbols."""

    phrase: Phrase
    rows: Mapping[str, Rows]  # kind → factors
    instruction: int  # which instruction it comes from


def examples_of(
    space: SymbolSpace[AnyWorld], labelled: Sequence[Labelled[AnyWorld]]
) -> list[PhraseExample]:
    """Build the training examples of trees: of every phrase, given the labels of its children.

    Each tree counts as an instruction.

    Raises:
        ValueError: a label is no symbol of its world, or the numbers of labels or properties are
            wrong; the message says in which tree.
    """
    return [
        example
        for index, one in enumerate(labelled)
        for example in _tree_examples(space, one, index)
    ]


def _tree_examples(
    space: SymbolSpace[AnyWorld], one: Labelled[AnyWorld], instruction: int
) -> Iterator[PhraseExample]:
    """Build the examples of one tree."""
    nodes, symbols = bottom_up(one.root, one.clause), space.symbols_in(one.world)
    ranks = one.ranks or [0] * len(nodes)
    for labels in (one.expressed, ranks):
        if len(labels) != len(nodes):
            raise ValueError(
                f"tree {instruction}: {len(labels)} labels, but {one.root} has {len(nodes)} phrases"
            )
    unknown = sorted(set().union(*one.expressed) - set(symbols.index))
    if unknown:
        raise ValueError(f"tree {instruction}: {unknown[0]} is no symbol of its world")
    gold = [symbols.mask(expressed) for expressed in one.expressed]
    for node, expressed, rank in zip(nodes, gold, ranks, strict=True):
        described = space.describe(node.phrase, node.path, one.world)
        blocks = described.given([gold[child] for child in node.children])
        rows = {
            kind: Rows(np.asarray(block.properties, np.float32), expressed[block.places])
            for kind, block in blocks.items()
        }
        if described.ranks is not None:
            own = np.arange(1, len(described.ranks) + 1) == rank
            rows[RANK] = Rows(np.asarray(described.ranks, np.float32), own)
        for kind, (properties, labels) in rows.items():
            wanted = len(labels), len(space.columns[kind])
            if properties.shape != wanted:
                raise ValueError(
                    f"tree {instruction}: properties are {properties.shape}, but must be {wanted}"
                )
        yield PhraseExample(node.phrase, rows, instruction)


def annotation_examples(
    instructions: Sequence[LabelledInstruction], type_names: tuple[str, ...]
) -> list[PhraseExample]:
    """Build the examples of the annotation model, one per phrase."""
    space = Annotations(type_names)
    return [
        example
        for index, labelled in enumerate(instructions)
        for tree in labelled.annotated()
        for example in _tree_examples(space, tree, index)
    ]


def behavior_examples(
    instructions: Sequence[LabelledInstruction], type_names: tuple[str, ...]
) -> list[PhraseExample]:
    """Build the examples of the behavior model, one per phrase and world, empty slots left out."""
    return [
        example
        for index, labelled in enumerate(instructions)
        for tree in labelled.behaving()
        for example in _tree_examples(Behaviors(type_names, labelled.rank), tree, index)
    ]
