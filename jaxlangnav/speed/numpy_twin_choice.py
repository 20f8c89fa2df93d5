"""Which way to go, in plain NumPy: the second half of the benchmark's twin (sections 3.3 and 3.4).

Goals by the behavior model in every particle, waypoints from the frontier, and the search map and
tours of the informed policy, after ``planner.goals``, ``planner.graph`` and ``planner.search``.
"""

import dataclasses
import math

import numpy as np

Arrays = dict[str, np.ndarray]
DETECTION = 0.95
"""Probability of detecting something in view."""
_DISCOUNT = 0.8
_PHRASES = 6
_CELLS, _LATTICE, _TOURS, _STOPS = 12, 6, 3, 5


@dataclasses.dataclass
class Twin:
    """State of the twin."""

    random: np.random.Generator
    particles: Arrays
    """Leaves [..., P]."""
    log_weight: np.ndarray
    log_miss: np.ndarray
    """f64[G, G], y cell first."""
    area: tuple[float, float, float, float]


def centres(twin: Twin) -> tuple[np.ndarray, np.ndarray]:
    """Compute the centres of the cells."""
    steps = np.arange(twin.log_miss.shape[0]) + 0.5
    x_min, x_max, y_min, y_max = twin.area
    size = twin.log_miss.shape[0]
    return x_min + steps * (x_max - x_min) / size, y_min + steps * (y_max - y_min) / size


def _goals(own: Arrays) -> tuple[np.ndarray, np.ndarray]:
    """Infer the probability that each object is the goal, phrase by phrase, by log-odds."""
    is_object = np.concatenate([own["type"] != -1, own["referent"] == -1])
    kinds = np.concatenate([own["type"], np.tile([[0], [1]], own["type"].shape[1])])
    log_odds = np.zeros(kinds.shape)
    for phrase in range(_PHRASES):
        objects = np.where(kinds == phrase % 2, 4.0 - phrase * 0.1, -4.0)
        regions = np.where(
            kinds[None] == phrase % 2, np.linspace(-4.0, 4.0, 7)[:, None, None], -4.0
        )
        odds = np.concatenate([objects[None], regions]).reshape(-1, kinds.shape[1])
        # The four best sets follow from the three correspondences that are least certain.
        margins = np.partition(np.abs(odds), 2, axis=0)[:3]
        best = -np.sum(np.logaddexp(0.0, -np.abs(odds)), axis=0)
        beams = best - np.stack([0.0 * margins[0], *margins])
        certainty = np.exp(beams[0] - np.logaddexp.reduce(beams, axis=0))
        log_odds += certainty * -np.logaddexp(0.0, np.where(kinds == 0, -objects, objects))
    mass = np.where(is_object & (kinds == 0), np.exp(log_odds), 0.0)
    mass /= np.maximum(mass.sum(axis=0), 1e-9)
    place = np.concatenate([own["mean"][:, :-1], own["hypothesis"]], axis=1)
    return mass, place


def _frontiers(twin: Twin, num_blocks: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Gather frontier cells into one waypoint per block."""
    unexplored = twin.log_miss > twin.log_miss.max() + math.log(0.5)
    padded = np.pad(~unexplored, 1)
    beside = padded[2:, 1:-1] | padded[:-2, 1:-1] | padded[1:-1, 2:] | padded[1:-1, :-2]
    frontier = (unexplored & beside).astype(float)
    size = frontier.shape[0] // num_blocks
    x, y = centres(twin)

    def by_block(values: np.ndarray) -> np.ndarray:
        return values.reshape(num_blocks, size, num_blocks, size).sum(axis=(1, 3)).ravel()

    count = by_block(frontier)
    total = np.stack([by_block(frontier * x[None, :]), by_block(frontier * y[:, None])])
    return total / np.maximum(count, 1.0), count > 0


def twin_choose(
    twin: Twin, robot: np.ndarray, weight: np.ndarray, sensing_range: float, parts: list[slice]
) -> np.ndarray:
    """Choose a waypoint by the goals of all particles and by what a tour of looks would find.

    Args:
        twin: after the filter.
        robot: f64[2], metres.
        weight: f64[P].
        sensing_range: metres.
        parts: particles to be worked on at a time.

    Returns:
        f64[2], the waypoint, metres.
    """
    nodes, is_node = _frontiers(twin)
    nodes = np.concatenate([nodes, twin.particles["mean"][:, :-1, 0]], axis=1)
    is_node = np.concatenate([is_node, twin.particles["type"][:, 0] != -1])
    value = np.zeros(nodes.shape[1])
    found, free, hung = 0.0, 0.0, np.zeros(_CELLS**2)
    for part in parts:
        own = {name: leaf[..., part] for name, leaf in twin.particles.items()}
        mass, place = _goals(own)
        best = np.argmax(mass, axis=0)
        goal = np.take_along_axis(place, best[None, None, :], axis=1)[:, 0]
        share = np.max(mass, axis=0) * weight[part]
        distance = np.hypot(nodes[0][:, None] - goal[0], nodes[1][:, None] - goal[1])
        value += np.sum(share * _DISCOUNT**distance, axis=1)
        found += float(np.sum(np.where(best < own["type"].shape[0], share, 0.0)))
        free += _fold(twin, own, weight[part], hung)
    if found < 0.5:
        return _tour(twin, robot, _unseen(twin, free) + hung, sensing_range)
    value = np.where(is_node, value, -np.inf)
    return nodes[:, int(np.argmax(value))]


def _fold(twin: Twin, own: Arrays, weight: np.ndarray, hung: np.ndarray) -> float:
    """Enter hypotheses that hang on something seen; sum the weight of those that do not."""
    x_min, x_max, y_min, y_max = twin.area
    is_open = own["referent"] == -1
    is_free = np.all(is_open, axis=0)
    x, y = own["hypothesis"]
    column = np.clip(np.floor((x - x_min) / (x_max - x_min) * _CELLS), 0, _CELLS - 1)
    row = np.clip(np.floor((y - y_min) / (y_max - y_min) * _CELLS), 0, _CELLS - 1)
    cell = (row * _CELLS + column).astype(int)
    np.add.at(hung, cell.ravel(), np.where(is_open & ~is_free, weight, 0.0).ravel())
    return float(np.sum(weight[is_free]))


def _unseen(twin: Twin, free: float) -> np.ndarray:
    """Spread what hangs on nothing over what has not been looked at, f64[cells]."""
    miss = np.exp(twin.log_miss)
    size = miss.shape[0] // _CELLS
    unseen = miss.reshape(_CELLS, size, _CELLS, size).sum(axis=(1, 3)).ravel()
    return free * unseen / max(unseen.sum(), 1e-9)


def _grid(twin: Twin, number: int) -> np.ndarray:
    """Place number × number points over the area, f64[2, points]."""
    x_min, x_max, y_min, y_max = twin.area
    steps = (np.arange(number) + 0.5) / number
    x, y = x_min + steps * (x_max - x_min), y_min + steps * (y_max - y_min)
    return np.stack([np.tile(x, number), np.repeat(y, number)])


def _tour(twin: Twin, robot: np.ndarray, mass: np.ndarray, sensing_range: float) -> np.ndarray:
    """Take the first viewpoint of the tour that finds things soonest."""
    cells, views = _grid(twin, _CELLS), _grid(twin, _LATTICE)
    x_min, x_max, y_min, y_max = twin.area
    softness = 0.5 * (x_max - x_min + y_max - y_min) / _CELLS

    def in_view(distance: np.ndarray) -> np.ndarray:
        return np.clip((sensing_range - distance) / softness + 0.5, 0.0, 1.0)

    span = views - robot[:, None]
    length = np.sum(span**2, axis=0) + 1e-9
    offset = cells[:, None] - robot[:, None, None]
    along = np.clip(np.sum(offset * span[:, :, None], axis=0) / length[:, None], 0.0, 1.0)
    on_way = in_view(np.hypot(*(offset - along * span[:, :, None])))
    revealed, distance = on_way @ mass, np.sqrt(length)
    rate = revealed / (distance + 1.0)
    sees = in_view(np.hypot(*(views[:, :, None] - cells[:, None])))
    between = np.hypot(*(views[:, :, None] - views[:, None]))
    totals = []
    firsts = np.argpartition(-rate, _TOURS)[:_TOURS]
    for first in firsts:
        left, here, walked = mass * (1.0 - on_way[first]), first, distance[first]
        total = revealed[first] * walked
        for _ in range(_STOPS):
            gain = sees @ left
            best = int(np.argmax(gain / (between[here] + 1.0)))
            walked += between[here, best]
            total += gain[best] * walked
            left, here = left * (1.0 - sees[best]), best
        spread = np.mean(left > 0.1 * mass.mean()) * (x_max - x_min) * (y_max - y_min)
        totals.append(total + left.sum() * (walked + spread / (4.0 * sensing_range)))
    return views[:, firsts[int(np.argmin(totals))]]
