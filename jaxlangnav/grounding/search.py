"""Beam search for the likeliest expressed sets, bottom-up over the phrases (section 3.1).

Given what the child phrases express, the factors of a phrase are independent, so its k best sets
follow exactly from the margins |log-odds|. The only approximation is the beam: of each phrase's
sets, and of the combinations of its children's, the best ``width`` are kept.
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
"""Beam widths tried until the likeliest set is proven to be it."""
Children = tuple[np.ndarray, ...]
"""bool[S] for each child phrase."""
LogOdds = Callable[[tuple[int, ...], Children], np.ndarray]
"""Path of a phrase, child sets → log-odds f64[S]; −inf excludes a symbol."""


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """What a phrase may express, with the child hypotheses it rests on."""

    expressed: np.ndarray  # bool[S]
    log_probability: float  # of it and of all below it
    children: tuple["Hypothesis", ...] = ()

    def walk(self, path: tuple[int, ...]) -> Iterator[tuple[tuple[int, ...], "Hypothesis"]]:
        """Yield it and all below it with the paths of their phrases, parents first."""
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
        if last + 1 < len(order):  # dearer: one factor more, or the next one for the last
            for dearer in {(*choice, last + 1), (*choice[:-1], last + 1)}:
                total = float(margins[order[list(dearer)]].sum())
                heapq.heappush(choices, (total, last + 1, dearer))


def search(
    root: Phrase, log_odds: LogOdds, *, width: int = BEAM_WIDTH, path: tuple[int, ...] = ()
) -> list[Hypothesis]:
    """Infer what a phrase at ``path`` expresses: up to ``width`` sets, best first.

    Children are searched first. Probabilities are not renormalised: what is missing to one was cut.
    """
    below: list[tuple[tuple[Hypothesis, ...], float]] = [((), 0.0)]
    for i, child in enumerate(root.children):
        beam = search(child, log_odds, width=width, path=(*path, i))
        pairs = itertools.product(below, beam)
        joint = [((*some, one), score + one.log_probability) for (some, score), one in pairs]
        below = sorted(joint, key=lambda pair: -pair[1])[:width]
    found = [
        Hypothesis(expressed, score + own, some)
        for some, score in below
        for expressed, own in _best_sets(log_odds(path, tuple(c.expressed for c in some)), width)
    ]
    found.sort(key=lambda one: -one.log_probability)
    # Equal sets add up; the likeliest of the children that they rest on stand for all.
    ranked = add_up(((one.expressed.tobytes(), one.log_probability) for one in found), np.logaddexp)
    first = {one.expressed.tobytes(): one for one in reversed(found)}
    return [dataclasses.replace(first[key], log_probability=p) for key, p in ranked[:width]]


def search_exactly(beam_of: Callable[[int], list[Hypothesis]]) -> tuple[np.ndarray, bool]:
    """Find the likeliest of all 2^S sets, bool[S], and whether it is proven to be.

    What a beam finds are lower bounds, and what it misses adds up to the rest m of the probability.
    So where p(best) > p(second) + m, no other set is likelier, found or not. Wider and wider beams,
    ``beam_of`` a width, are searched until that holds; if not, the set is of the widest.
    """
    beam: list[Hypothesis] = []
    for width in PROOF_WIDTHS:
        beam = beam_of(width)
        best, *others = (float(np.exp(one.log_probability)) for one in beam)
        missed = max(1.0 - best - sum(others), 0.0)
        if best > (others or [0.0])[0] + missed + 1e-9:
            return beam[0].expressed, True
    return beam[0].expressed, False


Key = TypeVar("Key", bound=Hashable)


def add_up(
    shares: Iterable[tuple[Key, float]], add: Callable[[float, float], Any] = operator.add
) -> list[tuple[Key, float]]:
    """Sum the shares of equal keys, or add their logarithms by ``np.logaddexp``; largest first."""
    total: dict[Key, float] = {}
    for key, share in shares:
        total[key] = float(add(total[key], share)) if key in total else share
    return sorted(total.items(), key=lambda item: -item[1])
