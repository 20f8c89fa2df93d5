"""From labelled instructions to training examples of the log-linear model (section 4.1).

Training is teacher-forced: the groundings of child phrases are the gold ones. One example of the
paper is one factor, (phrase, symbol); one of ours is a phrase with the factors of its symbols.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxlangnav.grounding import behavior_features as bf
from jaxlangnav.grounding.correspondence import Labelled
from jaxlangnav.grounding.graph import Path, bottom_up
from jaxlangnav.grounding.model import Vocabulary
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
        """Count the factors when instructions count more or less, or not at all.

        Args:
            instruction_weights: f32[K, I].

        Returns:
            f32[K, U, G, 2], how many factors have φ = 0, and φ = 1.
        """
        shape = (*self.properties.shape[:2], 2)
        rows = [
            np.bincount(self.place, weights * self.times, minlength=math.prod(shape))
            for weights in instruction_weights[:, self.instruction]
        ]
        return np.stack(rows).astype(np.float32).reshape(-1, *shape)

    @property
    def num_distinct(self) -> int:
        """Distinct pairs of words and properties."""
        return len(np.unique(self.place // 2))


_ROWS = 1 << 16
"""Rows that are hashed at a time."""
MANY = 64
"""Symbols of a phrase from which on equal ones are joined at once."""


def _bits(rows: np.ndarray) -> np.ndarray:
    """Widen the bits of f32[N, F] to u64[N, F]."""
    return np.ascontiguousarray(rows, np.float32).view(np.uint32).astype(np.uint64)


def identify(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find equal rows of f32[N, F].

    Rows are told apart by a random 64-bit hash of their bits, some hundred times faster than
    sorting whole rows; that no two different rows share one is checked.

    Returns:
        i[D] where each distinct row first occurs, and i[N] which one each row is.
    """
    parts = np.array_split(rows, -(-len(rows) // _ROWS) or 1)  # so that copies stay small
    for seed in range(8):
        generator = np.random.default_rng(seed)
        factors = generator.integers(1, 2**64, rows.shape[1], np.uint64, endpoint=False)
        keys = np.concatenate([_bits(part) @ factors for part in parts])
        _, first, which = np.unique(keys, return_index=True, return_inverse=True)
        which = which.ravel()
        alike = np.array_split(first[which], len(parts))
        if all((rows[one] == part).all() for one, part in zip(alike, parts, strict=True)):
            return first, which
    raise AssertionError("eight random hashes of 64 bits collide")


def pool(factors: Factors, columns: dict[str, slice], num_instructions: int) -> Design:
    """Join equal factors and count them.

    Args:
        factors: N of them.
        columns: kind of symbol → its columns of the properties.
        num_instructions: I.

    Returns:
        The design.
    """
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
    """Write the factors of all kinds of symbol one under the other.

    A kind has columns of its own, so one weight matrix holds the weights of all.

    Args:
        examples: of one model.
        kinds: kinds of symbol, each of which occurs.
        vocabulary: word side.

    Returns:
        The factors, and the columns of each kind.

    Raises:
        ValueError: a kind has no example.
    """
    widths = {}
    for kind in kinds:
        found = (e.rows[kind].properties.shape[1] for e in examples if kind in e.rows)
        width = next(found, None)
        if width is None:
            raise ValueError(f"no example has a symbol of kind '{kind}' to learn from")
        widths[kind] = width
    ends = np.cumsum(list(widths.values()))
    columns = {
        kind: slice(int(end) - width, int(end))
        for (kind, width), end in zip(widths.items(), ends, strict=True)
    }
    parts = [
        (index, kind, *_distinct(example.rows[kind]))
        for index, example in enumerate(examples)
        for kind in kinds
        if kind in example.rows
    ]
    sizes = [len(label) for _, _, _, label, _ in parts]
    properties = np.zeros((sum(sizes), int(ends[-1])), np.float32)
    begins = np.cumsum([0, *sizes[:-1]])
    for begin, size, (_, kind, rows, _, _) in zip(begins, sizes, parts, strict=True):
        properties[begin : begin + size, columns[kind]] = rows
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
    """Join equal factors of one phrase where there are many: properties, labels, how often."""
    if len(rows.labels) < MANY:
        return rows.properties, rows.labels, np.ones(len(rows.labels))
    first, which = identify(rows.properties)
    pair, times = np.unique(2 * which + rows.labels, return_counts=True)
    return rows.properties[first[pair // 2]], pair % 2 == 1, times
