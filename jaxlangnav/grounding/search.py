"""Beam search for the likeliest sets of symbols, bottom-up over the phrases (section 3.1).

Given what the child phrases express, the factors of a phrase are independent, so its k best sets
follow exactly from the margins |log-odds|. The only approximation is the beam: of each phrase's
sets, and of the combinations of its children's sets, only the best ``width`` remain.
"""

import dataclasses
import heapq
import itertools
import operator
from collections.abc import Callable, Hashable, Iterable, Iterator
from typing import Any, TypeVar

import numpy as np

from jaxlangnav.language.phrase import Phrase

BEAM_WIDTH = 4
PROOF_WIDTHS = (4, 16, 64, 256)
"""Beam widths tried until the best set is proven to be the likeliest."""
Children = tuple[np.ndarray, ...]
"""bool[S] for each child phrase."""
LogOdds = Callable[[tuple[int, ...], Children], np.ndarray]
"""Path of a phrase, child sets → log-odds f64[S]; −inf excludes a symbol."""


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """A beam hypothesis: a set of symbols of a phrase, given hypotheses of its children."""

    expressed: np.ndarray  # bool[S]
    log_probability: float  # joint, with all descendants
    children: tuple["Hypothesis", ...] = ()

    def walk(self, path: tuple[int, ...]) -> Iterator[tuple[tuple[int, ...], "Hypothesis"]]:
        """Yield the hypothesis and its descendants with their paths, parents first."""
        yield path, self
        for i, child in enumerate(self.children):
            yield from child.walk((*path, i))


def _best_sets(log_odds: np.ndarray, width: int) -> Iterator[tuple[np.ndarray, float]]:
    """Yield the k likeliest sets of factors f64[S] and their log-probabilities, best first."""
    # Each set is the best one with some factors flipped; a flip costs its margin.
    best, margins = log_odds > 0, np.abs(log_odds)
    top = -np.logaddexp(0.0, -margins).sum()
    order = np.argsort(margins, kind="stable")[:width]
    order = order[np.isfinite(margins[order])]
    choices: list[tuple[float, int, tuple[int, ...]]] = [(0.0, -1, ())]
    for _ in range(width):
        if not choices:
            return
        cost, last, choice = heapq.heappop(choices)
        expressed = best.copy()
        expressed[order[list(choice)]] ^= True
        yield expressed, float(top - cost)
        if last + 1 < len(order):  # successors: add the next factor, or replace the last by it
            for successor in {(*choice, last + 1), (*choice[:-1], last + 1)}:
                total = float(margins[order[list(successor)]].sum())
                heapq.heappush(choices, (total, last + 1, successor))


def search(
    root: Phrase, log_odds: LogOdds, *, width: int = BEAM_WIDTH, path: tuple[int, ...] = ()
) -> list[Hypothesis]:
    """Find up to ``width`` likeliest sets of symbols of a phrase at ``path``, best first.

    Children are searched first. Probabilities are not renormalised after pruning.
    """
    combined: list[tuple[tuple[Hypothesis, ...], float]] = [((), 0.0)]
    for i, child in enumerate(root.children):
        pairs = itertools.product(combined, search(child, log_odds, width=width, path=(*path, i)))
        joint = [((*left, new), score + new.log_probability) for (left, score), new in pairs]
        combined = sorted(joint, key=lambda pair: -pair[1])[:width]
    results = [
        Hypothesis(expressed, score + log_p, below)
        for below, score in combined
        for expressed, log_p in _best_sets(log_odds(path, tuple(c.expressed for c in below)), width)
    ]
    results.sort(key=lambda h: -h.log_probability)
    # Probabilities of equal sets are summed; each has the children of its likeliest hypothesis.
    ranked = sum_by_key(((h.expressed.tobytes(), h.log_probability) for h in results), np.logaddexp)
    best = {h.expressed.tobytes(): h for h in reversed(results)}
    return [dataclasses.replace(best[key], log_probability=p) for key, p in ranked[:width]]


def search_exactly(beam_of: Callable[[int], list[Hypothesis]]) -> tuple[np.ndarray, bool]:
    """Find the likeliest of all 2^S sets, bool[S], and whether it is proven to be the likeliest.

    Beam probabilities are lower bounds, and pruned hypotheses have total probability m. So if
    p(best) > p(second) + m, no other set is likelier. Beams of growing widths, ``beam_of(width)``,
    are searched until that holds; otherwise the set is from the widest.
    """
    beam: list[Hypothesis] = []
    for width in PROOF_WIDTHS:
        beam = beam_of(width)
        best, *others = (float(np.exp(h.log_probability)) for h in beam)
        pruned = max(1.0 - best - sum(others), 0.0)
        if best > (others or [0.0])[0] + pruned + 1e-9:
            return beam[0].expressed, True
    return beam[0].expressed, False


Key = TypeVar("Key", bound=Hashable)


def sum_by_key(
    terms: Iterable[tuple[Key, float]], add: Callable[[float, float], Any] = operator.add
) -> list[tuple[Key, float]]:
    """Sum values by key (logarithms with ``np.logaddexp``), sorted largest first."""
    total: dict[Key, float] = {}
    for key, value in terms:
        total[key] = float(add(total[key], value)) if key in total else value
    return sorted(total.items(), key=lambda item: -item[1])
