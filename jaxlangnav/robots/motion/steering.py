"""Steering along a way around things: a sampled dynamic window.

D. Fox, W. Burgard, S. Thrun, The dynamic window approach to collision avoidance, IEEE RAM 4(1),
1997. Of the arcs that the body can take next the best one; here along a way around things, as alone
it deadlocks before one. Where no arc ahead is free it turns on the spot towards the way.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from jaxlangnav.robots.motion.path import gaps, is_clear

GRAZE = 0.03
"""Metres that a way round something that is touched, or all but, may come nearer to it."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class BodyLimits:
    """A body that drives ahead and turns about its middle."""

    name: str
    radius: float
    """Metres, of the circle about the middle that holds all of it."""
    speed: float
    """Metres a second ahead at normal speed (factor 1)."""
    top_speed: float
    """Metres a second that it never exceeds, whatever is asked for."""
    turn_rate: float
    """Radians a second at most."""
    acceleration: float
    """Metres a second squared, speeding up and braking."""
    turn_acceleration: float
    """Radians a second squared."""


class WheelCommand(NamedTuple):
    """What the wheels are told."""

    speed: float  # metres a second ahead
    turn: float  # radians a second, counter-clockwise


STILL = WheelCommand(0.0, 0.0)


_SPEEDS, _TURNS, _TIMES = 5, 15, 8
_REACTION = 0.5  # seconds within which the window's speeds can be reached


@dataclasses.dataclass(frozen=True, kw_only=True)
class Window:
    """A dynamic window along a way: chooses the next command."""

    ahead: float = 0.9
    """Metres along the way to the point headed for."""
    widest: float = 1.0
    """Radians off the way beyond which it turns on the spot."""
    horizon: float = 1.6
    """Seconds for which an arc is followed."""
    spare: float = 0.02
    """Metres that an arc keeps from things."""
    clearance_weight: float = 0.3
    speed_weight: float = 0.3

    def steer(
        self,
        pose: np.ndarray,
        moving: WheelCommand,
        way: np.ndarray,
        discs: np.ndarray,
        *,
        top_speed: float,
        body: BodyLimits,
    ) -> WheelCommand:
        """Choose a command: turn on the spot if the way is aside, else follow an arc.

        ``Mover`` keeps it within what the body can do in a tick.

        Args:
            pose: f64[3], x, y, heading.
            moving: the present one.
            way: f64[V, 2], corners ahead, V ≥ 1, metres; its end is to be stopped at.
            discs: f64[K, 3], things, metres, not inflated.
            top_speed: metres a second wished for.
            body: size and limits.
        """
        target = _pursued(pose, way, self.ahead, discs, body)
        off = wrap(math.atan2(*(target - pose[:2])[::-1]) - pose[2])
        if abs(off) > self.widest:
            return turn_by(off, body)
        left = float(np.hypot(*np.diff(np.vstack([pose[:2], way]), axis=0).T).sum())
        most = min(top_speed, math.sqrt(1.6 * body.acceleration * left))  # so that it can stop
        arc = self._arc(pose, moving, target, discs, most, body)
        return turn_by(off, body) if arc.speed < 0.02 and abs(off) > 0.05 else arc

    def _arc(
        self,
        pose: np.ndarray,
        moving: WheelCommand,
        target: np.ndarray,
        discs: np.ndarray,
        most: float,
        body: BodyLimits,
    ) -> WheelCommand:
        """Choose the best free arc of at most such a speed, ``STILL`` if there is none."""
        low = max(moving.speed - body.acceleration * _REACTION, 0.0)
        high = min(moving.speed + body.acceleration * _REACTION, most)
        swing = body.turn_acceleration * _REACTION
        least_turn = max(moving.turn - swing, -body.turn_rate)
        most_turn = min(moving.turn + swing, body.turn_rate)
        speeds = np.linspace(min(low, high), high, _SPEEDS)
        turns = np.append(np.linspace(least_turn, most_turn, _TURNS), 0.0)
        speed, turn = (one.ravel() for one in np.meshgrid(speeds, turns))
        times = np.linspace(0.0, self.horizon, _TIMES + 1)[1:]
        turned = turn[:, None] * times
        chord = np.sinc(turned / (2.0 * math.pi)) * speed[:, None] * times
        bearing = pose[2] + 0.5 * turned
        x, y = pose[0] + chord * np.cos(bearing), pose[1] + chord * np.sin(bearing)
        gap = gaps(x, y, discs) - body.radius
        here = float(gaps(pose[None, 0], pose[None, 1], discs)[0]) - body.radius
        is_free = gap.min(axis=1) >= self.spare
        if here < self.spare + GRAZE:  # it all but touches something: round it and out
            is_free |= (gap.min(axis=1) >= here - GRAZE) & (gap[:, -1] >= here - 1e-3)
        if not is_free.any():
            return STILL
        miss = np.hypot(x - target[0], y - target[1]).min(axis=1)
        near = np.minimum(gap.min(axis=1), 0.5)
        worth = -miss + self.clearance_weight * near + self.speed_weight * speed
        best = int(np.argmax(np.where(is_free, worth, -np.inf)))
        return WheelCommand(float(speed[best]), float(turn[best]))


_SPARE = 0.02  # metres kept from things by the straight line to the point pursued
_LEAST = 0.15  # metres along the way below which no nearer point is asked for


def _pursued(
    pose: np.ndarray, way: np.ndarray, ahead: float, discs: np.ndarray, body: BodyLimits
) -> np.ndarray:
    """Choose the point of a way to head for: so far ahead, or nearer before a thing in between."""
    target = _along(pose[:2], way, ahead)
    kept = body.radius + _SPARE
    away = np.hypot(*(discs[:, :2] - pose[:2]).T) if len(discs) else np.zeros(0)
    # Discs that it touches already are shrunk, so that it may go round them and out.
    reach = np.minimum(discs[:, 2] + kept, np.maximum(away - GRAZE, 0.0))
    inflated = np.column_stack([discs[:, :2], reach])
    while ahead > _LEAST and not is_clear(pose[:2], target, inflated):
        ahead *= 0.6
        target = _along(pose[:2], way, ahead)
    return target


def _along(start: np.ndarray, way: np.ndarray, metres: float) -> np.ndarray:
    """Find the point of a way some distance ahead."""
    here, left = start, metres
    for corner in way:
        length = float(np.hypot(*(corner - here)))
        if length >= left:
            return here + (corner - here) * (left / length)
        left -= length
        here = corner
    return here


def wrap(angle: float) -> float:
    """Bring an angle, radians, into [−π, π]."""
    return math.remainder(angle, 2.0 * math.pi)


def turn_by(angle: float, body: BodyLimits) -> WheelCommand:
    """Turn on the spot, slowing down in time."""
    rate = min(body.turn_rate, math.sqrt(1.2 * body.turn_acceleration * abs(angle)))
    return WheelCommand(0.0, math.copysign(rate, angle))
