"""Training data: labelled instructions, examples per phrase, and counted factors (section 4.1).

Training is teacher-forced: the groundings of child phrases are the gold ones. An example of the
paper is one factor, (phrase, symbol); one of ours is a phrase with the factors of its symbols.
Training uses the distinct factors with their counts.
"""

import dataclasses
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxlangnav.grounding.correspondence import RANKS, AnyWorld, Labelled, SymbolSpace
from jaxlangnav.grounding.model import Vocabulary
from jaxlangnav.grounding.properties import Annotations, Behaviors
from jaxlangnav.grounding.symbols import (
    KINDS,
    AnnotationSymbol,
    BehaviorSymbol,
    Path,
    object_symbol,
    post_order,
    region_symbol,
    relation_symbol,
)
from jaxlangnav.grounding.worlds import World, to_world
from jaxlangnav.language.corpus import Example
from jaxlangnav.language.phrase import COMMAND, Parse, Phrase
from jaxlangnav.messages import ACTIONS, MODES, NONE, REGIONS, RELATIONS, ROBOT


@dataclasses.dataclass(frozen=True)
class LabelledInstruction:
    """An instruction with gold groundings of every phrase."""

    parse: Parse
    annotated: tuple[Labelled[None], ...]  # its clauses
    behaving: tuple[tuple[Labelled[World], ...], ...]  # its commands in each world
    rank: Mapping[Path, int]  # of phrases: "nearest" 1, "second" 2; others 0


def read_annotation(text: str, type_names: tuple[str, ...]) -> AnnotationSymbol:
    """Parse an annotation symbol such as ``relation(hydrant,behind,cone)``."""

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
    """Parse a behavior symbol such as ``goal(at,3)``; the robot has the last slot."""
    name, first, *rest = re.split(r"[(,)]", text)[:-1]
    kind = KINDS.index(name)
    if name in ("action", "mode"):
        names = ACTIONS if name == "action" else MODES
        return BehaviorSymbol(kind, NONE, names.index(first))
    slot = rest[0] if rest else first
    region = REGIONS.index(first) if rest else NONE
    return BehaviorSymbol(kind, region, num_objects if slot == "robot" else int(slot))


def labelled_instruction(example: Example, type_names: tuple[str, ...]) -> LabelledInstruction:
    """Convert a corpus example to training data; statements have no behavior."""
    roots, annotated, behaving, rank = example.parse.clauses, [], [], {}
    for clause, (root, labels) in enumerate(zip(roots, example.clauses, strict=True)):
        expressed = [
            frozenset(read_annotation(text, type_names) for text in symbols)
            for symbols in labels.annotation
        ]
        annotated.append(
            Labelled(root=root, world=None, expressed=expressed, ranks=labels.rank, clause=clause)
        )
        paths = [node.path for node in post_order(root, clause)]
        rank |= dict(zip(paths, labels.rank, strict=True))
    for labelled in example.worlds:
        world, count, trees = to_world(labelled.world, type_names), len(labelled.world.objects), []
        clauses = zip(roots, labelled.behavior, example.parse.kinds, strict=True)
        for clause, (root, labels, kind) in enumerate(clauses):
            if kind == COMMAND:
                expressed = [
                    frozenset(read_behavior(text, count) for text in symbols) for symbols in labels
                ]
                tree = Labelled(root=root, world=world, expressed=expressed, clause=clause)
                trees.append(tree)
        behaving.append(tuple(trees))
    return LabelledInstruction(example.parse, tuple(annotated), tuple(behaving), rank)


def read_examples(
    examples: Sequence[Example], type_names: tuple[str, ...]
) -> list[LabelledInstruction]:
    """Convert a corpus to training data; see ``labelled_instruction``."""
    return [labelled_instruction(example, type_names) for example in examples]


class Rows(NamedTuple):
    """Features and labels of a phrase's symbols of one kind."""

    properties: np.ndarray  # f32[S, F]
    labels: np.ndarray  # bool[S]


@dataclasses.dataclass(frozen=True)
class PhraseExample:
    """One phrase with the factors of its symbols."""

    phrase: Phrase
    rows: Mapping[str, Rows]  # kind → factors
    instruction: int  # index of its instruction


def examples_of(
    space: SymbolSpace[AnyWorld], labelled: Sequence[Labelled[AnyWorld]]
) -> list[PhraseExample]:
    """Build one training example per phrase of trees, given the gold labels of its children.

    Each tree counts as an instruction.

    Raises:
        ValueError: a label is no symbol of its world, or the numbers of labels or properties are
            wrong; the message says in which tree.
    """
    return [
        example
        for index, tree in enumerate(labelled)
        for example in _tree_examples(space, tree, index)
    ]


def _tree_examples(
    space: SymbolSpace[AnyWorld], ex: Labelled[AnyWorld], instruction: int
) -> Iterator[PhraseExample]:
    nodes, symbols = post_order(ex.root, ex.clause), space.symbols_in(ex.world)
    ranks = ex.ranks or [0] * len(nodes)
    for labels in (ex.expressed, ranks):
        if len(labels) != len(nodes):
            raise ValueError(
                f"tree {instruction}: {len(labels)} labels, but {ex.root} has {len(nodes)} phrases"
            )
    unknown = sorted(set().union(*ex.expressed) - set(symbols.index))
    if unknown:
        raise ValueError(f"tree {instruction}: {unknown[0]} is no symbol of its world")
    gold = [symbols.mask(expressed) for expressed in ex.expressed]
    for node, expressed, rank in zip(nodes, gold, ranks, strict=True):
        described = space.describe(node.phrase, node.path, ex.world)
        blocks = described.given([gold[child] for child in node.children])
        rows = {
            kind: Rows(np.asarray(block.properties, np.float32), expressed[block.indices])
            for kind, block in blocks.items()
        }
        if described.ranks is not None:
            is_rank = np.arange(1, len(described.ranks) + 1) == rank
            rows[RANKS] = Rows(np.asarray(described.ranks, np.float32), is_rank)
        for kind, (properties, labels) in rows.items():
            expected = len(labels), len(space.columns[kind])
            if properties.shape != expected:
                raise ValueError(
                    f"tree {instruction}: properties are {properties.shape}, but must be {expected}"
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
        for tree in labelled.annotated
        for example in _tree_examples(space, tree, index)
    ]


def behavior_examples(
    instructions: Sequence[LabelledInstruction], type_names: tuple[str, ...]
) -> list[PhraseExample]:
    """Build the examples of the behavior model, one per phrase and world, without empty slots."""
    return [
        example
        for index, labelled in enumerate(instructions)
        for trees in labelled.behaving
        for tree in trees
        for example in _tree_examples(Behaviors(type_names, labelled.rank), tree, index)
    ]


# ---------------------------------------------------------------- counts of distinct factors


def deduplicate(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Deduplicate rows of f32[N, F]: i[D] first index of each distinct row, i[N] inverse index.

    Rows are compared by their bytes, a hundred times faster than number by number.
    """
    row_type = np.dtype((np.void, rows.shape[1] * np.dtype(np.float32).itemsize))
    keys = np.ascontiguousarray(rows, np.float32).view(row_type)[:, 0]
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    return first, inverse.ravel()


class Factors(NamedTuple):
    """Factors before equal ones are merged, as flat arrays.

    The minimal input of training, for data without ``PhraseExample``.
    """

    words: np.ndarray  # f32[H, W] word features of a phrase
    properties: np.ndarray  # f32[N, F] properties of a symbol
    label: np.ndarray  # bool[N] whether the phrase expresses it
    phrase: np.ndarray  # i[N] row of ``words``
    instruction: np.ndarray  # i[N] index of the factor's instruction
    times: np.ndarray | None = None  # f32[N] count of each factor; 1 by default


@dataclasses.dataclass(frozen=True)
class Design:
    """Distinct factors by distinct word features, with their occurrences (a sparse design).

    U distinct words, up to G distinct symbols of each, W word features, F properties of all kinds
    side by side, I instructions, C occurrences. Padded symbols have no occurrence.
    """

    words: np.ndarray  # f32[U, W]
    properties: np.ndarray  # f32[U, G, F]
    columns: dict[str, slice]  # kind → its properties
    cell: np.ndarray  # i[C] flat index into [U, G, 2]: words, symbol, φ
    instruction: np.ndarray  # i[C]
    times: np.ndarray  # f32[C]
    num_instructions: int

    def counts(self, instruction_weights: np.ndarray) -> np.ndarray:
        """Count factors with φ = 0 and 1, given f32[K, I] instruction weights: f32[K, U, G, 2]."""
        shape = (*self.properties.shape[:2], 2)
        rows = [
            np.bincount(self.cell, weights * self.times, minlength=math.prod(shape))
            for weights in instruction_weights[:, self.instruction]
        ]
        return np.stack(rows).astype(np.float32).reshape(-1, *shape)


def pool(factors: Factors, columns: dict[str, slice], num_instructions: int) -> Design:
    """Merge equal factors of I instructions and count them; ``columns`` are by kind."""
    first_words, words = deduplicate(factors.words)
    first_rows, rows = deduplicate(factors.properties)
    pair = words[factors.phrase] * len(first_rows) + rows
    distinct, inverse = np.unique(pair, return_inverse=True)
    owner, row = distinct // len(first_rows), distinct % len(first_rows)
    begin = np.searchsorted(owner, np.arange(len(first_words)))
    slot = np.arange(len(distinct)) - begin[owner]
    depth = int(slot.max()) + 1
    properties = np.zeros((len(first_words), depth, factors.properties.shape[1]), np.float32)
    properties[owner, slot] = factors.properties[first_rows[row]]
    cell = (owner * depth + slot)[inverse.ravel()] * 2 + factors.label
    size = len(first_words) * depth * 2
    occurrence, which = np.unique(factors.instruction * size + cell, return_inverse=True)
    times = np.bincount(which.ravel(), factors.times)
    return Design(
        words=factors.words[first_words],
        properties=properties,
        columns=columns,
        cell=occurrence % size,
        instruction=occurrence // size,
        times=times.astype(np.float32),
        num_instructions=num_instructions,
    )


def flatten(
    examples: Sequence[PhraseExample], kinds: Sequence[str], vocabulary: Vocabulary
) -> tuple[Factors, dict[str, slice]]:
    """Stack the factors of all kinds of symbols, and list the columns of each kind.

    Kinds have separate columns, so one weight matrix holds the weights of all.

    Raises:
        ValueError: a kind has no example.
    """
    columns, end = {}, 0
    for kind in kinds:
        widths = (e.rows[kind].properties.shape[1] for e in examples if kind in e.rows)
        width = next(widths, None)
        if width is None:
            raise ValueError(f"no example has a symbol of kind '{kind}' to learn from")
        columns[kind] = slice(end, end + width)
        end += width
    parts = [
        (index, kind, *_distinct(example.rows[kind]))
        for index, example in enumerate(examples)
        for kind in kinds
        if kind in example.rows
    ]
    sizes = [len(label) for _, _, _, label, _ in parts]
    properties, begin = np.zeros((sum(sizes), end), np.float32), 0
    for size, (_, kind, rows, _, _) in zip(sizes, parts, strict=True):
        properties[begin : begin + size, columns[kind]] = rows
        begin += size
    phrase = np.repeat([index for index, *_ in parts], sizes)
    owner = np.array([example.instruction for example in examples])
    factors = Factors(
        words=np.stack([vocabulary.vector(example.phrase) for example in examples]),
        properties=properties,
        label=np.concatenate([label for _, _, _, label, _ in parts]),
        phrase=phrase,
        instruction=owner[phrase],
        times=np.concatenate([times for *_, times in parts]),
    )
    return factors, columns


def _distinct(rows: Rows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Merge equal factors of one phrase: distinct features, labels and counts."""
    first, which = deduplicate(rows.properties)
    pair, times = np.unique(2 * which + rows.labels, return_counts=True)
    return rows.properties[first[pair // 2]], pair % 2 == 1, times
