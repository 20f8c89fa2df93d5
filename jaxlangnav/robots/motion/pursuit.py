"""Pure pursuit: an arc to a point of the way some distance ahead; turns on the spot if it is aside.

R. C. Coulter, Implementation of the pure pursuit path tracking algorithm, CMU-RI-TR-92-01, 1992.
"""

import dataclasses
import math

import numpy as np

from jaxlangnav.robots.motion.body import BodyLimits
from jaxlangnav.robots.motion.mover import WheelCommand, braked, room_ahead, turn_by, wrap
from jaxlangnav.robots.motion.path import is_clear

_SPARE = 0.02
"""Metres kept from things by the straight line to the point pursued."""
_LEAST = 0.15
"""Metres along the way below which no nearer point is asked for."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Pursuit:
    """Steering by pure pursuit."""

    ahead: float = 0.6
    """Metres along the way to the point pursued."""
    widest: float = 0.6
    """Radians off the way beyond which it turns on the spot."""

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
        offset = target - pose[:2]
        far = float(np.hypot(*offset))
        off = wrap(math.atan2(offset[1], offset[0]) - pose[2])
        if abs(off) > self.widest:
            return turn_by(off, body)
        left = float(np.hypot(*np.diff(np.vstack([pose[:2], way]), axis=0).T).sum())
        speed = braked(top_speed * math.cos(off), left, body)
        speed = braked(speed, room_ahead(pose, discs, body) - 0.02, body)
        turn = 2.0 * math.sin(off) / max(far, 0.2) * max(speed, 0.1)
        if abs(turn) > body.turn_rate:
            speed *= body.turn_rate / abs(turn)
        if speed < 0.02 and abs(off) > 0.05:
            return turn_by(off, body)
        return WheelCommand(speed, turn)


def pursued(
    pose: np.ndarray, way: np.ndarray, ahead: float, discs: np.ndarray, body: BodyLimits
) -> np.ndarray:
    """Choose the point of a way to head for: so far ahead, or nearer where a thing is in between.

    Args:
        pose: f64[3].
        way: f64[V, 2], corners ahead.
        ahead: metres along the way.
        discs: f64[K, 3], things, not inflated.
        body: its size.

    Returns:
        f64[2].
    """
    target = along(pose[:2], way, ahead)
    kept = body.radius + _SPARE
    away = np.hypot(*(discs[:, :2] - pose[:2]).T) if len(discs) else np.zeros(0)
    # What it touches already must not hold it.
    grown = np.minimum(discs[:, 2] + kept, np.maximum(away - 1e-3, 0.0))
    inflated = np.column_stack([discs[:, :2], grown])
    while ahead > _LEAST and not is_clear(pose[:2], target, inflated):
        ahead *= 0.6
        target = along(pose[:2], way, ahead)
    return target


def along(start: np.ndarray, way: np.ndarray, metres: float) -> np.ndarray:
    """Find the point of a way some distance ahead.

    Args:
        start: f64[2], where the way begins.
        way: f64[V, 2], its corners.
        metres: how far along.

    Returns:
        f64[2]; the end of a way that is shorter.
    """
    here, left = start, metres
    for corner in way:
        length = float(np.hypot(*(corner - here)))
        if length >= left:
            return here + (corner - here) * (left / length)
        left -= length
        here = corner
    return here
