"""Training data: labelled instructions, examples per phrase, and counted factors (section 4.1).

Training is teacher-forced: the groundings of child phrases are the gold ones. An example of the
paper is one factor, (phrase, symbol); one of ours is a phrase with the factors of its symbols.
Training uses the distinct factors with their counts.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse import csr_array

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


class LabelledInstruction(NamedTuple):
    """An instruction with gold groundings of every phrase."""

    parse: Parse
    annotations: tuple[Labelled[None], ...]  # trees of its clauses
    behaviors: tuple[tuple[Labelled[World], ...], ...]  # trees of its commands in each world
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
        return BehaviorSymbol(kind, NONE, (ACTIONS if name == "action" else MODES).index(first))
    slot = rest[0] if rest else first
    region = REGIONS.index(first) if rest else NONE
    return BehaviorSymbol(kind, region, num_objects if slot == "robot" else int(slot))


def labelled_instruction(example: Example, type_names: tuple[str, ...]) -> LabelledInstruction:
    """Convert a corpus example to training data; statements have no behavior."""
    roots, annotations, behaviors, rank = example.parse.clauses, [], [], {}
    for clause, (root, labels) in enumerate(zip(roots, example.clauses, strict=True)):
        expressed = [
            frozenset(read_annotation(text, type_names) for text in symbols)
            for symbols in labels.annotation
        ]
        annotations.append(
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
                trees.append(Labelled(root=root, world=world, expressed=expressed, clause=clause))
        behaviors.append(tuple(trees))
    return LabelledInstruction(example.parse, tuple(annotations), tuple(behaviors), rank)


class FactorBlock(NamedTuple):
    """Properties and labels of a phrase's symbols of one kind."""

    properties: np.ndarray  # f32[S, F]
    labels: np.ndarray  # bool[S]


class PhraseExample(NamedTuple):
    """One phrase with the factors of its symbols."""

    phrase: Phrase
    blocks: Mapping[str, FactorBlock]  # kind → factors
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
    space: SymbolSpace[AnyWorld], tree: Labelled[AnyWorld], instruction: int
) -> Iterator[PhraseExample]:
    nodes, symbols = post_order(tree.root, tree.clause), space.symbols_in(tree.world)
    ranks = tree.ranks or [0] * len(nodes)
    for labels in (tree.expressed, ranks):
        if len(labels) != len(nodes):
            size = f"{tree.root} has {len(nodes)} phrases"
            raise ValueError(f"tree {instruction}: {len(labels)} labels, but {size}")
    unknown = sorted(set().union(*tree.expressed) - set(symbols.index))
    if unknown:
        raise ValueError(f"tree {instruction}: {unknown[0]} is no symbol of its world")
    gold = [symbols.mask(expressed) for expressed in tree.expressed]
    for node, expressed, rank in zip(nodes, gold, ranks, strict=True):
        node_features = space.describe(node.phrase, node.path, tree.world)
        property_blocks = node_features.given([gold[child] for child in node.children])
        blocks = {
            kind: FactorBlock(np.asarray(block.properties, np.float32), expressed[block.indices])
            for kind, block in property_blocks.items()
        }
        if node_features.ranks is not None:
            is_rank = np.arange(1, len(node_features.ranks) + 1) == rank
            blocks[RANKS] = FactorBlock(np.asarray(node_features.ranks, np.float32), is_rank)
        for kind, (properties, labels) in blocks.items():
            expected = len(labels), len(space.columns[kind])
            if properties.shape != expected:
                raise ValueError(
                    f"tree {instruction}: properties are {properties.shape}, but must be {expected}"
                )
        yield PhraseExample(node.phrase, blocks, instruction)


def model_examples(
    name: str, instructions: Sequence[LabelledInstruction], type_names: tuple[str, ...]
) -> list[PhraseExample]:
    """Build the examples of a model, one per phrase.

    ``name``: "annotation", or "behavior" with one per phrase and world, without empty slots.
    """
    examples: list[PhraseExample] = []
    for index, labelled in enumerate(instructions):
        by_model: dict[str, tuple[SymbolSpace[Any], Iterable[Labelled[Any]]]] = {
            "annotation": (Annotations(type_names), labelled.annotations),
            "behavior": (Behaviors(type_names, labelled.rank), chain(*labelled.behaviors)),
        }
        space, trees = by_model[name]
        examples += (one for tree in trees for one in _tree_examples(space, tree, index))
    return examples


# ---------------------------------------------------------------- counts of distinct factors


def unique_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Deduplicate rows of f32[N, F]: i[D] first index of each distinct row, i[N] inverse index.

    Rows are compared by their bytes, a hundred times faster than number by number.
    """
    row_type = np.dtype((np.void, rows.shape[1] * np.dtype(np.float32).itemsize))
    keys = np.ascontiguousarray(rows, np.float32).view(row_type)[:, 0]
    return np.unique(keys, return_index=True, return_inverse=True)[1:]


class Factors(NamedTuple):
    """Factors as flat arrays, before equal ones are merged.

    The minimal input of training, for data without ``PhraseExample``.
    """

    words: np.ndarray  # f32[H, W] word features of a phrase
    properties: np.ndarray  # f32[N, F] properties of a symbol
    label: np.ndarray  # bool[N] whether the phrase expresses it
    phrase: np.ndarray  # i[N] row of ``words``
    instruction: np.ndarray  # i[N] index of the factor's instruction
    repeats: np.ndarray  # f32[N] count of each factor


class Design(NamedTuple):
    """Distinct factors by distinct word features, with their occurrences (a sparse design).

    U distinct words, up to G distinct symbols of each, W word features, F properties of all kinds
    side by side, I instructions. Padded symbols have no occurrence.
    """

    words: np.ndarray  # f32[U, W]
    properties: np.ndarray  # f32[U, G, F]
    columns: dict[str, slice]  # kind → its properties
    occurrences: csr_array  # [I, U · G · 2] count by instruction, words, symbol and label

    def counts(self, instruction_weights: np.ndarray) -> np.ndarray:
        """Count factors by label (φ, eq. 4), by instruction weights f32[K, I]: f32[K, U, G, 2]."""
        counts = np.asarray(instruction_weights @ self.occurrences, np.float32)
        return counts.reshape(-1, *self.properties.shape[:2], 2)


def tabulate(factors: Factors, columns: dict[str, slice], num_instructions: int) -> Design:
    """Merge equal factors of I instructions and count them; ``columns`` are by kind."""
    first_word, word_index = unique_rows(factors.words)
    first_row, property_index = unique_rows(factors.properties)
    pair = word_index[factors.phrase] * len(first_row) + property_index
    pairs, inverse = np.unique(pair, return_inverse=True)
    word_row, symbol_row = pairs // len(first_row), pairs % len(first_row)
    start = np.searchsorted(word_row, np.arange(len(first_word)))
    slot = np.arange(len(pairs)) - start[word_row]
    num_slots = int(slot.max()) + 1
    properties = np.zeros((len(first_word), num_slots, factors.properties.shape[1]), np.float32)
    properties[word_row, slot] = factors.properties[first_row[symbol_row]]
    cell = (word_row * num_slots + slot)[inverse] * 2 + factors.label
    shape = num_instructions, len(first_word) * num_slots * 2
    return Design(
        words=factors.words[first_word],
        properties=properties,
        columns=columns,
        occurrences=csr_array((factors.repeats, (factors.instruction, cell)), shape),
    )


def factors_of(
    examples: Sequence[PhraseExample], kinds: Sequence[str], vocabulary: Vocabulary
) -> tuple[Factors, dict[str, slice]]:
    """Stack the factors of all kinds of symbols, and list the columns of each kind.

    Kinds have separate columns, so one weight matrix holds the weights of all.

    Raises:
        ValueError: a kind has no example.
    """
    columns, merged, properties, end = {}, [], [], 0
    for kind in kinds:
        indices = [index for index, example in enumerate(examples) if kind in example.blocks]
        if not indices:
            raise ValueError(f"no example has a symbol of kind '{kind}' to learn from")
        blocks = [_count_factors(examples[index].blocks[kind]) for index in indices]
        merged += [(index, *block[1:]) for index, block in zip(indices, blocks, strict=True)]
        properties.append(np.concatenate([block for block, _, _ in blocks]))
        columns[kind] = slice(end, end + properties[-1].shape[1])
        end = columns[kind].stop
    phrases, labels, counts = zip(*merged, strict=True)
    phrase = np.repeat(phrases, [*map(len, labels)])
    factors = Factors(
        words=np.stack([vocabulary.vector(example.phrase) for example in examples]),
        properties=np.asarray(block_diag(*properties)),
        label=np.concatenate(labels),
        phrase=phrase,
        instruction=np.array([example.instruction for example in examples])[phrase],
        repeats=np.concatenate(counts),
    )
    return factors, columns


def _count_factors(block: FactorBlock) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Merge equal factors of one phrase: distinct features, labels and counts."""
    first_index, distinct = unique_rows(block.properties)
    pair, counts = np.unique(2 * distinct + block.labels, return_counts=True)
    return block.properties[first_index[pair // 2]], pair % 2 == 1, counts
