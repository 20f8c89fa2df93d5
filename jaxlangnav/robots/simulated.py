"""What simulated robots have in common: a clock, a motion planner, odometry, things that happen.

A backend tells how the body answers a command and what scanner and camera see. The truth stays in
here: ``true_position`` and ``travelled`` are for whoever judges a run, never for the navigator.
"""

import abc
import heapq
import itertools
from collections.abc import Callable, Sequence
from typing import Self

import numpy as np

from jaxlangnav.messages import SensorParams
from jaxlangnav.robots.motion.mover import TICK, Mover
from jaxlangnav.robots.motion.path import to_discs
from jaxlangnav.robots.motion.steering import WheelCommand
from jaxlangnav.robots.robot import Detection, Progress

BEAMS = np.linspace(-np.pi, np.pi, 181)[:-1]
"""Radians, directions of the scanner's beams in the robot frame."""
SCAN_RANGE = 6.0
"""Metres that the scanner sees."""


class SimulatedRobot(abc.ABC):
    """A robot whose time passes only in ``wait``."""

    def __init__(
        self,
        mover: Mover,
        *,
        sensor: SensorParams,
        area: Sequence[float],
        start: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        """Put the robot at its start.

        Args:
            mover: its motion planner.
            sensor: specification of its detector.
            area: operating area x_min, x_max, y_min, y_max, metres, map frame.
            start: x, y, heading, metres and radians; known to it.
        """
        self.mover = mover
        self.seconds = 0.0
        self.travelled = 0.0
        self.camera_works = True
        self.on_tick: Callable[[Self], None] | None = None
        self.on_look: Callable[[Self], None] | None = None
        """Is told each look just after it was taken, one without a picture too."""
        self.sensor = sensor
        """What the belief is told of the detector."""
        x_min, x_max, y_min, y_max = (float(edge) for edge in area)
        self.area = (x_min, x_max, y_min, y_max)
        self._odometry = np.array(start, float)
        self._count = itertools.count()
        self._events: list[tuple[float, int, Callable[[Self], None]]] = []

    @property
    @abc.abstractmethod
    def true_pose(self) -> np.ndarray:
        """Where it truly is: x, y, heading, f64[3], map frame."""

    @abc.abstractmethod
    def _scan(self) -> np.ndarray:
        """Measure how far the nearest thing is along each of ``BEAMS``, f64[B], metres."""

    @abc.abstractmethod
    def _move(self, command: WheelCommand) -> np.ndarray:
        """Carry out a command for a tick: f64[2], metres and radians as wheels and gyro have it."""

    @abc.abstractmethod
    def _look(self) -> list[Detection]:
        """Find things in a picture taken now."""

    def at(self, seconds: float, event: Callable[[Self], None]) -> None:
        """Let something happen to the robot, a fault or a person, at seconds of its clock."""
        heapq.heappush(self._events, (seconds, next(self._count), event))

    def pose(self) -> np.ndarray:
        """Tell x, y, heading by dead reckoning, see ``Robot.pose``."""
        return self._odometry.copy()

    def detections(self) -> list[Detection] | None:
        """Look, see ``Robot.detections``."""
        found = self._look() if self.camera_works else None
        if self.on_look is not None:
            self.on_look(self)
        return found

    def go_to(
        self,
        waypoints: np.ndarray,
        *,
        speed: float,
        clearance: float,
        facing: float | None = None,
    ) -> None:
        """Make for waypoints, see ``Robot.go_to``."""
        self.mover.go_to(waypoints, speed=speed, clearance=clearance, facing=facing)

    def stop(self) -> None:
        """Stand still, see ``Robot.stop``."""
        self.mover.stop()

    def wait(self, seconds: float) -> Progress:
        """Let time pass, see ``Robot.wait``."""
        for _ in range(max(1, round(seconds / TICK))):
            self._tick()
        return self.mover.progress

    def _tick(self) -> None:
        while self._events and self._events[0][0] <= self.seconds:
            heapq.heappop(self._events)[2](self)
        discs = to_discs(self._scan(), BEAMS, self._odometry)
        before = self.true_pose
        ahead, turned = self._move(self.mover.tick(self._odometry, discs))
        self.travelled += float(np.hypot(*(self.true_pose - before)[:2]))
        middle = self._odometry[2] + 0.5 * turned
        self._odometry += np.array([ahead * np.cos(middle), ahead * np.sin(middle), turned])
        self.seconds += TICK
        if self.on_tick is not None:
            self.on_tick(self)
