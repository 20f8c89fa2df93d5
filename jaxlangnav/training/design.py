"""Distinct factors of the log-linear model, counted: what training reads (section 4.1)."""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxlangnav.grounding.correspondence import MANY
from jaxlangnav.grounding.model import Vocabulary
from jaxlangnav.grounding.search import identify
from jaxlangnav.training.examples import PhraseExample, Rows


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
    """Join equal factors of one phrase where there are many: properties, labels, how often."""
    if len(rows.labels) < MANY:
        return rows.properties, rows.labels, np.ones(len(rows.labels))
    first, which = identify(rows.properties)
    pair, times = np.unique(2 * which + rows.labels, return_counts=True)
    return rows.properties[first[pair // 2]], pair % 2 == 1, times
