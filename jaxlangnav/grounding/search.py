"""Beam search for the likeliest expressed sets, bottom-up over the phrases (section 3.1).

Given what the child phrases express, the factors of a phrase are independent, so its k best sets
follow exactly from the margins |log-odds|. The only approximation is the beam: of each phrase's
sets, and of the combinations of its children's, the best ``width`` are kept.
"""

import dataclasses
import functools
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


@functools.lru_cache
def _flips(width: int) -> np.ndarray:
    """List every choice of factors that may be among the k cheapest to flip, bool[P, k] by cost."""
    # A choice cannot be where as many others are never dearer: those that flip, from the dearest
    # on, no more factors and none of higher cost.
    found, layer = [()], [(0,)] if width > 1 else []
    while layer:
        found += layer
        grown = {(*one, one[-1] + 1) for one in layer} | {(*one[:-1], one[-1] + 1) for one in layer}
        layer = sorted(one for one in grown if _num_below(one) < width)
    found.sort(key=lambda one: (one[-1:], one))
    table = np.zeros((len(found), width), bool)
    for row, one in zip(table, found, strict=True):
        row[list(one)] = True
    return table


def _num_below(choice: tuple[int, ...]) -> int:
    """Count the other choices that are never dearer than this one."""
    ways = np.array([1])  # by how many factors have been chosen, from the dearest down
    for factor in range(choice[-1], -1, -1):
        room = sum(one >= factor for one in choice)
        longer = np.zeros(room + 1, int)
        longer[: len(ways)] += ways
        upper = ways[:room]
        longer[1 : 1 + len(upper)] += upper
        ways = longer
    return int(ways.sum()) - 1


def _best_sets(log_odds: np.ndarray, width: int) -> Iterator[tuple[np.ndarray, float]]:
    """Yield the k likeliest sets of factors f64[S] and their log-probabilities, best first."""
    # Each set is the best one with some factors flipped; a flip costs its margin.
    best, margins = log_odds > 0, np.abs(log_odds)
    top = -np.logaddexp(0.0, -margins).sum()
    order = np.argsort(margins, kind="stable")[:width]
    table = _flips(width)[:, : len(order)]
    table = table[~_flips(width)[:, len(order) :].any(1)]
    is_free = np.isfinite(margins[order])
    cost = table @ np.where(is_free, margins[order], 0.0)
    cost[table[:, ~is_free].any(1)] = np.inf
    for choice in np.argsort(cost, kind="stable")[:width]:
        if np.isfinite(cost[choice]):
            expressed = best.copy()
            expressed[order[table[choice]]] ^= True
            yield expressed, float(top - cost[choice])


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
