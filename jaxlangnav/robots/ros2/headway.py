"""How far a robot has come with its goal, told from its odometry alone.

A goal sent as a message is answered by none: what became of it shows in where the robot goes.
"""

import numpy as np

from jaxlangnav.robots.motion.mover import wrap
from jaxlangnav.robots.robot import Progress

_REACHED, _FACED = 0.3, 0.2
"""Metres and radians within which a goal is reached."""
_NEAR = 1.3
"""Metres from a goal within which a robot that stands has come as near to it as things allow."""
_STILL = 3.0
"""Seconds without a move after which a robot stands; longer than one takes to find its way."""
_MOVED, _TURNED = 0.05, 0.05
"""Metres and radians that are a move."""


class Headway:
    """Watches one robot on its way to one goal after the other."""

    def __init__(self) -> None:
        """Begin without a goal."""
        self._goal: np.ndarray | None = None
        self._last = np.full(3, np.inf)
        self._since = 0.0

    def set(self, goal: np.ndarray | None, now: float) -> None:
        """Give a goal; one that is where the last was goes on being watched.

        Args:
            goal: f64[3], x, y, heading, map frame; None: it is to stand.
            now: seconds.
        """
        former, self._goal = self._goal, goal
        if former is None or goal is None or np.hypot(*(goal - former)[:2]) > _REACHED:
            self._since = now

    def progress(self, pose: np.ndarray, now: float) -> Progress:
        """Tell how far it has come.

        Args:
            pose: f64[3], x, y, heading, map frame.
            now: seconds.

        Returns:
            The progress.
        """
        turned = abs(wrap(float(pose[2] - self._last[2]))) if np.isfinite(self._last[2]) else np.inf
        if np.hypot(*(pose - self._last)[:2]) > _MOVED or turned > _TURNED:
            self._last, self._since = pose.copy(), now
        if self._goal is None:
            return Progress.STANDING
        away = float(np.hypot(*(self._goal - pose)[:2]))
        if away <= _REACHED and abs(wrap(float(self._goal[2] - pose[2]))) <= _FACED:
            return Progress.THERE
        if now - self._since < _STILL:
            return Progress.UNDER_WAY
        return Progress.THERE if away <= _NEAR else Progress.GAVE_UP
