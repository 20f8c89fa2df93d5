"""Path following with a sampled dynamic window.

D. Fox, W. Burgard, S. Thrun, The dynamic window approach to collision avoidance, IEEE RAM 4(1),
1997. Chooses the best of the arcs that the body can take next; it follows a planned path, as alone
it deadlocks before obstacles. Where no arc is free it turns in place towards the path.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from jaxlangnav.robots.motion.path import disc_distance, is_clear

CONTACT = 0.03
"""Metres by which an arc away from an obstacle in contact may come nearer to it."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class BodyLimits:
    """Size and kinematic limits of a body that drives ahead and turns about its center."""

    radius: float
    """Metres, of the circumscribed circle about the center."""
    speed: float
    """Metres a second ahead at normal speed (factor 1)."""
    top_speed: float
    """Metres a second, maximum speed whatever is requested."""
    turn_rate: float
    """Radians a second, maximum."""
    acceleration: float
    """Metres a second squared, accelerating and braking."""
    turn_acceleration: float
    """Radians a second squared."""


class WheelCommand(NamedTuple):
    """A velocity command."""

    speed: float  # metres a second ahead
    turn: float  # radians a second, counter-clockwise


STOP = WheelCommand(0.0, 0.0)
_NUM_SPEEDS, _NUM_TURNS, _NUM_TIMES = 5, 15, 8
_REACTION = 0.5  # seconds within which the window's speeds must be reachable
_LOOKAHEAD, _MIN_LOOKAHEAD = 0.9, 0.15  # metres along the path to the target point
_MAX_ANGLE = 1.0  # radians off the path beyond which it turns in place
_HORIZON = 1.6  # seconds for which an arc is simulated
_MARGIN = 0.02  # metres kept from obstacles by an arc, and by the line to the target point
_CLEARANCE_WEIGHT, _SPEED_WEIGHT = 0.3, 0.3


def steer(
    pose: np.ndarray,
    current: WheelCommand,
    path: np.ndarray,
    discs: np.ndarray,
    *,
    top_speed: float,
    body: BodyLimits,
) -> WheelCommand:
    """Choose a command: turn in place if the path is too far aside, else follow an arc.

    ``MotionPlanner`` limits it to the accelerations possible in a tick.

    Args:
        pose: f64[3], x, y, heading.
        current: the present command.
        path: f64[V, 2], corners ahead, V ≥ 1, metres; the robot stops at its end.
        discs: f64[K, 3], obstacles, metres, not inflated.
        top_speed: metres a second, requested.
        body: size and limits.
    """
    target = _lookahead_point(pose, path, discs, body)
    bearing = wrap(math.atan2(*(target - pose[:2])[::-1]) - pose[2])
    if abs(bearing) > _MAX_ANGLE:
        return turn_in_place(bearing, body)
    remaining = float(np.hypot(*np.diff(np.vstack([pose[:2], path]), axis=0).T).sum())
    limit = min(top_speed, math.sqrt(1.6 * body.acceleration * remaining))  # can stop in time
    low = max(current.speed - body.acceleration * _REACTION, 0.0)
    high = min(current.speed + body.acceleration * _REACTION, limit)
    turn_change = body.turn_acceleration * _REACTION
    min_turn = max(current.turn - turn_change, -body.turn_rate)
    max_turn = min(current.turn + turn_change, body.turn_rate)
    speeds = np.linspace(min(low, high), high, _NUM_SPEEDS)
    turns = np.append(np.linspace(min_turn, max_turn, _NUM_TURNS), 0.0)
    speed, turn = (grid.ravel() for grid in np.meshgrid(speeds, turns))
    times = np.linspace(0.0, _HORIZON, _NUM_TIMES + 1)[1:]
    angle = turn[:, None] * times
    chord = np.sinc(angle / (2.0 * math.pi)) * speed[:, None] * times
    direction = pose[2] + 0.5 * angle
    x, y = pose[0] + chord * np.cos(direction), pose[1] + chord * np.sin(direction)
    gap = disc_distance(x, y, discs) - body.radius
    gap_now = float(disc_distance(pose[None, 0], pose[None, 1], discs)[0]) - body.radius
    is_free = gap.min(axis=1) >= _MARGIN
    if gap_now < _MARGIN + CONTACT:  # allow arcs that leave the obstacle
        is_free |= (gap.min(axis=1) >= gap_now - CONTACT) & (gap[:, -1] >= gap_now - 1e-3)
    goal_distance = np.hypot(x - target[0], y - target[1]).min(axis=1)
    clearance = np.minimum(gap.min(axis=1), 0.5)
    score = -goal_distance + _CLEARANCE_WEIGHT * clearance + _SPEED_WEIGHT * speed
    best = int(np.argmax(np.where(is_free, score, -np.inf)))
    arc = WheelCommand(float(speed[best]), float(turn[best])) if is_free[best] else STOP
    return turn_in_place(bearing, body) if arc.speed < 0.02 and abs(bearing) > 0.05 else arc


def _lookahead_point(
    pose: np.ndarray, path: np.ndarray, discs: np.ndarray, body: BodyLimits
) -> np.ndarray:
    """Choose the target point of a path: at the lookahead, or nearer if an obstacle is between."""
    lookahead = _LOOKAHEAD
    target = _point_along(pose[:2], path, lookahead)
    margin = body.radius + _MARGIN
    distance = np.hypot(*(discs[:, :2] - pose[:2]).T)
    # Discs already in contact are shrunk, so that the robot can leave them.
    radius = np.minimum(discs[:, 2] + margin, np.maximum(distance - CONTACT, 0.0))
    inflated = np.column_stack([discs[:, :2], radius])
    while lookahead > _MIN_LOOKAHEAD and not is_clear(pose[:2], target, inflated):
        lookahead *= 0.6
        target = _point_along(pose[:2], path, lookahead)
    return target


def _point_along(start: np.ndarray, path: np.ndarray, length: float) -> np.ndarray:
    """Find the point of a path some distance ahead."""
    position, remaining = start, length
    for corner in path:
        segment = float(np.hypot(*(corner - position)))
        if segment >= remaining:
            return position + (corner - position) * (remaining / segment)
        remaining -= segment
        position = corner
    return position


def wrap(angle: float) -> float:
    """Wrap an angle, radians, to [−π, π]."""
    return math.remainder(angle, 2.0 * math.pi)


def turn_in_place(angle: float, body: BodyLimits) -> WheelCommand:
    """Command to turn in place, slowing down in time."""
    rate = min(body.turn_rate, math.sqrt(1.2 * body.turn_acceleration * abs(angle)))
    return WheelCommand(0.0, math.copysign(rate, angle))
