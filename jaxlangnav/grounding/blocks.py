"""Training examples as arrays: equal factors are joined and counted (section 4.1).

The objective stays as it is, and the arrays become small.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxlangnav.grounding.examples import Example, Rows
from jaxlangnav.grounding.model import Vocabulary


@dataclasses.dataclass(frozen=True)
class Block:
    """All factors of one kind; H distinct examples of up to G distinct rows."""

    words: np.ndarray  # f32[H, W]
    properties: np.ndarray  # f32[H, G, F]
    count: np.ndarray  # f32[H, G, 2] how many factors have φ = 0, and φ = 1
    instructions: np.ndarray  # f32[I, H] how often each instruction has the example


def _compress(rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Join factors with equal properties: distinct rows f32[G, F] and counts f32[G, 2]."""
    distinct, inverse = np.unique(rows.properties, axis=0, return_inverse=True)
    count = np.zeros((len(distinct), 2), np.float32)
    np.add.at(count, (inverse.ravel(), rows.labels.astype(int)), 1.0)
    return distinct, count


def build_block(
    examples: Sequence[Example], kind: str, vocabulary: Vocabulary, num_instructions: int
) -> Block:
    """Stack the factors of one kind of symbol, joining equal examples.

    Args:
        examples: of one model.
        kind: which kind of symbol.
        vocabulary: word side.
        num_instructions: I.

    Returns:
        The block.
    """
    found: dict[tuple[bytes, bytes, bytes], int] = {}
    vectors, tables, counts, owners = [], [], [], []
    for example in examples:
        if kind not in example.rows:
            continue
        vector = vocabulary.vector(example.phrase)
        table, count = _compress(example.rows[kind])
        key = (vector.tobytes(), table.tobytes(), count.tobytes())
        if key not in found:
            found[key] = len(vectors)
            vectors.append(vector)
            tables.append(table)
            counts.append(count)
        owners.append((example.instruction, found[key]))
    depth = max(len(table) for table in tables)
    instructions = np.zeros((num_instructions, len(vectors)), np.float32)
    np.add.at(instructions, tuple(np.array(owners).T), 1.0)
    return Block(
        np.stack(vectors),
        np.stack([np.pad(t, ((0, depth - len(t)), (0, 0))) for t in tables]),
        np.stack([np.pad(c, ((0, depth - len(c)), (0, 0))) for c in counts]),
        instructions,
    )
