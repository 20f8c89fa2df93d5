"""The navigator's decision cycle in plain NumPy: what the engine's speed is measured against.

It does the main work of ``navigator.step`` for one relation ("the figure behind the landmark") in
the order of section 3: move, ground detections, condition the joint Gaussian, weigh what was and
was not seen, ground the words anew in refuted particles, resample, infer the goal in every
particle, choose among frontiers, objects and the tours of the informed policy
(``numpy_twin_choice``). It leaves out several readings, superlatives, the children's beams of the
behavior model, constraints and the bookkeeping of anchors, so it does *less* than the engine:
ratios against it are on the safe side. It serves the benchmark only; nothing navigates with it.

``step`` runs over all particles at once, or, with ``is_looping``, over one after the other, as a
first implementation would. Arrays carry the particle axis last: O objects, M mentions (0 the
figure, 1 the landmark), A waypoints, G cells a side, P particles.
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
_ALPHA, _SIGMA = 0.3, 0.1
_BEHIND_DISTANCE, _BEHIND_SPREAD, _BEHIND_ANGLE = 2.5, 0.3, 0.35


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


def start(num_particles: int, *, seed: int, num_objects: int = 8, num_cells: int = 36) -> Twin:
    """Build the twin before its first look.

    Args:
        num_particles: P.
        seed: of its random numbers.
        num_objects: O.
        num_cells: G.

    Returns:
        The twin at the origin of a 13 m deep area.
    """
    size, number = num_objects + 1, num_particles
    precision = np.tile(np.eye(size)[:, :, None], (1, 1, number))
    precision[-1, -1] = 1e4
    particles = {
        "type": np.full((num_objects, number), -1),
        "precision": precision,
        "information": np.zeros((2, size, number)),
        "mean": np.zeros((2, size, number)),
        "hypothesis": np.zeros((2, 2, number)),
        "referent": np.full((2, number), -1),
    }
    twin = Twin(
        random=np.random.default_rng(seed),
        particles=particles,
        log_weight=np.full(number, -math.log(number)),
        log_miss=np.zeros((num_cells, num_cells)),
        area=(0.0, 13.0, -9.2, 9.2),
    )
    twin.particles |= _ground(twin, particles)
    return twin


def step(
    twin: Twin,
    move: np.ndarray,
    detections: list[tuple[int, float, float]],
    sensing_range: float,
    *,
    is_looping: bool,
) -> np.ndarray:
    """Run one decision cycle.

    Args:
        twin: the state; changed in place.
        move: f64[2], odometry since the last cycle, metres.
        detections: type and offset from the robot of everything detected, metres, map axes.
        sensing_range: metres.
        is_looping: one particle after the other.

    Returns:
        f64[2], the waypoint chosen, metres.
    """
    number = twin.log_weight.shape[0]
    parts = [slice(p, p + 1) for p in range(number)] if is_looping else [slice(0, number)]
    filtered, gains = [], []
    for part in parts:
        own = {name: leaf[..., part] for name, leaf in twin.particles.items()}
        own, gain = _filter(twin, own, move, detections, sensing_range)
        filtered.append(own)
        gains.append(gain)
    _join(twin, filtered)
    robot = np.sum(twin.particles["mean"][:, -1] * np.exp(twin.log_weight), axis=-1)
    _look(twin, robot, sensing_range)
    log_weight = twin.log_weight + np.concatenate(gains)
    log_weight -= log_weight.max()
    weight = np.exp(log_weight) / np.exp(log_weight).sum()
    weight = _revive(twin, weight, parts)
    if 1.0 / np.sum(weight**2) < 0.5 * number:
        chosen = np.searchsorted(
            np.cumsum(weight), (np.arange(number) + twin.random.random()) / number
        )
        chosen = np.minimum(chosen, number - 1)
        twin.particles = {name: leaf[..., chosen] for name, leaf in twin.particles.items()}
        weight = np.full(number, 1.0 / number)
    twin.log_weight = np.log(np.maximum(weight, 1e-30))
    return twin_choose(twin, robot, weight, sensing_range, parts)


def _join(twin: Twin, parts: list[Arrays]) -> None:
    """Put particles back together."""
    twin.particles = {
        name: np.concatenate([part[name] for part in parts], axis=-1) for name in parts[0]
    }


def _filter(
    twin: Twin,
    own: Arrays,
    move: np.ndarray,
    detections: list[tuple[int, float, float]],
    sensing_range: float,
) -> tuple[Arrays, np.ndarray]:
    """Move, ground and condition on detections, weigh absences."""
    own = {name: leaf.copy() for name, leaf in own.items()}
    number, num_objects = own["type"].shape[-1], own["type"].shape[0]
    _move(own, move)
    covariance = np.linalg.inv(np.moveaxis(own["precision"], -1, 0))
    variance = np.diagonal(covariance, axis1=1, axis2=2).T
    spread = variance[:-1] + variance[-1] - 2.0 * covariance[:, -1, :-1].T + _SIGMA**2
    gain = np.zeros(number)
    hit = np.zeros((num_objects, number), bool)
    lanes = np.arange(number)
    for kind, x, y in detections:
        choice, log_total = _choose(twin, own, (own["type"] == kind) & ~hit, (x, y), spread)
        gain += log_total
        free = np.argmax(own["type"] == -1, axis=0)
        slot = np.where(choice == num_objects, free, choice)
        is_new = choice == num_objects
        own["type"][slot, lanes] = kind
        hit[slot, lanes] = True
        own["precision"][slot, slot, lanes] += 1.0 / _SIGMA**2 - is_new
        own["precision"][-1, -1] += 1.0 / _SIGMA**2
        own["precision"][slot, -1, lanes] -= 1.0 / _SIGMA**2
        own["precision"][-1, slot, lanes] -= 1.0 / _SIGMA**2
        for axis, value in enumerate((x, y)):
            own["information"][axis, slot, lanes] += value / _SIGMA**2
            own["information"][axis, -1] -= value / _SIGMA**2
        for mention in (0, 1):
            refers = (own["referent"][mention] == -1) & (kind == mention)
            own["referent"][mention] = np.where(refers, slot, own["referent"][mention])
    covariance = np.linalg.inv(np.moveaxis(own["precision"], -1, 0))
    own["mean"] = np.einsum("pij,kjp->kip", covariance, own["information"])
    gain += _absence(own["mean"][:, :-1], own, (own["type"] != -1) & ~hit, sensing_range)
    gain += _absence(own["hypothesis"], own, own["referent"] == -1, sensing_range)
    return own, gain


def _choose(
    twin: Twin, own: Arrays, may_be: np.ndarray, place: tuple[float, float], spread: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Draw what a detection at a place is taken for: i[P] a slot, or O; f[P] the log of all."""
    offset = own["mean"][:, :-1] - own["mean"][:, -1:]
    squared = (place[0] - offset[0]) ** 2 + (place[1] - offset[1]) ** 2
    log_old = -0.5 * squared / spread - np.log(2.0 * math.pi * spread)
    log_old = np.where(may_be, log_old, -np.inf)
    number = may_be.shape[1]
    log_new = np.full((1, number), math.log(_ALPHA / 240.0))
    choices = np.concatenate([log_old, log_new])
    top = choices.max(axis=0)
    share = np.cumsum(np.exp(choices - top), axis=0)
    choice = np.sum(share < twin.random.random(number) * share[-1], axis=0)
    return choice, top + np.log(share[-1])


def _move(own: Arrays, move: np.ndarray) -> None:
    """Add a robot pose and marginalise the last one out."""
    variance = (0.02**2) * float(move @ move) + 1e-12
    precision, information = own["precision"], own["information"]
    edge = 1.0 / variance
    last = precision[-1, -1] + edge
    row, mean = precision[-1, :-1].copy(), information[:, -1].copy()
    precision[:-1, :-1] -= row[:, None] * row[None, :] / last
    precision[:-1, -1] = row * edge / last
    precision[-1, :-1] = row * edge / last
    precision[-1, -1] = edge - edge * edge / last
    shifted = mean - edge * move[:, None]
    information[:, :-1] -= row[None] * shifted[:, None] / last
    information[:, -1] = edge * move[:, None] + edge * shifted / last
    own["mean"][:, -1] += move[:, None]


def _absence(
    place: np.ndarray, own: Arrays, is_missed: np.ndarray, sensing_range: float
) -> np.ndarray:
    """Weigh everything that should have been seen and was not."""
    offset = place - own["mean"][:, -1:]
    distance = np.sqrt(offset[0] ** 2 + offset[1] ** 2 + 1e-9)
    view = np.clip((sensing_range - distance) / 0.25 + 0.5, 0.0, 1.0)
    return np.sum(np.where(is_missed, np.log1p(-DETECTION * view), 0.0), axis=0)


def _look(twin: Twin, robot: np.ndarray, sensing_range: float) -> None:
    """Enter a look into the coverage."""
    x, y = centres(twin)
    distance = np.sqrt((x[None, :] - robot[0]) ** 2 + (y[:, None] - robot[1]) ** 2)
    share = np.clip((sensing_range - distance) / 0.6 + 0.5, 0.0, 1.0)
    twin.log_miss = np.maximum(twin.log_miss + np.log1p(-DETECTION * share), -30.0)


def _log_miss_at(twin: Twin, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Look up the probability of having missed something."""
    size = twin.log_miss.shape[0]
    x_min, x_max, y_min, y_max = twin.area
    column = np.floor((x - x_min) / (x_max - x_min) * size).astype(int)
    row = np.floor((y - y_min) / (y_max - y_min) * size).astype(int)
    is_in = (column >= 0) & (column < size) & (row >= 0) & (row < size)
    found = twin.log_miss[np.clip(row, 0, size - 1), np.clip(column, 0, size - 1)]
    return np.where(is_in, found, -np.inf)


def _log_behind(x: np.ndarray, y: np.ndarray, at_x: np.ndarray, at_y: np.ndarray) -> np.ndarray:
    """Evaluate "behind" for a figure offset by (x, y) from a landmark seen from the origin."""
    away = np.sqrt(at_x**2 + at_y**2 + 1e-9)
    along, lateral = (x * at_x + y * at_y) / away, (y * at_x - x * at_y) / away
    distance = np.sqrt(along**2 + lateral**2 + 1e-9)
    cosine = along / distance
    log_distance = (np.log(distance / _BEHIND_DISTANCE) / _BEHIND_SPREAD) ** 2
    return cosine / _BEHIND_ANGLE**2 - 0.5 * log_distance - 2.0 * np.log(distance) - 6.0


def _ground(twin: Twin, own: Arrays) -> Arrays:
    """Draw figure and landmark jointly: observed or new, each option by its weight."""
    number, num_objects = own["type"].shape[-1], own["type"].shape[0]
    unseen_weight = np.exp(twin.log_miss).ravel()
    comb = twin.random.random(number) * unseen_weight.sum()
    cell = np.minimum(np.searchsorted(np.cumsum(unseen_weight), comb), unseen_weight.size - 1)
    centre_x, centre_y = centres(twin)
    rows, columns = np.divmod(cell, twin.log_miss.shape[0])
    unseen = np.stack([centre_x[columns], centre_y[rows]])
    turn = _BEHIND_ANGLE * twin.random.normal(size=number)
    way = _BEHIND_DISTANCE * np.exp(_BEHIND_SPREAD * twin.random.normal(size=number))
    log_bystander = math.log(240.0 / _ALPHA)
    place = own["mean"][:, :-1]
    is_figure, is_landmark = own["type"] == 0, own["type"] == 1
    known = _log_behind(
        place[0][:, None] - place[0][None],
        place[1][:, None] - place[1][None],
        place[0][None],
        place[1][None],
    )
    known = np.where(is_figure[:, None] & is_landmark[None], known + 2 * log_bystander, -np.inf)
    hung = _hang(place, turn, way)
    log_figure = _log_miss_at(twin, *hung) + np.where(is_landmark, log_bystander, -np.inf)
    back = 2.0 * place - hung
    log_landmark = _log_miss_at(twin, *back) + np.where(is_figure, log_bystander, -np.inf)
    pair = _hang(unseen[:, None], turn, way)
    log_pair = np.log(unseen_weight.mean()) + _log_miss_at(twin, *pair)
    flat = known.reshape(num_objects**2, number)
    choices = np.maximum(np.concatenate([flat, log_figure, log_landmark, log_pair]), -60.0)
    share = np.cumsum(np.exp(choices - choices.max(axis=0)), axis=0)
    choice = np.sum(share < twin.random.random(number) * share[-1], axis=0)
    lanes, rest = np.arange(number), choice - num_objects**2
    on_figure = (rest >= 0) & (rest < num_objects)
    on_landmark = (rest >= num_objects) & (rest < 2 * num_objects)
    slot = np.where(rest < 0, choice % num_objects, rest % num_objects)
    figure = np.where(on_figure, hung[:, slot, lanes], pair[:, 0])
    figure = np.where(on_landmark, place[:, slot, lanes], figure)
    landmark = np.where(on_figure, place[:, slot, lanes], unseen)
    landmark = np.where(on_landmark, back[:, slot, lanes], landmark)
    return {"hypothesis": np.stack([figure, landmark], axis=1)}


def _hang(landmark: np.ndarray, turn: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Put a figure behind landmarks f64[2, n, P]."""
    angle = np.arctan2(landmark[1], landmark[0]) + turn
    return landmark + way * np.stack([np.cos(angle), np.sin(angle)])


def _revive(twin: Twin, weight: np.ndarray, parts: list[slice]) -> np.ndarray:
    """Ground the words anew in particles that weigh too little."""
    number = weight.shape[0]
    is_fresh = twin.random.random(number) > weight * number
    fresh = [
        _ground(twin, {name: leaf[..., part] for name, leaf in twin.particles.items()})
        for part in parts
        if np.any(is_fresh[part])
    ]
    places = [part for part in parts if np.any(is_fresh[part])]
    for part, drawn in zip(places, fresh, strict=True):
        old = twin.particles["hypothesis"][..., part]
        twin.particles["hypothesis"][..., part] = np.where(is_fresh[part], drawn["hypothesis"], old)
    weight = np.where(is_fresh, 1.0 / number, np.maximum(weight, 1.0 / number))
    return weight / weight.sum()


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
