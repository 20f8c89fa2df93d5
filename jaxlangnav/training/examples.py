"""From labelled instructions to training examples of the log-linear model (section 4.1).

Training is teacher-forced: the groundings of child phrases are the gold ones. One example of the
paper is one factor, (phrase, symbol); one of ours is a phrase with the factors of its symbols.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxlangnav.grounding import behavior_features as bf
from jaxlangnav.grounding.correspondence import Labelled
from jaxlangnav.grounding.graph import Path, bottom_up
from jaxlangnav.grounding.properties import Annotations, Behaviors
from jaxlangnav.grounding.space import RANK, AnyWorld, BlockSpace
from jaxlangnav.grounding.symbols import Annotation, BehaviorSymbol, Symbols
from jaxlangnav.language.phrase import Parse, Phrase


@dataclasses.dataclass(frozen=True)
class LabelledInstruction:
    """An instruction with gold groundings of every phrase."""

    parse: Parse
    annotation: Mapping[Path, frozenset[Annotation]]
    rank: Mapping[Path, int]  # phrases that say "nearest" have 1, "second" 2; others 0 or absent
    worlds: tuple[bf.World, ...] = ()
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

    def behaving(self) -> Iterator[Labelled[bf.World]]:
        """Yield the trees of its commands in every world."""
        for world, gold in zip(self.worlds, self.behavior, strict=True):
            for clause, root in enumerate(self.parse.clauses):
                if (clause,) in gold:
                    expressed = [gold[node.path] for node in bottom_up(root, clause)]
                    yield Labelled(root=root, world=world, expressed=expressed, clause=clause)


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


def tree_examples(
    space: BlockSpace[AnyWorld], one: Labelled[AnyWorld], instruction: int
) -> Iterator[PhraseExample]:
    """Build the examples of one tree, given the gold groundings of child phrases.

    Args:
        space: the symbols.
        one: the tree with its labels.
        instruction: which instruction it belongs to.

    Yields:
        One example per phrase.

    Raises:
        ValueError: a label is no symbol of its world, or the numbers of labels or properties are
            wrong.
    """
    nodes = bottom_up(one.root, one.clause)
    symbols, columns = space.symbols_in(one.world), space.columns
    _check_labels(one, len(nodes), symbols, instruction)
    gold = [symbols.mask(expressed) for expressed in one.expressed]
    for place, node in enumerate(nodes):
        described = space.describe(node.phrase, node.path, one.world)
        blocks = described.given([gold[child] for child in node.children])
        rows = {
            kind: Rows(np.asarray(block.properties, np.float32), gold[place][block.places])
            for kind, block in blocks.items()
        }
        if described.ranks is not None:
            ranks = np.arange(1, len(described.ranks) + 1)
            own = one.ranks[place] if one.ranks else 0
            rows[RANK] = Rows(np.asarray(described.ranks, np.float32), ranks == own)
        for kind, (properties, labels) in rows.items():
            wanted = len(labels), len(columns[kind])
            if properties.shape != wanted:
                raise ValueError(
                    f"tree {instruction}: properties are {properties.shape}, but must be {wanted}"
                )
        yield PhraseExample(node.phrase, rows, instruction)


def _check_labels(one: Labelled, num_phrases: int, symbols: Symbols, instruction: int) -> None:
    """Refuse labels that do not fit their tree or their world."""
    labels = [one.expressed, one.ranks] if one.ranks else [one.expressed]
    for given in labels:
        if len(given) != num_phrases:
            raise ValueError(
                f"tree {instruction}: {len(given)} labels, but {one.root} has {num_phrases} phrases"
            )
    for expressed in one.expressed:
        unknown = sorted(symbol for symbol in expressed if symbol not in symbols.index)
        if unknown:
            raise ValueError(f"tree {instruction}: {unknown[0]} is no symbol of its world")


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
    space = Annotations(type_names)
    return [
        example
        for index, labelled in enumerate(instructions)
        for tree in labelled.annotated()
        for example in tree_examples(space, tree, index)
    ]


def behavior_examples(
    instructions: Sequence[LabelledInstruction], type_names: tuple[str, ...]
) -> list[PhraseExample]:
    """Build the examples of the behavior model; arguments as ``annotation_examples``.

    Returns:
        One example per phrase and world; symbols of empty object slots are left out.
    """
    return [
        example
        for index, labelled in enumerate(instructions)
        for tree in labelled.behaving()
        for example in tree_examples(Behaviors(type_names, labelled.rank), tree, index)
    ]
