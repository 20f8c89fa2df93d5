"""A bus to a simulated robot in this very process: its time is the robot's, so deciding takes none.

For tests, and for recording drives that can be replayed: no ROS is needed.
"""

from typing import Any

import numpy as np

from jaxlangnav.robots.motion.mover import TICK
from jaxlangnav.robots.ros2.conversions import compose, inverse
from jaxlangnav.robots.ros2.inbox import Inbox
from jaxlangnav.robots.ros2.serve import LOOK_EVERY
from jaxlangnav.robots.simulated import SimulatedRobot


class Loopback:
    """Carries odometry and looks from a robot, and goals to it."""

    def __init__(self, simulated: SimulatedRobot) -> None:
        """Begin; the first odometry comes at the first spin.

        Args:
            simulated: the robot; its odometry begins at zero where it now stands.
        """
        self.simulated, self.inbox = simulated, Inbox()
        self.origin = simulated.pose()
        self._clock, self._ticks = simulated.seconds, 0

    def now(self) -> float:
        """Tell the time, see ``Bus.now``."""
        return self._clock

    def spin(self, seconds: float) -> None:
        """Let the robot's time pass, see ``Bus.spin``."""
        self._clock += seconds
        while self.simulated.seconds + TICK <= self._clock + 1e-6:
            self._tick()

    def send_goal(self, goal: np.ndarray, *, speed: float, clearance: float) -> None:
        """Send the robot somewhere, see ``Bus.send_goal``."""
        place = compose(self.origin, goal)
        facing = float(place[2])
        self.simulated.go_to(place[None, :2], speed=speed, clearance=clearance, facing=facing)

    def publish(self, topic: str, stamp: float, what: Any) -> None:
        """Carry what the robot says: here it comes at once.

        Args:
            topic: "odom" or "detections".
            stamp: seconds of the robot's clock.
            what: a pose f64[3], odometry frame, or detections.
        """
        if topic == "odom":
            self.inbox.add_odometry(stamp, what)
        else:
            self.inbox.add_look(stamp, what, self.simulated.seconds)

    def _tick(self) -> None:
        self.simulated.wait(TICK)
        now, self._ticks = self.simulated.seconds, self._ticks + 1
        self.publish("odom", now, compose(inverse(self.origin), self.simulated.pose()))
        found = self.simulated.detections() if self._ticks % LOOK_EVERY == 0 else None
        if found is not None:
            self.publish("detections", now, found)
