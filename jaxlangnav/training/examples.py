"""Labelled instructions, and the training examples that they give (section 4.1).

Training is teacher-forced: the groundings of child phrases are the gold ones. One example of the
paper is one factor, (phrase, symbol); one of ours is a phrase with the factors of its symbols.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxlangnav.grounding.correspondence import RANK, AnyWorld, Labelled, SymbolSpace
from jaxlangnav.grounding.properties import Annotations, Behaviors
from jaxlangnav.grounding.symbols import (
    KINDS,
    OBJECT,
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


def _split(text: str) -> tuple[str, list[str]]:
    """Part ``kind(argument,...)`` into kind and arguments."""
    kind, _, rest = text.removesuffix(")").partition("(")
    return kind, rest.split(",")


def read_annotation(text: str, type_names: tuple[str, ...]) -> Annotation:
    """Read an annotation symbol such as ``relation(hydrant,behind,cone)``."""

    def landmark(name: str) -> int:
        return ROBOT if name == "robot" else type_names.index(name)

    kind, arguments = _split(text)
    if kind == "object":
        return object_symbol(type_names.index(arguments[0]))
    if kind == "region":
        return region_symbol(RELATIONS.index(arguments[0]), landmark(arguments[1]))
    figure, relation, mark = arguments
    return relation_symbol(type_names.index(figure), RELATIONS.index(relation), landmark(mark))


def read_behavior(text: str, num_objects: int) -> BehaviorSymbol:
    """Read a behavior symbol such as ``goal(at,3)``; the robot's slot comes after the objects."""
    name, arguments = _split(text)
    kind = KINDS.index(name)
    last = num_objects if arguments[-1] == "robot" else arguments[-1]
    if kind == OBJECT:
        return BehaviorSymbol(kind, NONE, int(last))
    if name in ("action", "mode"):
        names = ACTIONS if name == "action" else MODES
        return BehaviorSymbol(kind, NONE, names.index(arguments[0]))
    return BehaviorSymbol(kind, REGIONS.index(arguments[0]), int(last))


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
        count = len(labelled.world.objects)
        behaviors.append(
            {
                path: frozenset(read_behavior(text, count) for text in symbols)
                for clause, labels, kind in zip(
                    paths, labelled.behavior, example.parse.kinds, strict=True
                )
                if kind == COMMAND
                for path, symbols in zip(clause, labels, strict=True)
            }
        )
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

    Args:
        space: the symbols.
        labelled: trees with labels; each counts as an instruction.

    Returns:
        One example per phrase.

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
    for labels in (one.expressed, one.ranks) if one.ranks else (one.expressed,):
        if len(labels) != len(nodes):
            raise ValueError(
                f"tree {instruction}: {len(labels)} labels, but {one.root} has {len(nodes)} phrases"
            )
    unknown = sorted(set().union(*one.expressed) - set(symbols.index))
    if unknown:
        raise ValueError(f"tree {instruction}: {unknown[0]} is no symbol of its world")
    gold = [symbols.mask(expressed) for expressed in one.expressed]
    for place_of, node in enumerate(nodes):
        described = space.describe(node.phrase, node.path, one.world)
        blocks = described.given([gold[child] for child in node.children])
        rows = {
            kind: Rows(np.asarray(block.properties, np.float32), gold[place_of][block.places])
            for kind, block in blocks.items()
        }
        if described.ranks is not None:
            own = (
                np.arange(1, len(described.ranks) + 1) == (one.ranks or [0] * len(nodes))[place_of]
            )
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
