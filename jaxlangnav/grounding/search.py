"""Beam search for the likeliest expressed sets, bottom-up over the phrases (section 3.1).

Given what the child phrases express, the factors of a phrase are independent, so its k best sets
follow exactly from the margins |log-odds|. The only approximation is the beam: of each phrase's
sets, and of the combinations of its children's, the best ``width`` are kept.

Several models, as the splits of a hold-out, go through the tree together: what a phrase's symbols
are like does not depend on the model, so each distinct choice of child sets is described once.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from jaxlangnav.language.phrase import Phrase

BEAM_WIDTH = 4
PROOF_WIDTHS = (4, 16, 64, 256)
"""Beam widths tried until the likeliest set is proven to be it."""
Children = tuple[np.ndarray, ...]
"""bool[S] for each child phrase."""
LogOdds = Callable[[tuple[int, ...], Children, np.ndarray], np.ndarray]
"""Path of a phrase, child sets, i[M] models → log-odds f64[M, S]; −inf excludes a symbol."""
_KEYS = np.random.default_rng(0).integers(1, 2**64, 1 << 14, np.uint64, endpoint=False)
"""A set is told from others by the sum of its symbols' numbers: two of a search's sets share one
with a chance of 10⁻¹⁰."""


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


@dataclasses.dataclass(frozen=True)
class Beams:
    """What a phrase may express by each of K models: up to W sets, best first."""

    sets: np.ndarray  # bool[D, S] distinct sets
    index: np.ndarray  # i[K, W] which of the sets
    log_probability: np.ndarray  # f64[K, W] −inf where the beam has ended
    origin: np.ndarray  # i[K, W, C] which hypothesis of each child it rests on
    children: tuple["Beams", ...]

    def of(self, model: int) -> list[Hypothesis]:
        """Read the beam of one model, best first; what is missing to one was cut."""
        count = int(np.isfinite(self.log_probability[model]).sum())
        return [self._hypothesis(model, place) for place in range(count)]

    def _hypothesis(self, model: int, place: int) -> Hypothesis:
        below = zip(self.children, self.origin[model, place], strict=True)
        return Hypothesis(
            self.sets[self.index[model, place]],
            float(self.log_probability[model, place]),
            tuple(child._hypothesis(model, origin) for child, origin in below),
        )


_ROWS = 1 << 16
"""Rows that are hashed at a time."""


def identify(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find equal rows of f32[N, F]: i[D] where each distinct row first is, i[N] which one each is.

    Rows are told apart by a random 64-bit hash of their bits, some hundred times faster than
    sorting whole rows; that no two different rows share one is checked.
    """

    def bits(part: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(part, np.float32).view(np.uint32).astype(np.uint64)

    parts = np.array_split(rows, -(-len(rows) // _ROWS) or 1)  # so that copies stay small
    for seed in range(8):
        generator = np.random.default_rng(seed)
        factors = generator.integers(1, 2**64, rows.shape[1], np.uint64, endpoint=False)
        keys = np.concatenate([bits(part) @ factors for part in parts])
        _, first, which = np.unique(keys, return_index=True, return_inverse=True)
        which = which.ravel()
        alike = np.array_split(first[which], len(parts))
        if all((rows[one] == part).all() for one, part in zip(alike, parts, strict=True)):
            return first, which
    raise AssertionError("eight random hashes of 64 bits collide")


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


def _best_sets(log_odds: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the k likeliest sets of M rows of factors f64[M, S], exactly, best first."""
    # Each set is the best one with some factors flipped; a flip costs its margin. Returned are
    # f64[M, k] log-probabilities, −inf beyond the last; u64[M, k] keys of the sets; i[M, k, n] the
    # symbols that differ from the likeliest set, S where there is none.
    size = log_odds.shape[1]
    margins = np.abs(log_odds)
    top = -np.logaddexp(0.0, -margins).sum(1)
    order = np.argsort(margins, axis=1, kind="stable")[:, :width]
    table = _flips(width)[:, : order.shape[1]]
    table = table[~_flips(width)[:, order.shape[1] :].any(1)]
    cheapest = np.take_along_axis(margins, order, 1)
    is_free = np.isfinite(cheapest)
    cost = np.where(is_free, cheapest, 0.0) @ table.T
    cost[(~is_free).astype(float) @ table.T > 0] = np.inf
    choice = np.argsort(cost, axis=1, kind="stable")[:, :width]
    best = log_odds > 0
    keys = _KEYS[:size]
    change = np.where(np.take_along_axis(best, order, 1), -keys[order], keys[order])
    key = np.where(best, keys, np.uint64(0)).sum(1)[:, None] + change @ table.T.astype(np.uint64)
    flipped = np.where(table[choice], order[:, None], size)
    score = top[:, None] - np.take_along_axis(cost, choice, 1)
    return score, np.take_along_axis(key, choice, 1), flipped


def _combinations(beams: Sequence[Beams], num_models: int, width: int) -> tuple:
    """Combine the children's hypotheses: f64[K, J] scores, best first, i[K, J, C] which ones."""
    score, chosen = np.zeros((num_models, 1)), np.zeros((num_models, 1, 0), int)
    for beam in beams:
        own = beam.log_probability.shape[1]
        joint = (score[:, :, None] + beam.log_probability[:, None]).reshape(num_models, -1)
        order = np.argsort(-joint, axis=1, kind="stable")[:, :width]
        score = np.take_along_axis(joint, order, 1)
        before = np.take_along_axis(chosen, (order // own)[..., None], 1)
        chosen = np.concatenate([before, (order % own)[..., None]], axis=2)
    return score, chosen


def _merge(score: np.ndarray, key: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Add up equal sets of each model, keep the best: f64[K, W], and i[K, W] likeliest of each."""
    num_models, count = score.shape
    likeliest = np.argsort(-score, axis=1, kind="stable")
    by_score = np.take_along_axis(key, likeliest, 1)
    alike = np.argsort(by_score, axis=1, kind="stable")
    sorted_key = np.take_along_axis(by_score, alike, 1)
    is_first = np.ones((num_models, count), bool)
    is_first[:, 1:] = sorted_key[:, 1:] != sorted_key[:, :-1]
    sorted_score = np.take_along_axis(np.take_along_axis(score, likeliest, 1), alike, 1)
    begin = np.flatnonzero(is_first)
    total = np.full((num_models, count), -np.inf)
    place = np.zeros((num_models, count), int)
    model, first = begin // count, alike.ravel()[begin]
    total[model, first] = np.logaddexp.reduceat(sorted_score.ravel(), begin)
    place[model, first] = likeliest[model, first]
    order = np.argsort(-total, axis=1, kind="stable")[:, :width]
    return np.take_along_axis(total, order, 1), np.take_along_axis(place, order, 1)


def search(
    root: Phrase,
    log_odds: LogOdds,
    num_models: int,
    *,
    width: int = BEAM_WIDTH,
    path: tuple[int, ...] = (),
) -> Beams:
    """Infer the distribution of what a phrase at ``path`` expresses, by each of K models.

    Children are searched first. Up to ``width`` sets of each; probabilities are not renormalised.
    """
    children = tuple(
        search(child, log_odds, num_models, width=width, path=(*path, i))
        for i, child in enumerate(root.children)
    )
    score, chosen = _combinations(children, num_models, width)
    model, place = np.nonzero(np.isfinite(score))
    sets = [
        child.index[model, chosen[model, place, i]] for i, child in enumerate(children)
    ]  # of every row: a model with a combination
    odds = _evaluate(log_odds, path, children, sets, model)
    own, key, flipped = _best_sets(odds, width)
    joint = np.full((*score.shape, own.shape[1]), -np.inf)
    keys = np.zeros(joint.shape, np.uint64)
    joint[model, place] = score[model, place, None] + own
    keys[model, place] = key
    flat = num_models, -1
    total, candidate = _merge(joint.reshape(flat), keys.reshape(flat), width)
    row = np.full(score.shape, -1)
    row[model, place] = np.arange(len(model))
    combination, which = candidate // own.shape[1], candidate % own.shape[1]
    lane = np.arange(num_models)[:, None]
    distinct, first, index = np.unique(
        keys.reshape(flat)[lane, candidate], return_index=True, return_inverse=True
    )
    owner, slot = np.unravel_index(first, candidate.shape)
    rows = row[owner, combination[owner, slot]]
    expressed = np.pad(odds[rows] > 0, ((0, 0), (0, 1)))
    at = np.arange(len(distinct))[:, None], flipped[rows, which[owner, slot]]
    expressed[at] ^= True
    return Beams(
        sets=expressed[:, :-1],
        index=index.reshape(candidate.shape),
        log_probability=total,
        origin=chosen[lane, combination],
        children=children,
    )


def _evaluate(
    log_odds: LogOdds,
    path: tuple[int, ...],
    children: Sequence[Beams],
    sets: Sequence[np.ndarray],
    model: np.ndarray,
) -> np.ndarray:
    """Evaluate the log-odds f64[M, S] of rows, equal child sets once for all models."""
    code = np.zeros(len(model), int)
    for child, index in zip(children, sets, strict=True):
        code = code * len(child.sets) + index
    order = np.argsort(code, kind="stable")
    begin = np.flatnonzero(np.diff(code[order], prepend=-1))
    parts = []
    for rows in np.split(order, begin[1:]):
        below = tuple(
            child.sets[index[rows[0]]] for child, index in zip(children, sets, strict=True)
        )
        parts.append(log_odds(path, below, model[rows]))
    odds = np.empty((len(model), parts[0].shape[1]))
    odds[order] = np.concatenate(parts)
    return odds


def search_exactly(
    beams_of: Callable[[int, np.ndarray], Beams], num_models: int
) -> tuple[np.ndarray, np.ndarray]:
    """Find the likeliest of all 2^S sets by each model, and whether it is proven to be.

    What a beam finds are lower bounds, and what it misses adds up to the rest m of the probability.
    So where p(best) > p(second) + m, no other set is likelier, found or not. Wider and wider beams
    are searched until that holds.

    Args:
        beams_of: beam width, i[M] models → beams of those models.
        num_models: K.

    Returns:
        bool[K, S], the likeliest sets, and bool[K], proven; if not, they are of the widest beam.
    """
    open_models, is_proven = np.arange(num_models), np.zeros(num_models, bool)
    best: list[np.ndarray] = [np.zeros(0, bool)] * num_models
    for width in PROOF_WIDTHS:
        beams = beams_of(width, open_models)
        for place, model in enumerate(open_models):
            best[model] = beams.sets[beams.index[place, 0]]
            chances = np.exp(beams.log_probability[place])
            missed = max(1.0 - float(chances.sum()), 0.0)
            second = float(chances[1]) if len(chances) > 1 else 0.0
            is_proven[model] = chances[0] > second + missed + 1e-9
        open_models = open_models[~is_proven[open_models]]
        if not len(open_models):
            break
    return np.stack(best), is_proven
