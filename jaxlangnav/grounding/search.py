"""Search for the likeliest expressed sets, bottom-up over the phrases (section 3.1).

Given what the child phrases express, the factors of a phrase are independent, so its k best sets
follow exactly from the margins |log-odds|. The only approximation is the beam: of each phrase's
sets, and of the combinations of its children's, the best ``width`` are kept.
"""

import dataclasses
import heapq
import itertools
from collections.abc import Callable, Sequence

import numpy as np

from jaxlangnav.language.phrase import Phrase

BEAM_WIDTH = 4
PROOF_WIDTHS = (4, 16, 64, 256)
"""Beam widths tried until the likeliest set is proven to be it."""
LogOdds = Callable[[Phrase, tuple[int, ...], Sequence["Hypothesis"]], np.ndarray]
"""Phrase, its path and the child hypotheses → log-odds f64[S]; −inf excludes a symbol."""


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """What a phrase may express, with the child hypotheses it rests on."""

    expressed: np.ndarray  # bool[S]
    log_probability: float  # of it and of all below it
    children: tuple["Hypothesis", ...] = ()


def best_sets(log_odds: np.ndarray, width: int) -> list[tuple[np.ndarray, float]]:
    """Find the k likeliest sets of independent binary factors, exactly.

    Each set is the best one with some factors flipped; a flip costs its margin. Sets of flips
    are enumerated in order of cost.

    Args:
        log_odds: f[S] of φ = 1 against φ = 0; −inf allowed.
        width: k, at least 1.

    Returns:
        Up to k (bool[S], log-probability), best first.
    """
    best = log_odds > 0
    margins = np.abs(log_odds)
    top = float(-np.logaddexp(0.0, -margins).sum())
    order = np.argsort(margins, kind="stable")[: max(width, 1)]
    order = order[np.isfinite(margins[order])]
    found = [(best, top)]
    heap: list[tuple[float, int, tuple[int, ...]]] = []
    if len(order) and width > 1:
        heap.append((float(margins[order[0]]), 0, (0,)))
    while heap and len(found) < width:
        cost, last, flips = heapq.heappop(heap)
        expressed = best.copy()
        expressed[order[list(flips)]] ^= True
        found.append((expressed, top - cost))
        if last + 1 < len(order):
            step = float(margins[order[last + 1]])
            heapq.heappush(heap, (cost + step, last + 1, (*flips, last + 1)))
            swapped = cost - float(margins[order[last]]) + step
            heapq.heappush(heap, (swapped, last + 1, (*flips[:-1], last + 1)))
    return found


def combinations(
    beams: Sequence[Sequence[Hypothesis]], width: int
) -> list[tuple[tuple[Hypothesis, ...], float]]:
    """Combine the children's hypotheses and keep the best.

    Args:
        beams: hypotheses of each child, best first.
        width: how many combinations to keep.

    Returns:
        (one hypothesis per child, joint log-probability), best first.
    """
    joint: list[tuple[tuple[Hypothesis, ...], float]] = [((), 0.0)]
    for beam in beams:
        extended = [
            ((*chosen, hypothesis), score + hypothesis.log_probability)
            for (chosen, score), hypothesis in itertools.product(joint, beam)
        ]
        extended.sort(key=lambda pair: -pair[1])
        joint = extended[:width]
    return joint


def merge(hypotheses: Sequence[Hypothesis], width: int) -> list[Hypothesis]:
    """Add up the probability of equal sets that rest on different children; keep the best.

    Args:
        hypotheses: candidates in any order.
        width: how many to keep.

    Returns:
        Best first; each keeps the children of its likeliest origin.
    """
    merged: dict[bytes, Hypothesis] = {}
    for hypothesis in sorted(hypotheses, key=lambda h: -h.log_probability):
        key = hypothesis.expressed.tobytes()
        known = merged.get(key)
        if known is None:
            merged[key] = hypothesis
        else:
            total = float(np.logaddexp(known.log_probability, hypothesis.log_probability))
            merged[key] = dataclasses.replace(known, log_probability=total)
    return sorted(merged.values(), key=lambda h: -h.log_probability)[:width]


def search(
    root: Phrase, log_odds: LogOdds, *, width: int = BEAM_WIDTH, path: tuple[int, ...] = ()
) -> list[Hypothesis]:
    """Infer the distribution of what a phrase expresses.

    Args:
        root: phrase; its children are searched first.
        log_odds: the model.
        width: beam width.
        path: where the phrase stands, as ``graph.Node.path``.

    Returns:
        Up to ``width`` hypotheses, best first; probabilities are not renormalised, so what is
        missing to one is what the beam has cut.
    """
    beams = [
        search(child, log_odds, width=width, path=(*path, i))
        for i, child in enumerate(root.children)
    ]
    candidates = []
    for children, score in combinations(beams, width):
        odds = log_odds(root, path, children)
        candidates.extend(
            Hypothesis(expressed, score + own, children)
            for expressed, own in best_sets(odds, width)
        )
    return merge(candidates, width)


def is_likeliest(log_probability: np.ndarray) -> bool:
    """Tell whether the first set of a beam is proven to be the likeliest of all 2^S.

    What a beam of any width finds are lower bounds, and what it misses adds up to the rest m of
    the probability. So where p(best) > p(second) + m, no other set is likelier, found or not.

    Args:
        log_probability: f64[W], best first; −inf where there is no further set.

    Returns:
        Whether it is proven.
    """
    chances = np.exp(log_probability)
    missed = max(1.0 - float(chances.sum()), 0.0)
    second = float(chances[1]) if len(chances) > 1 else 0.0
    return bool(chances[0] > second + missed + 1e-9)


def search_exactly(
    root: Phrase, log_odds: LogOdds, *, path: tuple[int, ...] = ()
) -> tuple[Hypothesis, bool]:
    """Find the likeliest of all 2^S sets, and whether it is proven to be.

    Wider and wider beams are searched until the first of one is (``is_likeliest``).

    Args:
        root: phrase.
        log_odds: the model.
        path: where the phrase stands.

    Returns:
        The likeliest set, and whether it is proven; if not, it is that of the widest beam.
    """
    best = None
    for width in PROOF_WIDTHS:
        beam = search(root, log_odds, width=width, path=path)
        best = beam[0]
        if is_likeliest(np.array([hypothesis.log_probability for hypothesis in beam])):
            return best, True
    assert best is not None
    return best, False
