"""Following waypoints with a body: a way around things, found anew as it goes, and steering.

It gives up where there is no way, or where it no longer comes nearer.
"""

import itertools
import math

import numpy as np

from jaxlangnav.robots.motion.path import NO_DISCS, find_path, inflate, is_clear
from jaxlangnav.robots.motion.steering import (
    STILL,
    BodyLimits,
    WheelCommand,
    Window,
    turn_by,
    wrap,
)
from jaxlangnav.robots.robot import WaypointStatus

TICK = 0.1
"""Seconds between two commands to the wheels."""
CLOSE_BY = 0.12
"""Metres from a waypoint that count as being there."""
_CREEP = 0.1  # metres a second below which it may turn on the spot
_FACING = 0.15  # radians off the last waypoint that count as facing it
_BESIDE = 0.3  # metres from the last waypoint from which on there is something to face
_PATIENCE = 8.0  # seconds without moving after which it gives up
_MOVED = 0.1  # metres, or a fifth of a radian, that count as having moved
_GRACE, _DETOUR = 15.0, 4.0  # it gives up after so many seconds and times that of the straight way
_TREMBLE = np.array([0.0, 0.0, 0.06])  # metres by which discs may grow before a way is not free
_PLAN_EVERY = 0.3  # seconds after which a way is looked for again, or a free one shortened
_TRIES = 10  # ways looked for in vain, one after the other, after which there is none


class Mover:
    """A motion planner: the shortest way round inflated discs before a way of steering."""

    def __init__(self, body: BodyLimits) -> None:
        """Build one that stands still."""
        self.body, self.steering = body, Window()
        self.moving, self.progress = STILL, WaypointStatus.STANDING
        self._waypoints = np.zeros((0, 2))
        self._speed, self._clearance = 1.0, 0.0
        self._facing: float | None = None
        self._forget()

    def _forget(self) -> None:
        self._way: np.ndarray | None = None
        self._age = math.inf
        self._failed = 0
        self._last = np.full(3, np.inf)
        self._still_for = 0.0
        self._left = math.inf

    def go_to(
        self, waypoints: np.ndarray, *, speed: float, clearance: float, facing: float | None = None
    ) -> None:
        """Take waypoints, see ``Robot.go_to``; the same ones again change nothing."""
        points = np.asarray(waypoints, float).reshape(-1, 2)
        if not len(points) or not np.isfinite(points).all():
            raise ValueError(f"waypoints are {points.tolist()}, but must be finite, one at least")
        is_same = (
            self.progress is WaypointStatus.UNDER_WAY and points.shape == self._waypoints.shape
        )
        is_same = is_same and bool(np.hypot(*(points - self._waypoints).T).max() < CLOSE_BY)
        if not is_same or facing != self._facing:
            self._forget()
        self._waypoints, self._speed, self._clearance = points, speed, clearance
        self._facing, self.progress = facing, WaypointStatus.UNDER_WAY

    def stop(self) -> None:
        """Forget the waypoints; the next commands brake."""
        self.progress = WaypointStatus.STANDING

    def tick(self, pose: np.ndarray, discs: np.ndarray = NO_DISCS) -> WheelCommand:
        """Choose the next command to the wheels, within what the body can do in a tick.

        Args:
            pose: f64[3], where the robot takes itself to be.
            discs: f64[K, 3], things in the same frame, metres.
        """
        wanted = STILL
        if self.progress is WaypointStatus.UNDER_WAY:
            wanted = self._follow(pose, discs)
        body, moving = self.body, self.moving
        if wanted.speed == 0.0 and abs(moving.speed) > _CREEP:
            # First brake: tyres that turn a skid-steer on the spot hold it no longer ahead.
            wanted = STILL
        speed = min(max(wanted.speed, -body.top_speed), body.top_speed)
        turn = min(max(wanted.turn, -body.turn_rate), body.turn_rate)
        most, most_turn = body.acceleration * TICK, body.turn_acceleration * TICK
        self.moving = WheelCommand(
            min(max(speed, moving.speed - most), moving.speed + most),
            min(max(turn, moving.turn - most_turn), moving.turn + most_turn),
        )
        return self.moving

    def _follow(self, pose: np.ndarray, discs: np.ndarray) -> WheelCommand:
        """Choose the command that is wanted, whatever the body can do."""
        if len(self._waypoints) > 1 and np.hypot(*(self._waypoints[0] - pose[:2])) < CLOSE_BY:
            self._waypoints = self._waypoints[1:]
            self._way = None
        self._plan(pose, discs)
        if self._way is None:
            if self._failed >= _TRIES:
                self.progress = WaypointStatus.GAVE_UP
            return STILL
        if len(self._way) == 1 and np.hypot(*(self._way[0] - pose[:2])) < CLOSE_BY:
            self._way = self._way[1:]
        if not len(self._way):
            return self._arrive(pose)
        if self._is_stuck(pose):
            self.progress = WaypointStatus.GAVE_UP
            return STILL
        wished = min(self.body.speed * self._speed, self.body.top_speed)
        return self.steering.steer(
            pose, self.moving, self._way, discs, top_speed=wished, body=self.body
        )

    def _plan(self, pose: np.ndarray, discs: np.ndarray) -> None:
        """Look for a way if there is none, if the old one is not free any more, or now and then."""
        self._age += TICK
        goal = self._waypoints[0]
        inflated = inflate(discs, pose[:2], goal, self.body.radius, self._clearance)
        is_free = self._way is not None and all(
            is_clear(*pair, inflated - _TREMBLE)
            for pair in itertools.pairwise([pose[:2], *self._way])
        )
        if self._age < _PLAN_EVERY and (is_free or self._way is None):
            return
        self._age = 0.0
        if not is_free or self._way is None:
            self._way = find_path(pose[:2], goal, inflated)
            self._failed = self._failed + 1 if self._way is None else 0
            return
        # Corners that have been passed are left out, and those beyond which the way lies open.
        while len(way := self._way) > 1:
            is_passed = (pose[:2] - way[0]) @ (way[1] - way[0]) > 0.0
            if not is_passed and not is_clear(pose[:2], way[1], inflated - _TREMBLE):
                break
            self._way = way[1:]

    def _arrive(self, pose: np.ndarray) -> WheelCommand:
        """Face what the last waypoint is on, and be there."""
        if len(self._waypoints) > 1:
            self._waypoints = self._waypoints[1:]
            self._way = None
            return STILL
        offset = self._waypoints[0] - pose[:2]
        facing = self._facing
        if facing is None and np.hypot(*offset) > _BESIDE:
            facing = math.atan2(offset[1], offset[0])
        off = 0.0 if facing is None else wrap(facing - pose[2])
        if abs(off) > _FACING:
            return turn_by(off, self.body)
        self.progress = WaypointStatus.THERE
        return STILL

    def _is_stuck(self, pose: np.ndarray) -> bool:
        """Tell whether it has stood for too long, or been under way for too long."""
        if math.isinf(self._left):
            straight = float(np.hypot(*(self._waypoints[-1] - pose[:2])))
            self._left = _GRACE + _DETOUR * straight / max(self.body.speed * self._speed, 0.05)
        self._left -= TICK
        self._still_for += TICK
        moved = np.hypot(*(pose - self._last)[:2]) > _MOVED
        if moved or abs(pose[2] - self._last[2]) > 2.0 * _MOVED:
            self._last, self._still_for = pose.copy(), 0.0
        return self._still_for > _PATIENCE or self._left < 0.0
