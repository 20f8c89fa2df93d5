"""Labelled instructions, the training examples that they give, and their factors (section 4.1).

Training is teacher-forced: the groundings of child phrases are the gold ones. One example of the
paper is one factor, (phrase, symbol); one of ours is a phrase with the factors of its symbols. What
training reads of them are distinct factors, counted.
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
    rank: Mapping[Path, int]  # phrases that say "nearest" have 1, "second" 2; others 0


def read_annotation(text: str, type_names: tuple[str, ...]) -> AnnotationSymbol:
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
    nodes, symbols = post_order(one.root, one.clause), space.symbols_in(one.world)
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
            kind: Rows(np.asarray(block.properties, np.float32), expressed[block.indices])
            for kind, block in blocks.items()
        }
        if described.ranks is not None:
            own = np.arange(1, len(described.ranks) + 1) == rank
            rows[RANKS] = Rows(np.asarray(described.ranks, np.float32), own)
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
        for tree in labelled.annotated
        for example in _tree_examples(space, tree, index)
    ]


def behavior_examples(
    instructions: Sequence[LabelledInstruction], type_names: tuple[str, ...]
) -> list[PhraseExample]:
    """Build the examples of the behavior model, one per phrase and world, empty slots left out."""
    return [
        example
        for index, labelled in enumerate(instructions)
        for trees in labelled.behaving
        for tree in trees
        for example in _tree_examples(Behaviors(type_names, labelled.rank), tree, index)
    ]


# ---------------------------------------------------------------- distinct factors, counted


def identify(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find equal rows of f32[N, F]: i[D] where each distinct row first is, i[N] which one each is.

    Rows are compared by their bytes, which takes a hundredth of the time of number by number.
    """
    whole = np.dtype((np.void, rows.shape[1] * np.dtype(np.float32).itemsize))
    keys = np.ascontiguousarray(rows, np.float32).view(whole)[:, 0]
    _, first, which = np.unique(keys, return_index=True, return_inverse=True)
    return first, which.ravel()


class Factors(NamedTuple):
    """Factors of any source before equal ones are joined: one row of words each.

    The least that training needs, for data that come from no ``PhraseExample``.
    """

    words: np.ndarray  # f32[H, W] word features of a phrase
    properties: np.ndarray  # f32[N, F] properties of a symbol
    label: np.ndarray  # bool[N] whether the phrase expresses it
    phrase: np.ndarray  # i[N] row of ``words``
    instruction: np.ndarray  # i[N] which instruction the factor comes from
    times: np.ndarray | None = None  # f32[N] how often it occurs there; once each by default


@dataclasses.dataclass(frozen=True)
class Design:
    """Distinct factors by distinct words, and where they occur.

    U distinct words, up to G distinct symbols of each, W word features, F properties of all kinds
    side by side, I instructions, C occurrences. Padded symbols have no occurrence.
    """

    words: np.ndarray  # f32[U, W]
    properties: np.ndarray  # f32[U, G, F]
    columns: dict[str, slice]  # kind → its properties
    place: np.ndarray  # i[C] flat index into [U, G, 2]: words, symbol, φ
    instruction: np.ndarray  # i[C]
    times: np.ndarray  # f32[C]
    num_instructions: int

    def counts(self, instruction_weights: np.ndarray) -> np.ndarray:
        """Count factors with φ = 0 and 1 by weights f32[K, I] of instructions: f32[K, U, G, 2]."""
        shape = (*self.properties.shape[:2], 2)
        rows = [
            np.bincount(self.place, weights * self.times, minlength=math.prod(shape))
            for weights in instruction_weights[:, self.instruction]
        ]
        return np.stack(rows).astype(np.float32).reshape(-1, *shape)


def pool(factors: Factors, columns: dict[str, slice], num_instructions: int) -> Design:
    """Join equal factors of I instructions and count them; ``columns`` are those of each kind."""
    first_words, words = identify(factors.words)
    first_rows, rows = identify(factors.properties)
    pair = words[factors.phrase] * len(first_rows) + rows
    distinct, which = np.unique(pair, return_inverse=True)
    owner, row = distinct // len(first_rows), distinct % len(first_rows)
    begin = np.searchsorted(owner, np.arange(len(first_words)))
    slot = np.arange(len(distinct)) - begin[owner]
    depth = int(slot.max()) + 1
    properties = np.zeros((len(first_words), depth, factors.properties.shape[1]), np.float32)
    properties[owner, slot] = factors.properties[first_rows[row]]
    place = (owner * depth + slot)[which.ravel()] * 2 + factors.label
    size = len(first_words) * depth * 2
    occurrence, which = np.unique(factors.instruction * size + place, return_inverse=True)
    times = np.bincount(which.ravel(), factors.times)
    return Design(
        words=factors.words[first_words],
        properties=properties,
        columns=columns,
        place=occurrence % size,
        instruction=occurrence // size,
        times=times.astype(np.float32),
        num_instructions=num_instructions,
    )


def flatten(
    examples: Sequence[PhraseExample], kinds: Sequence[str], vocabulary: Vocabulary
) -> tuple[Factors, dict[str, slice]]:
    """Write the factors of all kinds of symbol one under the other, and the columns of each kind.

    A kind has columns of its own, so one weight matrix holds the weights of all.

    Raises:
        ValueError: a kind has no example.
    """
    columns, end = {}, 0
    for kind in kinds:
        found = (e.rows[kind].properties.shape[1] for e in examples if kind in e.rows)
        width = next(found, None)
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
    """Join equal factors of one phrase, of which there may be many: distinct ones, how often."""
    first, which = identify(rows.properties)
    pair, times = np.unique(2 * which + rows.labels, return_counts=True)
    return rows.properties[first[pair // 2]], pair % 2 == 1, times
