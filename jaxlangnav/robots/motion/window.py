"""A sampled dynamic window: of the arcs that the body can take next, the best one.

D. Fox, W. Burgard, S. Thrun, The dynamic window approach to collision avoidance, IEEE RAM 4(1),
1997. Alone it deadlocks before a thing; here it follows a way around things. Where no arc ahead is
free it turns on the spot towards the way, and where it cannot even go on it stands.
"""

import dataclasses
import math

import numpy as np

from jaxlangnav.robots.motion.body import BodyLimits
from jaxlangnav.robots.motion.mover import WheelCommand, braked, turn_by, wrap
from jaxlangnav.robots.motion.pursuit import pursued
from jaxlangnav.robots.motion.scan import gaps

_SPEEDS, _TURNS, _TIMES = 5, 15, 8
_REACTION = 0.5
"""Seconds within which the window's speeds can be reached."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Window:
    """Steering by a dynamic window."""

    ahead: float = 0.9
    """Metres along the way to the point headed for."""
    horizon: float = 1.6
    """Seconds for which an arc is followed."""
    spare: float = 0.02
    """Metres that an arc keeps from things."""
    widest: float = 1.0
    """Radians off the way beyond which it turns on the spot."""
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
        """Choose a command, see ``Steering``."""
        target = pursued(pose, way, self.ahead, discs, body)
        off = wrap(math.atan2(*(target - pose[:2])[::-1]) - pose[2])
        if abs(off) > self.widest:
            return turn_by(off, body)
        left = float(np.hypot(*np.diff(np.vstack([pose[:2], way]), axis=0).T).sum())
        most = braked(top_speed, left, body)
        low = max(moving.speed - body.acceleration * _REACTION, 0.0)
        high = min(moving.speed + body.acceleration * _REACTION, most)
        swing = body.turn_acceleration * _REACTION
        least_turn = max(moving.turn - swing, -body.turn_rate)
        most_turn = min(moving.turn + swing, body.turn_rate)
        speeds = np.linspace(min(low, high), high, _SPEEDS)
        turns = np.append(np.linspace(least_turn, most_turn, _TURNS), 0.0)
        speed, turn = (one.ravel() for one in np.meshgrid(speeds, turns))
        x, y = _arcs(pose, speed, turn, self.horizon)
        gap = gaps(x, y, discs) - body.radius
        here = float(gaps(pose[None, 0], pose[None, 1], discs)[0]) - body.radius
        is_free = gap.min(axis=1) >= min(self.spare, here - 1e-3)
        if not is_free.any():
            return turn_by(off, body) if abs(off) > 0.05 else WheelCommand(0.0, 0.0)
        miss = np.hypot(x - target[0], y - target[1]).min(axis=1)
        near = np.minimum(gap.min(axis=1), 0.5)
        worth = -miss + self.clearance_weight * near + self.speed_weight * speed
        best = int(np.argmax(np.where(is_free, worth, -np.inf)))
        if speed[best] < 0.02 and abs(off) > 0.05:
            return turn_by(off, body)
        return WheelCommand(float(speed[best]), float(turn[best]))


def _arcs(
    pose: np.ndarray, speed: np.ndarray, turn: np.ndarray, seconds: float
) -> tuple[np.ndarray, np.ndarray]:
    """Follow arcs: f64[S], f64[S] to x and y, f64[S, T]."""
    times = np.linspace(0.0, seconds, _TIMES + 1)[1:]
    turned = turn[:, None] * times
    # sin(a) / a and (1 − cos(a)) / a, whole at 0
    chord = np.sinc(turned / (2.0 * math.pi)) * speed[:, None] * times
    bearing = pose[2] + 0.5 * turned
    return pose[0] + chord * np.cos(bearing), pose[1] + chord * np.sin(bearing)
