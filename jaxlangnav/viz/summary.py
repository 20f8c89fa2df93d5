"""Numbers that several pictures and the story share: what a frame says in few figures.

The objects of all particles are summed up slot by slot; hypotheses stay as they are, one per
particle and mention. ``scene`` is of the episode, ``frame`` one of its steps.
"""

import dataclasses

import numpy as np

from jaxlangnav.episode.recording import Frame, Recording, StaticScene
from jaxlangnav.inputs.limits import refuse_below
from jaxlangnav.messages import NONE

_LEAST_SHARE = 0.02  # objects that fewer particles believe in than this are left out of pictures
_PEAK_RADIUS = 1.5  # metres
SAME_PLACE = 0.25  # metres within which two nodes are one place to a person


@dataclasses.dataclass(frozen=True, kw_only=True)
class SeenObject:
    """An object that has been observed, summed up over particles."""

    slot: int
    object_type: int
    x: float  # metres, map frame, weighted mean
    y: float
    spread: float  # metres, standard deviation on each axis, within particles and among them
    probability: float  # share of the weight of particles that have it
    goal_mass: float  # probability that it is the goal


def seen_objects(frame: Frame) -> list[SeenObject]:
    """Sum up the observed objects of a frame, by slot."""
    weight = np.asarray(frame.weight, float)
    found = []
    for slot in range(frame.object_type.shape[0]):
        types = np.asarray(frame.object_type[slot])
        share = np.where(types != NONE, weight, 0.0)
        total = float(share.sum())
        if total < _LEAST_SHARE:
            continue
        kind = int(np.argmax(np.bincount(types[types != NONE], weights=share[types != NONE])))
        share = np.where(types == kind, share, 0.0)
        places = np.stack([frame.object_x[slot], frame.object_y[slot]]).astype(float)
        mean = np.average(places, axis=1, weights=share)
        apart = ((places - mean[:, None]) ** 2).sum(axis=0)
        within = np.square(frame.object_sd[slot], dtype=float)
        found.append(
            SeenObject(
                slot=slot,
                object_type=kind,
                x=float(mean[0]),
                y=float(mean[1]),
                spread=float(np.sqrt(np.average(within + 0.5 * apart, weights=share))),
                probability=min(total, 1.0),
                goal_mass=float(frame.goal_mass[slot]),
            )
        )
    return found


def expected_goal(frames: Frame) -> np.ndarray:
    """Compute the mean place of the goal, f64[..., 2] metres; NaN where none is believed."""
    x, y, mass = _goals(frames)
    total = mass.sum(axis=-1, dtype=float)
    safe = np.where(total > 1e-6, total, np.nan)
    return np.stack([(mass * one).sum(axis=-1, dtype=float) / safe for one in (x, y)], axis=-1)


def _goals(frames: Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gather x, y and probability of all places of the goal, seen and unseen, f32[..., n]."""
    pairs = (
        (frames.goal_x, frames.hypothesis_goal_x),
        (frames.goal_y, frames.hypothesis_goal_y),
        (frames.goal_mass, frames.hypothesis_goal_mass),
    )
    x, y, mass = (np.concatenate(pair, axis=-1) for pair in pairs)
    return x, y, mass


def peaks(frame: Frame) -> list[tuple[float, float, float]]:
    """Find where the unseen goal is likeliest to be: at most two places, the best first.

    Each is x, y in metres, map frame, and the share of the unseen goal's mass within 1.5 metres;
    peaks that hold less than 15 % of it are left out.
    """
    mass = np.asarray(frame.hypothesis_goal_mass, float)
    held = np.flatnonzero(mass > 0.0)
    total = mass.sum()
    if total < 1e-6:
        return []
    x = np.asarray(frame.hypothesis_goal_x, float)[held]
    y = np.asarray(frame.hypothesis_goal_y, float)[held]
    left = mass[held] / total
    squared = (x[:, None] - x[None, :]) ** 2 + (y[:, None] - y[None, :]) ** 2
    near = squared <= _PEAK_RADIUS**2
    found = []
    for _ in range(2):
        around = near @ left
        best = int(np.argmax(around))
        if around[best] < 0.15:
            break
        share = np.where(near[best], left, 0.0) / around[best]
        found.append((float(share @ x), float(share @ y), float(around[best])))
        left = np.where(squared[best] <= 4 * _PEAK_RADIUS**2, 0.0, left)
    return found


def chosen_node(frame: Frame) -> int | None:
    """Find the index of the node the waypoint stands on; None where a former waypoint is kept."""
    squared = (frame.node_x - frame.waypoint[0]) ** 2 + (frame.node_y - frame.waypoint[1]) ** 2
    squared = np.where(frame.is_node & (frame.node_kind == frame.waypoint_kind), squared, np.inf)
    best = int(np.argmin(squared))
    return best if squared[best] < 1e-4 else None


def distinct_nodes(frame: Frame) -> np.ndarray:
    """Rank the open nodes by value, i64[≤ A]; of nodes that stand together the best counts."""
    order = np.argsort(-np.asarray(frame.value), kind="stable")
    kept: list[int] = []
    for node in order[np.isfinite(frame.value[order])]:
        apart = np.hypot(
            frame.node_x[kept] - frame.node_x[node], frame.node_y[kept] - frame.node_y[node]
        )
        if not (apart < SAME_PLACE).any():
            kept.append(int(node))
    return np.array(kept, int)


def tested_share(scene: StaticScene, frame: Frame) -> float:
    """Compute the weight of particles with a hypothesis within range of the way to the waypoint."""
    start, end = np.asarray(frame.robot, float), np.asarray(frame.waypoint, float)
    span = end - start
    dx, dy = frame.hypothesis_x - start[0], frame.hypothesis_y - start[1]
    along = np.clip((dx * span[0] + dy * span[1]) / max(float(span @ span), 1e-9), 0.0, 1.0)
    distance = np.hypot(dx - along * span[0], dy - along * span[1])
    is_seen = frame.is_hypothesised & (distance <= float(scene.sensor.range_max))
    return float(frame.weight[is_seen.any(axis=0)].sum())


def goal_field(scene: StaticScene, frame: Frame, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Compute the QMDP value of standing at x, y f64[...], metres, map frame (eq. 11, 12)."""
    goal_x, goal_y, mass = _goals(frame)
    distance = np.hypot(x[..., None] - goal_x, y[..., None] - goal_y)
    return (float(scene.planner.discount) ** distance) @ mass


def explored_share(frame: Frame) -> float:
    """Compute which share of the area has been looked at (misses below one half)."""
    return float(np.mean(np.asarray(frame.miss) < 0.5))


def pick_moments(recording: Recording, number: int = 6) -> list[int]:
    """Choose min(number, T) steps to show, in order: the last, of several the first; number ≥ 1."""
    refuse_below(1, **{"number of panels": number})
    last, frames = recording.num_steps - 1, recording.frames
    chosen = {0, last} if number > 1 else {last}
    # How much each step changed what is believed and planned.
    shift, moved = np.zeros((2, recording.num_steps))
    shift[1:] = np.hypot(*np.diff(expected_goal(frames), axis=0).T)
    moved[1:] = np.any(np.diff(frames.waypoint, axis=0) != 0, axis=1)
    score = 2.0 * frames.is_news + frames.num_regrounded / recording.num_particles
    score += 0.25 * np.nan_to_num(shift) + 0.2 * moved
    # Everything else being equal the panels spread over the episode.
    for _ in range(min(number, recording.num_steps) - len(chosen)):
        steps = np.arange(recording.num_steps)
        gap = np.min(np.abs(steps[:, None] - np.array(sorted(chosen))[None, :]), axis=1)
        spread = gap / max(1, last)
        merit = np.where(gap == 0, -np.inf, score * np.minimum(gap / 2.0, 1.0) + 2.0 * spread)
        chosen.add(int(np.argmax(merit)))
    return sorted(chosen)
