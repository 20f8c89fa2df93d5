"""The navigator's decision cycle in plain NumPy: the baseline of the speed benchmarks.

It does the main work of ``navigator.step`` for one relation ("the figure behind the landmark") in
the order of section 3: move, ground detections, condition the joint Gaussian, weigh what was and
was not seen, ground the words anew in refuted particles, resample, infer the goal in every
particle, choose among frontiers, objects and the tours of the informed policy
(``twin_choose``). It leaves out several readings, superlatives, the children's beams of the
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
    """Build the initial state.

    Args:
        num_particles: P.
        seed: of its random numbers.
        num_objects: O.
        num_cells: G.

    Returns:
        The twin at the origin of a 13 m deep area.
    """
    size, count = num_objects + 1, num_particles
    precision = np.tile(np.eye(size)[:, :, None], (1, 1, count))
    precision[-1, -1] = 1e4
    particles = {
        "type": np.full((num_objects, count), -1),
        "precision": precision,
        "information": np.zeros((2, size, count)),
        "mean": np.zeros((2, size, count)),
        "hypothesis": np.zeros((2, 2, count)),
        "referent": np.full((2, count), -1),
    }
    twin = Twin(
        random=np.random.default_rng(seed),
        particles=particles,
        log_weight=np.full(count, -math.log(count)),
        log_miss=np.zeros((num_cells, num_cells)),
        area=(0.0, 13.0, -9.2, 9.2),
    )
    twin.particles |= _ground_relation(twin, particles)
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
    count = twin.log_weight.shape[0]
    parts = [slice(p, p + 1) for p in range(count)] if is_looping else [slice(0, count)]
    filtered, log_likelihoods = [], []
    for part in parts:
        chunk = {name: leaf[..., part] for name, leaf in twin.particles.items()}
        chunk, log_likelihood = _filter(twin, chunk, move, detections, sensing_range)
        filtered.append(chunk)
        log_likelihoods.append(log_likelihood)
    _concatenate(twin, filtered)
    robot = np.sum(twin.particles["mean"][:, -1] * np.exp(twin.log_weight), axis=-1)
    _add_view(twin, robot, sensing_range)
    log_weight = twin.log_weight + np.concatenate(log_likelihoods)
    log_weight -= log_weight.max()
    weight = np.exp(log_weight) / np.exp(log_weight).sum()
    weight = _reground(twin, weight, parts)
    if 1.0 / np.sum(weight**2) < 0.5 * count:
        ancestors = np.searchsorted(
            np.cumsum(weight), (np.arange(count) + twin.random.random()) / count
        )
        ancestors = np.minimum(ancestors, count - 1)
        twin.particles = {name: leaf[..., ancestors] for name, leaf in twin.particles.items()}
        weight = np.full(count, 1.0 / count)
    twin.log_weight = np.log(np.maximum(weight, 1e-30))
    return twin_choose(twin, robot, weight, sensing_range, parts)


def _concatenate(twin: Twin, parts: list[Arrays]) -> None:
    """Concatenate chunks of particles."""
    twin.particles = {
        name: np.concatenate([part[name] for part in parts], axis=-1) for name in parts[0]
    }


def _filter(
    twin: Twin,
    chunk: Arrays,
    move: np.ndarray,
    detections: list[tuple[int, float, float]],
    sensing_range: float,
) -> tuple[Arrays, np.ndarray]:
    """Predict, associate, update with detections, and weigh negative information."""
    chunk = {name: leaf.copy() for name, leaf in chunk.items()}
    count, num_objects = chunk["type"].shape[-1], chunk["type"].shape[0]
    _move(chunk, move)
    covariance = np.linalg.inv(np.moveaxis(chunk["precision"], -1, 0))
    variance = np.diagonal(covariance, axis1=1, axis2=2).T
    spread = variance[:-1] + variance[-1] - 2.0 * covariance[:, -1, :-1].T + _SIGMA**2
    log_lik = np.zeros(count)
    hit = np.zeros((num_objects, count), bool)
    indices = np.arange(count)
    for kind, x, y in detections:
        choice, log_total = _associate(twin, chunk, (chunk["type"] == kind) & ~hit, (x, y), spread)
        log_lik += log_total
        empty_slot = np.argmax(chunk["type"] == -1, axis=0)
        slot = np.where(choice == num_objects, empty_slot, choice)
        is_new = choice == num_objects
        chunk["type"][slot, indices] = kind
        hit[slot, indices] = True
        chunk["precision"][slot, slot, indices] += 1.0 / _SIGMA**2 - is_new
        chunk["precision"][-1, -1] += 1.0 / _SIGMA**2
        chunk["precision"][slot, -1, indices] -= 1.0 / _SIGMA**2
        chunk["precision"][-1, slot, indices] -= 1.0 / _SIGMA**2
        for axis, value in enumerate((x, y)):
            chunk["information"][axis, slot, indices] += value / _SIGMA**2
            chunk["information"][axis, -1] -= value / _SIGMA**2
        for mention in (0, 1):
            is_referent = (chunk["referent"][mention] == -1) & (kind == mention)
            chunk["referent"][mention] = np.where(is_referent, slot, chunk["referent"][mention])
    covariance = np.linalg.inv(np.moveaxis(chunk["precision"], -1, 0))
    chunk["mean"] = np.einsum("pij,kjp->kip", covariance, chunk["information"])
    log_lik += _log_miss(chunk["mean"][:, :-1], chunk, (chunk["type"] != -1) & ~hit, sensing_range)
    log_lik += _log_miss(chunk["hypothesis"], chunk, chunk["referent"] == -1, sensing_range)
    return chunk, log_lik


def _associate(
    twin: Twin, chunk: Arrays, is_candidate: np.ndarray, at: tuple[float, float], spread: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sample a detection's association: i[P] a slot, or O for a new object; f[P] log evidence."""
    offset = chunk["mean"][:, :-1] - chunk["mean"][:, -1:]
    squared = (at[0] - offset[0]) ** 2 + (at[1] - offset[1]) ** 2
    log_old = -0.5 * squared / spread - np.log(2.0 * math.pi * spread)
    log_old = np.where(is_candidate, log_old, -np.inf)
    count = is_candidate.shape[1]
    log_new = np.full((1, count), math.log(_ALPHA / 240.0))
    choices = np.concatenate([log_old, log_new])
    top = choices.max(axis=0)
    cumulative = np.cumsum(np.exp(choices - top), axis=0)
    choice = np.sum(cumulative < twin.random.random(count) * cumulative[-1], axis=0)
    return choice, top + np.log(cumulative[-1])


def _move(chunk: Arrays, move: np.ndarray) -> None:
    """Predict: add a robot pose and marginalise the previous one out."""
    variance = (0.02**2) * float(move @ move) + 1e-12
    precision, information = chunk["precision"], chunk["information"]
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
    chunk["mean"][:, -1] += move[:, None]


def _log_miss(
    position: np.ndarray, chunk: Arrays, is_missed: np.ndarray, sensing_range: float
) -> np.ndarray:
    """Compute the log-likelihood of objects in view that were not detected."""
    offset = position - chunk["mean"][:, -1:]
    distance = np.sqrt(offset[0] ** 2 + offset[1] ** 2 + 1e-9)
    view = np.clip((sensing_range - distance) / 0.25 + 0.5, 0.0, 1.0)
    return np.sum(np.where(is_missed, np.log1p(-DETECTION * view), 0.0), axis=0)


def _add_view(twin: Twin, robot: np.ndarray, sensing_range: float) -> None:
    """Update the coverage map by an observation."""
    x, y = centres(twin)
    distance = np.sqrt((x[None, :] - robot[0]) ** 2 + (y[:, None] - robot[1]) ** 2)
    in_view = np.clip((sensing_range - distance) / 0.6 + 0.5, 0.0, 1.0)
    twin.log_miss = np.maximum(twin.log_miss + np.log1p(-DETECTION * in_view), -30.0)


def _log_miss_at(twin: Twin, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Look up the log-probability of a miss."""
    size = twin.log_miss.shape[0]
    x_min, x_max, y_min, y_max = twin.area
    column = np.floor((x - x_min) / (x_max - x_min) * size).astype(int)
    row = np.floor((y - y_min) / (y_max - y_min) * size).astype(int)
    is_in = (column >= 0) & (column < size) & (row >= 0) & (row < size)
    values = twin.log_miss[np.clip(row, 0, size - 1), np.clip(column, 0, size - 1)]
    return np.where(is_in, values, -np.inf)


def _log_behind(x: np.ndarray, y: np.ndarray, at_x: np.ndarray, at_y: np.ndarray) -> np.ndarray:
    """Evaluate "behind" for a figure offset by (x, y) from a landmark seen from the origin."""
    away = np.sqrt(at_x**2 + at_y**2 + 1e-9)
    along, lateral = (x * at_x + y * at_y) / away, (y * at_x - x * at_y) / away
    distance = np.sqrt(along**2 + lateral**2 + 1e-9)
    cosine = along / distance
    log_distance = (np.log(distance / _BEHIND_DISTANCE) / _BEHIND_SPREAD) ** 2
    return cosine / _BEHIND_ANGLE**2 - 0.5 * log_distance - 2.0 * np.log(distance) - 6.0


def _ground_relation(twin: Twin, particles: Arrays) -> Arrays:
    """Sample figure and landmark jointly, each observed or unseen (eq. 7a)."""
    count, num_objects = particles["type"].shape[-1], particles["type"].shape[0]
    unseen_weight = np.exp(twin.log_miss).ravel()
    uniform = twin.random.random(count) * unseen_weight.sum()
    cell = np.minimum(np.searchsorted(np.cumsum(unseen_weight), uniform), unseen_weight.size - 1)
    centre_x, centre_y = centres(twin)
    rows, columns = np.divmod(cell, twin.log_miss.shape[0])
    unseen = np.stack([centre_x[columns], centre_y[rows]])
    turn = _BEHIND_ANGLE * twin.random.normal(size=count)
    distance = _BEHIND_DISTANCE * np.exp(_BEHIND_SPREAD * twin.random.normal(size=count))
    log_bystander = math.log(240.0 / _ALPHA)
    position = particles["mean"][:, :-1]
    is_figure, is_landmark = particles["type"] == 0, particles["type"] == 1
    known = _log_behind(
        position[0][:, None] - position[0][None],
        position[1][:, None] - position[1][None],
        position[0][None],
        position[1][None],
    )
    known = np.where(is_figure[:, None] & is_landmark[None], known + 2 * log_bystander, -np.inf)
    behind = _place_behind(position, turn, distance)
    log_figure = _log_miss_at(twin, *behind) + np.where(is_landmark, log_bystander, -np.inf)
    before = 2.0 * position - behind
    log_landmark = _log_miss_at(twin, *before) + np.where(is_figure, log_bystander, -np.inf)
    pair = _place_behind(unseen[:, None], turn, distance)
    log_pair = np.log(unseen_weight.mean()) + _log_miss_at(twin, *pair)
    flat = known.reshape(num_objects**2, count)
    choices = np.maximum(np.concatenate([flat, log_figure, log_landmark, log_pair]), -60.0)
    cumulative = np.cumsum(np.exp(choices - choices.max(axis=0)), axis=0)
    choice = np.sum(cumulative < twin.random.random(count) * cumulative[-1], axis=0)
    indices, rest = np.arange(count), choice - num_objects**2
    on_figure = (rest >= 0) & (rest < num_objects)
    on_landmark = (rest >= num_objects) & (rest < 2 * num_objects)
    slot = np.where(rest < 0, choice % num_objects, rest % num_objects)
    figure = np.where(on_figure, behind[:, slot, indices], pair[:, 0])
    figure = np.where(on_landmark, position[:, slot, indices], figure)
    landmark = np.where(on_figure, position[:, slot, indices], unseen)
    landmark = np.where(on_landmark, before[:, slot, indices], landmark)
    return {"hypothesis": np.stack([figure, landmark], axis=1)}


def _place_behind(landmark: np.ndarray, turn: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Compute figure positions behind landmarks f64[2, n, P]."""
    angle = np.arctan2(landmark[1], landmark[0]) + turn
    return landmark + distance * np.stack([np.cos(angle), np.sin(angle)])


def _reground(twin: Twin, weight: np.ndarray, parts: list[slice]) -> np.ndarray:
    """Reground the sentence in particles with a low weight."""
    count = weight.shape[0]
    is_fresh = twin.random.random(count) > weight * count
    regrounded = [
        _ground_relation(twin, {name: leaf[..., part] for name, leaf in twin.particles.items()})
        for part in parts
        if np.any(is_fresh[part])
    ]
    chunks = [part for part in parts if np.any(is_fresh[part])]
    for part, new in zip(chunks, regrounded, strict=True):
        old = twin.particles["hypothesis"][..., part]
        twin.particles["hypothesis"][..., part] = np.where(is_fresh[part], new["hypothesis"], old)
    weight = np.where(is_fresh, 1.0 / count, np.maximum(weight, 1.0 / count))
    return weight / weight.sum()


def _infer_goals(particles: Arrays) -> tuple[np.ndarray, np.ndarray]:
    """Infer the probability that each object is the goal, phrase by phrase, by log-odds."""
    is_object = np.concatenate([particles["type"] != -1, particles["referent"] == -1])
    types = np.concatenate([particles["type"], np.tile([[0], [1]], particles["type"].shape[1])])
    log_odds = np.zeros(types.shape)
    for phrase in range(_PHRASES):
        objects = np.where(types == phrase % 2, 4.0 - phrase * 0.1, -4.0)
        regions = np.where(
            types[None] == phrase % 2, np.linspace(-4.0, 4.0, 7)[:, None, None], -4.0
        )
        odds = np.concatenate([objects[None], regions]).reshape(-1, types.shape[1])
        # The four best sets follow from the three correspondences that are least certain.
        margins = np.partition(np.abs(odds), 2, axis=0)[:3]
        best = -np.sum(np.logaddexp(0.0, -np.abs(odds)), axis=0)
        beams = best - np.stack([0.0 * margins[0], *margins])
        certainty = np.exp(beams[0] - np.logaddexp.reduce(beams, axis=0))
        log_odds += certainty * -np.logaddexp(0.0, np.where(types == 0, -objects, objects))
    mass = np.where(is_object & (types == 0), np.exp(log_odds), 0.0)
    mass /= np.maximum(mass.sum(axis=0), 1e-9)
    position = np.concatenate([particles["mean"][:, :-1], particles["hypothesis"]], axis=1)
    return mass, position


def _frontiers(twin: Twin, num_blocks: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Average the frontier cells of each block into one waypoint."""
    unexplored = twin.log_miss > twin.log_miss.max() + math.log(0.5)
    padded = np.pad(~unexplored, 1)
    is_adjacent = padded[2:, 1:-1] | padded[:-2, 1:-1] | padded[1:-1, 2:] | padded[1:-1, :-2]
    frontier = (unexplored & is_adjacent).astype(float)
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
    """Choose a waypoint by the QMDP value over all particles, or by the best search tour.

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
    observed_mass, free, anchored = 0.0, 0.0, np.zeros(_CELLS**2)
    for part in parts:
        chunk = {name: leaf[..., part] for name, leaf in twin.particles.items()}
        mass, positions = _infer_goals(chunk)
        best = np.argmax(mass, axis=0)
        goal = np.take_along_axis(positions, best[None, None, :], axis=1)[:, 0]
        goal_mass = np.max(mass, axis=0) * weight[part]
        distance = np.hypot(nodes[0][:, None] - goal[0], nodes[1][:, None] - goal[1])
        value += np.sum(goal_mass * _DISCOUNT**distance, axis=1)
        observed_mass += float(np.sum(np.where(best < chunk["type"].shape[0], goal_mass, 0.0)))
        free += _split(twin, chunk, weight[part], anchored)
    if observed_mass < 0.5:
        return _plan_tour(twin, robot, _spread_unseen(twin, free) + anchored, sensing_range)
    value = np.where(is_node, value, -np.inf)
    return nodes[:, int(np.argmax(value))]


def _split(twin: Twin, chunk: Arrays, weight: np.ndarray, anchored: np.ndarray) -> float:
    """Add anchored hypotheses to a grid; returns the weight of unanchored particles."""
    x_min, x_max, y_min, y_max = twin.area
    is_open = chunk["referent"] == -1
    is_unanchored = np.all(is_open, axis=0)
    x, y = chunk["hypothesis"]
    column = np.clip(np.floor((x - x_min) / (x_max - x_min) * _CELLS), 0, _CELLS - 1)
    row = np.clip(np.floor((y - y_min) / (y_max - y_min) * _CELLS), 0, _CELLS - 1)
    cell = (row * _CELLS + column).astype(int)
    np.add.at(anchored, cell.ravel(), np.where(is_open & ~is_unanchored, weight, 0.0).ravel())
    return float(np.sum(weight[is_unanchored]))


def _spread_unseen(twin: Twin, unanchored_mass: float) -> np.ndarray:
    """Distribute the unanchored mass over unobserved cells, f64[cells]."""
    miss = np.exp(twin.log_miss)
    size = miss.shape[0] // _CELLS
    unseen = miss.reshape(_CELLS, size, _CELLS, size).sum(axis=(1, 3)).ravel()
    return unanchored_mass * unseen / max(unseen.sum(), 1e-9)


def _grid(twin: Twin, number: int) -> np.ndarray:
    """Build a grid of number × number points over the area, f64[2, points]."""
    x_min, x_max, y_min, y_max = twin.area
    steps = (np.arange(number) + 0.5) / number
    x, y = x_min + steps * (x_max - x_min), y_min + steps * (y_max - y_min)
    return np.stack([np.tile(x, number), np.repeat(y, number)])


def _plan_tour(twin: Twin, robot: np.ndarray, mass: np.ndarray, sensing_range: float) -> np.ndarray:
    """Return the first viewpoint of the tour with the lowest expected latency."""
    cells, views = _grid(twin, _CELLS), _grid(twin, _LATTICE)
    x_min, x_max, y_min, y_max = twin.area
    softness = 0.5 * (x_max - x_min + y_max - y_min) / _CELLS

    def in_view(distance: np.ndarray) -> np.ndarray:
        return np.clip((sensing_range - distance) / softness + 0.5, 0.0, 1.0)

    span = views - robot[:, None]
    length = np.sum(span**2, axis=0) + 1e-9
    offset = cells[:, None] - robot[:, None, None]
    along = np.clip(np.sum(offset * span[:, :, None], axis=0) / length[:, None], 0.0, 1.0)
    seen_on_path = in_view(np.hypot(*(offset - along * span[:, :, None])))
    revealed, distance = seen_on_path @ mass, np.sqrt(length)
    rate = revealed / (distance + 1.0)
    sees = in_view(np.hypot(*(views[:, :, None] - cells[:, None])))
    between = np.hypot(*(views[:, :, None] - views[:, None]))
    totals = []
    firsts = np.argpartition(-rate, _TOURS)[:_TOURS]
    for first in firsts:
        remaining, current, travelled = mass * (1.0 - seen_on_path[first]), first, distance[first]
        total = revealed[first] * travelled
        for _ in range(_STOPS):
            gain = sees @ remaining
            best = int(np.argmax(gain / (between[current] + 1.0)))
            travelled += between[current, best]
            total += gain[best] * travelled
            remaining, current = remaining * (1.0 - sees[best]), best
        spread = np.mean(remaining > 0.1 * mass.mean()) * (x_max - x_min) * (y_max - y_min)
        totals.append(total + remaining.sum() * (travelled + spread / (4.0 * sensing_range)))
    return views[:, firsts[int(np.argmin(totals))]]
