"""Hold-out splits of a corpus (section 4.1): 67 to 33 %, drawn at random."""

from collections.abc import Sequence

import numpy as np

from jaxlangnav.training.examples import LabelledInstruction

HOLD_OUT = 1 / 3


def draw_splits(count: int, splits: int, seed: int) -> np.ndarray:
    """Draw which instructions are held out.

    Args:
        count: instructions.
        splits: K.
        seed: of the draw.

    Returns:
        bool[K, count], a third of each row is held out.
    """
    generator = np.random.default_rng(seed)
    held_out = np.zeros((splits, count), bool)
    for row in held_out:
        row[generator.permutation(count)[: round(count * HOLD_OUT)]] = True
    return held_out


def _has_new_word(labelled: LabelledInstruction, seen: set[str]) -> bool:
    """Tell whether a sentence has a word that none of a training set has."""
    words = (word for root in labelled.parse.clauses for word in root.all_words())
    return any(word.lemma not in seen for word in words)


def mark_new_words(
    instructions: Sequence[LabelledInstruction], is_held_out: np.ndarray
) -> np.ndarray:
    """Find the held-out sentences with a word that training never saw.

    Args:
        instructions: the corpus.
        is_held_out: bool[I].

    Returns:
        bool, one per held-out instruction, in order.
    """
    kept = [one for one, is_out in zip(instructions, is_held_out, strict=True) if not is_out]
    seen = {w.lemma for one in kept for root in one.parse.clauses for w in root.all_words()}
    held_out = [one for one, is_out in zip(instructions, is_held_out, strict=True) if is_out]
    return np.array([_has_new_word(one, seen) for one in held_out], bool)
