"""``Robot`` over messages: any robot that takes goals and sends odometry and detections."""

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np

from jaxlangnav.messages import SensorParams
from jaxlangnav.robots.motion.steering import wrap
from jaxlangnav.robots.robot import Detection, WaypointStatus
from jaxlangnav.robots.ros2.conversions import compose, inverse
from jaxlangnav.robots.ros2.inbox import Inbox

_GOAL_RADIUS, _MAX_TURN = 0.3, 0.2  # metres, radians
_NEAR_RADIUS = 1.3  # metres from a goal within which a resting robot is as near as possible
_STILL_SECONDS = 3.0  # without motion: then the robot is at rest; planning a path is faster
_MOVED, _TURNED = 0.05, 0.05  # metres and radians that count as motion


class GoalMonitor:
    """Monitor of a robot's progress towards its goals."""

    def __init__(self) -> None:
        """Start without a goal."""
        self._goal: np.ndarray | None = None
        self._last_pose = np.full(3, np.inf)
        self._still_since = 0.0

    def set(self, goal: np.ndarray | None, now: float) -> None:
        """Set a goal f64[3], map frame, at a time in seconds; None: the robot is to stand.

        A goal at the same position continues the last one.
        """
        last_goal, self._goal = self._goal, goal
        if last_goal is None or goal is None or np.hypot(*(goal - last_goal)[:2]) > _GOAL_RADIUS:
            self._still_since = now

    def progress(self, pose: np.ndarray, now: float) -> WaypointStatus:
        """Update with the robot's pose f64[3], map frame, at a time in seconds."""
        shift = pose - self._last_pose
        turn = abs(wrap(float(shift[2]))) if np.isfinite(shift[2]) else np.inf
        if np.hypot(*shift[:2]) > _MOVED or turn > _TURNED:
            self._last_pose, self._still_since = pose.copy(), now
        if self._goal is None:
            return WaypointStatus.STANDING
        distance = float(np.hypot(*(self._goal - pose)[:2]))
        if distance <= _GOAL_RADIUS and abs(wrap(float(self._goal[2] - pose[2]))) <= _MAX_TURN:
            return WaypointStatus.REACHED
        if now - self._still_since < _STILL_SECONDS:
            return WaypointStatus.UNDER_WAY
        return WaypointStatus.REACHED if distance <= _NEAR_RADIUS else WaypointStatus.FAILED


PATIENCE = 1.0
"""Seconds to wait for detections; the detector must be faster than that."""
_SPIN_SECONDS = 0.05  # of one iteration of the message loop


class Bus(Protocol):
    """Message transport; messages are received only during ``spin``."""

    inbox: Inbox

    def now(self) -> float:
        """Return a monotonic time, seconds."""
        ...

    def spin(self, seconds: float) -> None:
        """Receive messages for some seconds."""

    def send_goal(self, goal: np.ndarray, *, speed: float, clearance: float) -> None:
        """Send a goal f64[3], x, y, heading, in the robot's odometry frame.

        Speed is a factor on the robot's normal one, clearance metres to keep from obstacles.
        """


class RosRobot:
    """A robot that is connected by a bus."""

    def __init__(
        self,
        bus: Bus,
        *,
        sensor: SensorParams,
        area: tuple[float, float, float, float],
        patience: float = 0.0,
        on_silence: Callable[[], None] = lambda: None,
    ) -> None:
        """Connect to a bus; a ValueError if no odometry has been received.

        Args:
            bus: message transport.
            sensor: specification of the detector.
            area: operating area x_min, x_max, y_min, y_max, metres, map frame.
            patience: seconds to wait for a robot that sends neither detections nor odometry; it
                may be restarting.
            on_silence: called when such a silence begins.
        """
        self._bus, self.sensor, self.area = bus, sensor, area
        self.pose()
        self._monitor = GoalMonitor()
        self._patience, self._on_silence = patience, on_silence
        self._newest, self._newest_time, self._is_silent = bus.inbox.track.newest, bus.now(), False

    def pose(self) -> np.ndarray:
        """Return x, y, heading, see ``Robot.pose``; the last known pose while it is silent.

        A ValueError if no odometry has been received.
        """
        pose = self._bus.inbox.track.pose
        if pose is None:
            raise ValueError("no odometry has come from the robot: wait for it first")
        return pose

    def detections(self) -> list[Detection] | None:
        """Return the newest unused detections, waiting for them if necessary.

        None once the detector has been silent for longer than ``PATIENCE``, and the whole robot
        for longer than its patience.
        """
        bus, start = self._bus, self._bus.now()
        # Messages that arrived during a long decision do not count as silence.
        while True:
            bus.spin(_SPIN_SECONDS)
            detections = bus.inbox.take()
            if detections is not None or not self._may_arrive(start):
                return detections

    def _may_arrive(self, start: float) -> bool:
        now = self._bus.now()
        newest = self._bus.inbox.track.newest
        if newest != self._newest:
            self._newest, self._newest_time, self._is_silent = newest, now, False
        if PATIENCE < now - self._newest_time <= self._patience:
            if not self._is_silent:
                self._is_silent = True
                self._on_silence()
            return True
        return self._bus.inbox.silent_for(now) <= PATIENCE and now - start <= 2.0 * PATIENCE

    def go_to(
        self, goal: np.ndarray, *, speed: float, clearance: float, facing: float | None = None
    ) -> None:
        """Send a goal, see ``Robot.go_to``; its heading without ``facing`` is that of travel."""
        pose = self.pose()
        offset = goal - pose[:2]
        if facing is None:
            facing = math.atan2(*offset[::-1]) if np.hypot(*offset) > _MOVED else float(pose[2])
        goal_pose = np.array([*goal, facing])
        self._monitor.set(goal_pose, self._bus.now())
        self._send(goal_pose, speed, clearance)

    def wait(self, seconds: float) -> WaypointStatus:
        """Receive messages for a time, see ``Robot.wait``."""
        self._bus.spin(seconds)
        return self._monitor.progress(self.pose(), self._bus.now())

    def stop(self) -> None:
        """Send the robot's present pose as the goal."""
        self._monitor.set(None, self._bus.now())
        self._send(self.pose(), 1.0, 0.0)

    def _send(self, goal: np.ndarray, speed: float, clearance: float) -> None:
        """Send a goal, converted to the robot's present odometry frame."""
        frame = self._bus.inbox.track.frame
        self._bus.send_goal(compose(inverse(frame), goal), speed=speed, clearance=clearance)
