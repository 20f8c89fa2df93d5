"""Summary statistics of frames, shared by figures and narrative.

Observed objects are averaged over particles slot by slot; hypotheses stay as they are, one per
particle and mention. ``scene`` is of the episode, ``frame`` one of its steps.
"""

import dataclasses

import numpy as np

from jaxlangnav.episode.recording import Recording, Snapshot, StaticScene
from jaxlangnav.inputs.limits import check_minimum
from jaxlangnav.inputs.object_types import label_of
from jaxlangnav.messages import NONE

_MIN_PROBABILITY = 0.02  # existence probability below which figures leave out an object
_PEAK_RADIUS = 1.5  # metres
SAME_NODE_RADIUS = 0.25  # metres within which two nodes count as one


@dataclasses.dataclass(frozen=True)
class ObservedObject:
    """An observed object, averaged over particles."""

    slot: int
    object_type: int
    x: float  # metres, map frame, weighted mean
    y: float
    spread: float  # metres, standard deviation on each axis, within particles and among them
    probability: float = 1.0  # weight of the particles that contain it
    goal_mass: float = 0.0  # probability that it is the goal


def observed_objects(frame: Snapshot) -> list[ObservedObject]:
    """Average observed objects over the particles; append those that the task does not mention."""
    weight = np.asarray(frame.weight, float)
    objects = []
    for slot in range(frame.object_type.shape[0]):
        types = np.asarray(frame.object_type[slot])
        weights = np.where(types != NONE, weight, 0.0)
        total = float(weights.sum())
        if total < _MIN_PROBABILITY:
            continue
        best = int(np.argmax(np.bincount(types[types != NONE], weights=weights[types != NONE])))
        weights = np.where(types == best, weights, 0.0)
        positions = np.stack([frame.object_x[slot], frame.object_y[slot]]).astype(float)
        x, y = np.average(positions, axis=1, weights=weights).tolist()
        squared = ((positions - np.array([[x], [y]])) ** 2).sum(axis=0)
        variance = np.average(np.square(frame.object_sd[slot]) + 0.5 * squared, weights=weights)
        probability, goal_mass = min(total, 1.0), float(frame.goal_mass[slot])
        spread = float(np.sqrt(variance))
        objects.append(ObservedObject(slot, best, x, y, spread, probability, goal_mass))
    others = frame.bystanders
    for index in np.flatnonzero(others.is_filled):
        x, y, variance = (float(leaf[index]) for leaf in (others.x, others.y, others.variance))
        slot, code = frame.object_type.shape[0] + int(index), int(others.object_type[index])
        objects.append(ObservedObject(slot, label_of(code), x, y, variance**0.5))
    return objects


def expected_goal(frames: Snapshot) -> np.ndarray:
    """Compute the mean goal position, f64[..., 2] metres; NaN where no goal has probability."""
    x, y, mass = _goals(frames)
    total = mass.sum(axis=-1, dtype=float)
    safe = np.where(total > 1e-6, total, np.nan)
    return np.stack([(mass * coord).sum(axis=-1, dtype=float) / safe for coord in (x, y)], axis=-1)


def _goals(frames: Snapshot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Concatenate x, y and probability of observed and hypothesised goals, f32[..., n]."""
    pairs = (
        (frames.goal_x, frames.hypothesis_goal_x),
        (frames.goal_y, frames.hypothesis_goal_y),
        (frames.goal_mass, frames.hypothesis_goal_mass),
    )
    x, y, mass = (np.concatenate(pair, axis=-1) for pair in pairs)
    return x, y, mass


def goal_modes(frame: Snapshot) -> list[tuple[float, float, float]]:
    """Find at most two modes of the unseen goal's distribution, the heaviest first.

    Each is x, y in metres, map frame, and the fraction of the unseen goal's mass within 1.5 metres;
    peaks that hold less than 15 % of it are left out.
    """
    mass = np.asarray(frame.hypothesis_goal_mass, float)
    nonzero = np.flatnonzero(mass > 0.0)
    total = mass.sum()
    if total < 1e-6:
        return []
    x = np.asarray(frame.hypothesis_goal_x, float)[nonzero]
    y = np.asarray(frame.hypothesis_goal_y, float)[nonzero]
    remaining = mass[nonzero] / total
    squared = (x[:, None] - x[None, :]) ** 2 + (y[:, None] - y[None, :]) ** 2
    is_near = squared <= _PEAK_RADIUS**2
    modes = []
    for _ in range(2):
        nearby_mass = is_near @ remaining
        best = int(np.argmax(nearby_mass))
        if nearby_mass[best] < 0.15:
            break
        local = np.where(is_near[best], remaining, 0.0) / nearby_mass[best]
        modes.append((float(local @ x), float(local @ y), float(nearby_mass[best])))
        remaining = np.where(squared[best] <= 4 * _PEAK_RADIUS**2, 0.0, remaining)
    return modes


def chosen_node(frame: Snapshot) -> int | None:
    """Find the index of the graph node of the waypoint; None where an earlier waypoint is kept."""
    squared = (frame.node_x - frame.waypoint[0]) ** 2 + (frame.node_y - frame.waypoint[1]) ** 2
    squared = np.where(frame.is_node & (frame.node_kind == frame.waypoint_kind), squared, np.inf)
    best = int(np.argmin(squared))
    return best if squared[best] < 1e-4 else None


def distinct_nodes(frame: Snapshot) -> np.ndarray:
    """Rank the open nodes by value, i64[≤ A], with non-maximum suppression of close nodes."""
    order = np.argsort(-np.asarray(frame.value), kind="stable")
    distinct: list[int] = []
    for node in order[np.isfinite(frame.value[order])]:
        distance = np.hypot(
            frame.node_x[distinct] - frame.node_x[node], frame.node_y[distinct] - frame.node_y[node]
        )
        if not (distance < SAME_NODE_RADIUS).any():
            distinct.append(int(node))
    return np.array(distinct, int)


def tested_mass(scene: StaticScene, frame: Snapshot) -> float:
    """Compute the weight of particles with a hypothesis in range of the path to the waypoint."""
    start, end = np.asarray(frame.robot, float), np.asarray(frame.waypoint, float)
    span = end - start
    dx, dy = frame.hypothesis_x - start[0], frame.hypothesis_y - start[1]
    along = np.clip((dx * span[0] + dy * span[1]) / max(float(span @ span), 1e-9), 0.0, 1.0)
    distance = np.hypot(dx - along * span[0], dy - along * span[1])
    is_in_range = frame.is_hypothesised & (distance <= float(scene.sensor.range_max))
    return float(frame.weight[is_in_range.any(axis=0)].sum())


def goal_field(scene: StaticScene, frame: Snapshot, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Compute the QMDP value of standing at x, y f64[...], metres, map frame (eq. 11, 12)."""
    goal_x, goal_y, mass = _goals(frame)
    distance = np.hypot(x[..., None] - goal_x, y[..., None] - goal_y)
    return (float(scene.planner.discount) ** distance) @ mass


def explored_fraction(frame: Snapshot) -> float:
    """Compute the fraction of the area observed: cells with a miss probability below one half."""
    return float(np.mean(np.asarray(frame.miss) < 0.5))


def select_steps(recording: Recording, count: int = 6) -> list[int]:
    """Select min(count, T) informative steps, in order: the last, and the first if count > 1."""
    check_minimum(1, **{"number of panels": count})
    last, frames = recording.num_steps - 1, recording.frames
    chosen = {0, last} if count > 1 else {last}
    # Changes of belief and plan in each step.
    goal_shift, has_new_waypoint = np.zeros((2, recording.num_steps))
    goal_shift[1:] = np.hypot(*np.diff(expected_goal(frames), axis=0).T)
    has_new_waypoint[1:] = np.any(np.diff(frames.waypoint, axis=0) != 0, axis=1)
    score = 2.0 * frames.is_news + frames.num_regrounded / recording.num_particles
    score += 0.25 * np.nan_to_num(goal_shift) + 0.2 * has_new_waypoint
    # Among equal scores, spread the steps over the episode.
    for _ in range(min(count, recording.num_steps) - len(chosen)):
        steps = np.arange(recording.num_steps)
        gap = np.min(np.abs(steps[:, None] - np.array(sorted(chosen))[None, :]), axis=1)
        spread = gap / max(1, last)
        utility = np.where(gap == 0, -np.inf, score * np.minimum(gap / 2.0, 1.0) + 2.0 * spread)
        chosen.add(int(np.argmax(utility)))
    return sorted(chosen)
