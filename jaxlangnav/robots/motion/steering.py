"""Steering along a way around things: pure pursuit, or a sampled dynamic window.

R. C. Coulter, Implementation of the pure pursuit path tracking algorithm, CMU-RI-TR-92-01, 1992.
An arc leads to a point of the way some distance ahead; it turns on the spot if that is aside.

D. Fox, W. Burgard, S. Thrun, The dynamic window approach to collision avoidance, IEEE RAM 4(1),
1997. Of the arcs that the body can take next the best one; here along a way around things, as alone
it deadlocks before one. Where no arc ahead is free it turns on the spot towards the way.
"""

import abc
import dataclasses
import math
from typing import NamedTuple

import numpy as np

from jaxlangnav.robots.motion.path import gaps, is_clear

GRAZE = 0.03
"""Metres that a way round something that is touched, or all but, may come nearer to it."""
_BEFORE = 0.5  # cosine of the angle off the way ahead within which a thing is before the body


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


class _Around(NamedTuple):
    """What an arc is chosen by."""

    pose: np.ndarray  # f64[3], x, y, heading
    moving: WheelCommand  # the present command
    target: np.ndarray  # f64[2], point of the way that is headed for, metres
    off: float  # radians from the heading to the target
    discs: np.ndarray  # f64[K, 3], things, metres, not inflated
    top_speed: float  # metres a second wished for
    body: BodyLimits


@dataclasses.dataclass(frozen=True, kw_only=True)
class Steering(abc.ABC):
    """How to follow a way: chooses the next command."""

    ahead: float
    """Metres along the way to the point headed for."""
    widest: float
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
        arc = self._arc(_Around(pose, moving, target, off, discs, top_speed, body), left)
        return turn_by(off, body) if arc.speed < 0.02 and abs(off) > 0.05 else arc

    @abc.abstractmethod
    def _arc(self, around: _Around, left: float) -> WheelCommand:
        """Choose an arc ahead, ``STILL`` if there is none; so many metres of the way are left."""


_SPEEDS, _TURNS, _TIMES = 5, 15, 8
_REACTION = 0.5  # seconds within which the window's speeds can be reached


@dataclasses.dataclass(frozen=True, kw_only=True)
class Window(Steering):
    """Steering by a dynamic window."""

    ahead: float = 0.9
    widest: float = 1.0
    horizon: float = 1.6
    """Seconds for which an arc is followed."""
    spare: float = 0.02
    """Metres that an arc keeps from things."""
    clearance_weight: float = 0.3
    speed_weight: float = 0.3

    def _arc(self, around: _Around, left: float) -> WheelCommand:
        pose, moving, target, _, discs, top_speed, body = around
        most = _braked(top_speed, left, body)
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class Pursuit(Steering):
    """Steering by pure pursuit."""

    ahead: float = 0.6
    widest: float = 0.6

    def _arc(self, around: _Around, left: float) -> WheelCommand:
        pose, _, target, off, discs, top_speed, body = around
        far = float(np.hypot(*(target - pose[:2])))
        speed = _braked(top_speed * math.cos(off), left, body)
        speed = _braked(speed, _room_ahead(pose, discs, body) - 0.02, body)
        turn = 2.0 * math.sin(off) / max(far, 0.2) * max(speed, 0.1)
        if abs(turn) > body.turn_rate:
            speed *= body.turn_rate / abs(turn)
        return WheelCommand(speed, turn)


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


def _braked(speed: float, room: float, body: BodyLimits) -> float:
    """Limit a speed so that the body can stop within a room."""
    return min(speed, math.sqrt(1.6 * body.acceleration * max(room, 0.0)))


def _room_ahead(pose: np.ndarray, discs: np.ndarray, body: BodyLimits) -> float:
    """Measure how far the body can go straight ahead before it touches a thing."""
    if not len(discs):
        return math.inf
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = discs[:, 0] - pose[0], discs[:, 1] - pose[1]
    ahead, side = cosine * dx + sine * dy, cosine * dy - sine * dx
    reach, away = discs[:, 2] + body.radius, np.hypot(dx, dy)
    # What it all but touches holds it only where it is before it, not beside it.
    least = np.where(away < reach + 2.0 * GRAZE, _BEFORE * away, 0.0)
    is_ahead = (ahead > least) & (np.abs(side) < reach)
    if not is_ahead.any():
        return math.inf
    depth = np.sqrt(reach[is_ahead] ** 2 - side[is_ahead] ** 2)
    return float(max((ahead[is_ahead] - depth).min(), 0.0))
