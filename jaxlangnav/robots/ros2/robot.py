"""The door ``Robot`` over messages: any robot that takes goals and tells odometry and looks."""

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np

from jaxlangnav.messages import SensorParams
from jaxlangnav.robots.motion.steering import wrap
from jaxlangnav.robots.robot import Detection, WaypointStatus
from jaxlangnav.robots.ros2.conversions import compose, inverse
from jaxlangnav.robots.ros2.inbox import Inbox

_REACHED, _FACED = 0.3, 0.2  # metres and radians within which a goal is reached
_NEAR = 1.3  # metres from a goal within which a robot that stands is as near as things allow
_STILL = 3.0  # seconds without a move after which a robot stands; longer than finding a way takes
_MOVED, _TURNED = 0.05, 0.05  # metres and radians that are a move


class Headway:
    """Watches one robot on its way to one goal after the other."""

    def __init__(self) -> None:
        """Begin without a goal."""
        self._goal: np.ndarray | None = None
        self._last = np.full(3, np.inf)
        self._since = 0.0

    def set(self, goal: np.ndarray | None, now: float) -> None:
        """Give a goal f64[3], map frame, at seconds; None: it is to stand.

        One that is where the last was goes on being watched.
        """
        former, self._goal = self._goal, goal
        if former is None or goal is None or np.hypot(*(goal - former)[:2]) > _REACHED:
            self._since = now

    def progress(self, pose: np.ndarray, now: float) -> WaypointStatus:
        """Tell how far a robot has come that is at f64[3], map frame, at seconds."""
        turned = abs(wrap(float(pose[2] - self._last[2]))) if np.isfinite(self._last[2]) else np.inf
        if np.hypot(*(pose - self._last)[:2]) > _MOVED or turned > _TURNED:
            self._last, self._since = pose.copy(), now
        if self._goal is None:
            return WaypointStatus.STANDING
        away = float(np.hypot(*(self._goal - pose)[:2]))
        if away <= _REACHED and abs(wrap(float(self._goal[2] - pose[2]))) <= _FACED:
            return WaypointStatus.THERE
        if now - self._since < _STILL:
            return WaypointStatus.UNDER_WAY
        return WaypointStatus.THERE if away <= _NEAR else WaypointStatus.GAVE_UP


PATIENCE = 1.0
"""Seconds that a look is waited for: a detector has to deliver one more often than that."""
_TURN = 0.05  # seconds of one turn of the loop that takes messages in


class Bus(Protocol):
    """What carries messages; takes them in only while it is spun, never behind one's back."""

    inbox: Inbox

    def now(self) -> float:
        """Tell the time, seconds since any moment; never goes back."""
        ...

    def spin(self, seconds: float) -> None:
        """Take in what comes within a time."""

    def send_goal(self, goal: np.ndarray, *, speed: float, clearance: float) -> None:
        """Send where to go, f64[3], x, y, heading, the robot's own odometry frame.

        Speed is a factor on the robot's normal one, clearance metres to keep from things.
        """


class RosRobot:
    """A robot on the other side of a bus."""

    def __init__(
        self,
        bus: Bus,
        *,
        sensor: SensorParams,
        area: tuple[float, float, float, float],
        patience: float = 0.0,
        on_silence: Callable[[], None] = lambda: None,
    ) -> None:
        """Take a bus; a ValueError if no odometry has come in.

        Args:
            bus: what carries the messages.
            sensor: specification of the detector.
            area: operating area x_min, x_max, y_min, y_max, metres, map frame.
            patience: seconds for which a robot that tells nothing any more, odometry neither, is
                waited for: it may be starting anew.
            on_silence: is told when that begins.
        """
        if bus.inbox.track.pose is None:
            raise ValueError("no odometry has come from the robot: wait for it first")
        self._bus, self.sensor, self.area = bus, sensor, area
        self._headway = Headway()
        self._patience, self._on_silence = patience, on_silence
        self._newest, self._newest_at, self._is_away = bus.inbox.track.newest, bus.now(), False

    def pose(self) -> np.ndarray:
        """Tell x, y, heading, see ``Robot.pose``; what was last known while it is silent."""
        pose = self._bus.inbox.track.pose
        if pose is None:
            raise ValueError("no odometry has come from the robot")
        return pose

    def detections(self) -> list[Detection] | None:
        """Give the newest look that has not been given yet, waiting for one if need be.

        None where the detector has been silent for longer than ``PATIENCE``, and the whole robot
        for longer than its patience.
        """
        bus, began = self._bus, self._bus.now()
        # What has come during a long decision is no silence.
        while True:
            bus.spin(_TURN)
            found = bus.inbox.take()
            if found is not None or not self._may_come(began):
                return found

    def _may_come(self, began: float) -> bool:
        """Tell whether it is of use to wait on for a look."""
        now = self._bus.now()
        newest = self._bus.inbox.track.newest
        if newest != self._newest:
            self._newest, self._newest_at, self._is_away = newest, now, False
        silent = now - self._newest_at
        if PATIENCE < silent <= self._patience:
            if not self._is_away:
                self._is_away = True
                self._on_silence()
            return True
        return self._bus.inbox.silent_for(now) <= PATIENCE and now - began <= 2.0 * PATIENCE

    def go_to(
        self, waypoints: np.ndarray, *, speed: float, clearance: float, facing: float | None = None
    ) -> None:
        """Send the last of the waypoints as the goal, see ``Robot.go_to``.

        Without ``facing`` the robot is to look the way that it comes.
        """
        pose, target = self.pose(), np.asarray(waypoints, float)[-1]
        way = target - pose[:2]
        if facing is None:
            facing = math.atan2(way[1], way[0]) if np.hypot(*way) > _TURN else float(pose[2])
        goal = np.array([*target, facing])
        self._headway.set(goal, self._bus.now())
        self._send(goal, speed, clearance)

    def wait(self, seconds: float) -> WaypointStatus:
        """Take messages in for a time, see ``Robot.wait``."""
        self._bus.spin(seconds)
        return self._headway.progress(self.pose(), self._bus.now())

    def stop(self) -> None:
        """Send the robot to where it is."""
        self._headway.set(None, self._bus.now())
        self._send(self.pose(), 1.0, 0.0)

    def _send(self, goal: np.ndarray, speed: float, clearance: float) -> None:
        """Send a goal in the frame that the robot's odometry has at present."""
        frame = self._bus.inbox.track.frame
        self._bus.send_goal(compose(inverse(frame), goal), speed=speed, clearance=clearance)
