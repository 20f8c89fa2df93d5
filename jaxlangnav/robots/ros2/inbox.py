"""What has come in from a robot: late, twice, in another order or not at all; without ROS.

A look is used once, beside the pose that the robot had when it was taken, by the robot's stamps.
Its side may start anew, its clock and its odometry at zero.
"""

import bisect
import dataclasses
import operator
from collections.abc import Sequence

import numpy as np

from jaxlangnav.robots.motion.steering import wrap
from jaxlangnav.robots.robot import Detection
from jaxlangnav.robots.ros2.conversions import carried, compose, inverse, pose_between

_KEPT = 10.0  # seconds of odometry that are kept
_GAP = 0.5  # seconds that a look may be away from the nearest odometry to be placed by it
_LATE = 2.0  # seconds after which a message is too old to be of use
_BACKWARDS = 10  # messages in a row that are too late for use: the robot's clock has begun anew
_SPEED, _JUMP = 2.0, 0.5
"""Metres a second, and metres or radians besides, beyond which odometry has begun anew."""
_SILENCE, _ZERO = 1.0, 0.2
"""Seconds without odometry after which one so near to its zero, metres or radians, has too."""


@dataclasses.dataclass(kw_only=True)
class Counts:
    """How many messages have come to what."""

    used: int = 0
    """Looks that have been decided by."""
    doubled: int = 0
    late: int = 0
    """Too old to be of use, or overtaken by a newer look that has been used."""
    unplaced: int = 0
    """Looks without odometry at their time."""
    malformed: int = 0
    restarts: int = 0
    """Times that the robot's clock or odometry has begun anew."""


class Track:
    """Odometry by time, in a map frame that outlives a restart of the robot.

    Where the robot's odometry begins anew it is taken to stand where it was last known to be.
    """

    def __init__(self, counts: Counts) -> None:
        """Begin with none; ``counts`` are counted in."""
        self._counts = counts
        self._log: list[tuple[float, np.ndarray]] = []
        self.frame = np.zeros(3)
        """Where the robot's present odometry frame is placed in the map frame, f64[3]."""
        self._old: list[tuple[float, np.ndarray]] = []

    @property
    def newest(self) -> float | None:
        """Stamp of the newest pose, seconds of the robot's clock; None if there is none."""
        return self._log[-1][0] if self._log else None

    @property
    def pose(self) -> np.ndarray | None:
        """The newest pose, f64[3], map frame; None if there is none."""
        return self._log[-1][1].copy() if self._log else None

    def add(self, stamp: float, pose: np.ndarray) -> None:
        """Take in odometry: seconds of the robot's clock, and f64[3], odometry frame."""
        if self.newest is not None and stamp < self.newest - _LATE:
            self._add_old(stamp, pose)
            return
        self._old.clear()
        place = self._place(stamp)
        if place < len(self._log) and self._log[place][0] == stamp:
            self._counts.doubled += 1
            return
        if self._log and place == len(self._log):
            # It begins anew where the robot cannot have gone in the meantime.
            last, former = self._log[-1]
            seconds = stamp - last
            gone = np.hypot(*(compose(self.frame, pose) - former)[:2])
            is_zero = seconds > _SILENCE and bool((np.abs(pose) < _ZERO).all())
            if gone > _SPEED * seconds + _JUMP or (is_zero and self._is_elsewhere(pose)):
                self._restart(pose)
        self._log.insert(place, (stamp, compose(self.frame, pose)))
        del self._log[: self._place(self._log[-1][0] - _KEPT)]

    def _place(self, stamp: float) -> int:
        """Find the first pose that is not before a stamp."""
        return bisect.bisect_left(self._log, stamp, key=operator.itemgetter(0))

    def at(self, stamp: float) -> np.ndarray | None:
        """Tell where a robot with a pose was at a stamp, f64[3]; None if no odometry is near."""
        after = self._place(stamp)
        near = self._log[max(after - 1, 0) : after + 1]
        (begin, first), (end, last) = near[0], near[-1]
        if min(abs(begin - stamp), abs(end - stamp)) > _GAP:
            return None
        share = (stamp - begin) / (end - begin) if end > begin else 0.0
        return pose_between(first, last, share)

    def _add_old(self, stamp: float, pose: np.ndarray) -> None:
        """Hold what is too late for use, until it is plain that the clock began anew."""
        if self._old and stamp <= self._old[-1][0]:
            self._old.clear()
        self._old.append((stamp, pose))
        self._counts.late += 1
        if len(self._old) < _BACKWARDS:
            return
        fresh, self._old = self._old, []
        self._counts.late -= len(fresh)
        self._restart(fresh[0][1])
        for one in fresh:
            self.add(*one)

    def _is_elsewhere(self, pose: np.ndarray) -> bool:
        """Tell whether a pose, odometry frame, is not where the robot last was."""
        off = compose(self.frame, pose) - self._log[-1][1]
        return bool(np.hypot(*off[:2]) > _JUMP or abs(wrap(float(off[2]))) > _JUMP)

    def _restart(self, pose: np.ndarray) -> None:
        """Place the robot's new odometry frame so that it stands where it last was."""
        if self._is_elsewhere(pose):
            self.frame = compose(self._log[-1][1], inverse(pose))
        self._log.clear()
        self._counts.restarts += 1


class Inbox:
    """Odometry and looks of one robot."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self.counts = Counts()
        self.track = Track(self.counts)
        self._look: tuple[float, Sequence[Detection]] | None = None
        self._taken = -np.inf
        self._heard = -np.inf
        self._restarts = 0

    def add_odometry(self, stamp: float, pose: np.ndarray) -> None:
        """Take in odometry, see ``Track.add``."""
        self.track.add(stamp, pose)
        if self._restarts != self.counts.restarts:
            # Looks of the robot's former life tell nothing of its new clock.
            self._restarts = self.counts.restarts
            self._look, self._taken = None, -np.inf

    def add_look(self, stamp: float, found: Sequence[Detection], now: float) -> None:
        """Take in a look; the newest is kept.

        It was taken at ``stamp`` of the robot's clock and has come at ``now`` of this side's.
        """
        self._heard = now
        if stamp == self._taken or (self._look is not None and stamp == self._look[0]):
            self.counts.doubled += 1
        elif stamp < self._taken or (self._look is not None and stamp < self._look[0]):
            self.counts.late += 1
        else:
            self._look = stamp, found

    def silent_for(self, now: float) -> float:
        """Tell for how many seconds of this side's clock no look has come; infinite at first."""
        return now - self._heard

    def take(self) -> list[Detection] | None:
        """Take the newest look, as from where the robot is now; None if there is no new one."""
        newest, pose = self.track.newest, self.track.pose
        if self._look is None or newest is None or pose is None:
            return None
        stamp, found = self._look
        if stamp < newest - _LATE:
            self.counts.late += 1
            self._look = None
            return None
        then = self.track.at(stamp)
        if then is None:
            if stamp < newest:
                self.counts.unplaced += 1
                self._look = None
            return None
        self._look, self._taken = None, stamp
        self.counts.used += 1
        return carried(found, then, pose)
