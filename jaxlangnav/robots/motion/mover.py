"""Motion planner to a goal: repeated path planning and dynamic-window control.

It fails where there is no path, or where the robot makes no progress.
"""

import itertools
import math

import numpy as np

from jaxlangnav.robots.motion.path import find_path, inflate, is_clear
from jaxlangnav.robots.motion.steering import (
    STOP,
    BodyLimits,
    WheelCommand,
    steer,
    turn_in_place,
    wrap,
)
from jaxlangnav.robots.robot import WaypointStatus

TICK = 0.1
"""Seconds between two wheel commands."""
TOLERANCE = 0.12
"""Metres from the goal, or the next corner of a path, within which it is reached."""
_MAX_TURN_SPEED = 0.1  # metres a second below which it may turn in place
_HEADING_TOLERANCE = 0.15  # radians off the goal within which the robot faces it
_MIN_OFFSET = 0.3  # metres from the goal beyond which its direction is defined
_STUCK_SECONDS = 8.0  # without motion: then it fails
_MOVED = 0.1  # metres, or a fifth of a radian, that count as motion
_BASE, _DETOUR = 15.0, 4.0  # time limit: base seconds, and factor on the direct time
_DISC_JITTER = np.array([0.0, 0.0, 0.06])  # metres by which discs may grow while a path stays free
_REPLAN_SECONDS = 0.3  # from one planning, or shortening of a free path, to the next
_MAX_FAILURES = 10  # consecutive failed plannings: then there is no path


class MotionPlanner:
    """Motion planner: shortest path around inflated discs, followed by a local controller."""

    def __init__(self, body: BodyLimits) -> None:
        """Initialize at rest, without a goal."""
        self.body = body
        self.command, self.progress = STOP, WaypointStatus.STANDING
        self._goal = np.full(2, np.inf)
        self._speed, self._clearance = 1.0, 0.0
        self._facing: float | None = None
        self._reset()

    def _reset(self) -> None:
        self._path: np.ndarray | None = None
        self._path_age = self._time_left = math.inf
        self._failures = 0
        self._last_pose = np.full(3, np.inf)
        self._still_seconds = 0.0

    def go_to(
        self, goal: np.ndarray, *, speed: float, clearance: float, facing: float | None = None
    ) -> None:
        """Set a finite goal or ``ValueError``, as ``Robot.go_to``; the same changes nothing."""
        goal = np.asarray(goal, float)
        if goal.shape != (2,) or not np.isfinite(goal).all():
            raise ValueError(f"the goal is {goal.tolist()}, but must be two finite numbers")
        is_same = self.progress is WaypointStatus.UNDER_WAY and facing == self._facing
        if not is_same or np.hypot(*(goal - self._goal)) >= TOLERANCE:
            self._reset()
        self._goal, self._speed, self._clearance = goal, speed, clearance
        self._facing, self.progress = facing, WaypointStatus.UNDER_WAY

    def stop(self) -> None:
        """Drop the goal; the next commands brake."""
        self.progress = WaypointStatus.STANDING

    def tick(self, pose: np.ndarray, discs: np.ndarray) -> WheelCommand:
        """Compute the next wheel command, within the body's limits of speed and acceleration.

        Args:
            pose: f64[3], the robot's estimated pose.
            discs: f64[K, 3], obstacles in the same frame, metres.
        """
        command = STOP
        if self.progress is WaypointStatus.UNDER_WAY:
            command = self._follow(pose, discs)
        body, current = self.body, self.command
        if command.speed == 0.0 and abs(current.speed) > _MAX_TURN_SPEED:
            # Brake first: while a skid-steer turns in place, its tires do not brake it.
            command = STOP
        limit = np.array([body.top_speed, body.turn_rate])
        change = np.array([body.acceleration, body.turn_acceleration]) * TICK
        limited = np.clip(np.clip(command, -limit, limit), current - change, current + change)
        self.command = WheelCommand(*limited.tolist())
        return self.command

    def _follow(self, pose: np.ndarray, discs: np.ndarray) -> WheelCommand:
        """Compute the desired command, without the body's limits."""
        self._plan(pose, discs)
        if self._path is None:
            if self._failures >= _MAX_FAILURES:
                self.progress = WaypointStatus.FAILED
            return STOP
        if len(self._path) == 1 and np.hypot(*(self._path[0] - pose[:2])) < TOLERANCE:
            self._path = self._path[1:]
        if not len(self._path):
            return self._arrive(pose)
        if self._is_stuck(pose):
            self.progress = WaypointStatus.FAILED
            return STOP
        speed = min(self.body.speed * self._speed, self.body.top_speed)
        return steer(pose, self.command, self._path, discs, top_speed=speed, body=self.body)

    def _plan(self, pose: np.ndarray, discs: np.ndarray) -> None:
        """Plan a path if there is none or it is blocked; shorten a free one from time to time."""
        self._path_age += TICK
        inflated = inflate(discs, pose[:2], self._goal, self.body.radius, self._clearance)
        is_free = self._path is not None and all(
            is_clear(*pair, inflated - _DISC_JITTER)
            for pair in itertools.pairwise([pose[:2], *self._path])
        )
        if self._path_age < _REPLAN_SECONDS and (is_free or self._path is None):
            return
        self._path_age = 0.0
        if not is_free or self._path is None:
            self._path = find_path(pose[:2], self._goal, inflated)
            self._failures = self._failures + 1 if self._path is None else 0
            return
        # Skip corners that have been passed, and those that a free segment bypasses.
        while len(path := self._path) > 1:
            is_passed = (pose[:2] - path[0]) @ (path[1] - path[0]) > 0.0
            if not is_passed and not is_clear(pose[:2], path[1], inflated - _DISC_JITTER):
                break
            self._path = path[1:]

    def _arrive(self, pose: np.ndarray) -> WheelCommand:
        """Turn to the final heading, then report the goal as reached."""
        offset = self._goal - pose[:2]
        facing = self._facing
        if facing is None and np.hypot(*offset) > _MIN_OFFSET:
            facing = math.atan2(offset[1], offset[0])
        error = 0.0 if facing is None else wrap(facing - pose[2])
        if abs(error) > _HEADING_TOLERANCE:
            return turn_in_place(error, self.body)
        self.progress = WaypointStatus.REACHED
        return STOP

    def _is_stuck(self, pose: np.ndarray) -> bool:
        """Tell whether the robot has been at rest, or under way, for too long."""
        if math.isinf(self._time_left):
            straight = float(np.hypot(*(self._goal - pose[:2])))
            self._time_left = _BASE + _DETOUR * straight / max(self.body.speed * self._speed, 0.05)
        self._time_left -= TICK
        self._still_seconds += TICK
        has_moved = np.hypot(*(pose - self._last_pose)[:2]) > _MOVED
        if has_moved or abs(pose[2] - self._last_pose[2]) > 2.0 * _MOVED:
            self._last_pose, self._still_seconds = pose.copy(), 0.0
        return self._still_seconds > _STUCK_SECONDS or self._time_left < 0.0
