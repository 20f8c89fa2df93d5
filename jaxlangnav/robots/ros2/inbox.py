"""Synchronize odometry and detections by their stamps; messages may be late, doubled or lost.

Detections are used once, with the robot's pose at their stamp, by the robot's clock. The robot may
restart, with its clock and odometry at zero. Without ROS.
"""

import bisect
import dataclasses
import operator
from collections.abc import Sequence

import numpy as np

from jaxlangnav.robots.motion.steering import wrap
from jaxlangnav.robots.robot import Detection
from jaxlangnav.robots.ros2.conversions import compose, inverse, pose_between, transformed

_BUFFER_SECONDS = 10.0  # of odometry
_MAX_GAP = 0.5  # seconds between detections and the nearest odometry
_MAX_AGE = 2.0  # seconds after which a message is discarded
_MAX_LATE = 10  # consecutive messages that are too late: then the robot's clock has restarted
_MAX_SPEED, _MAX_JUMP = 2.0, 0.5
"""Metres a second, and metres or radians besides, beyond which odometry has restarted."""
_MIN_SILENCE, _ZERO_TOLERANCE = 1.0, 0.2
"""Odometry this near to zero, metres or radians, after so many silent seconds has restarted."""


@dataclasses.dataclass(kw_only=True)
class Counts:
    """Counts of messages by outcome."""

    used: int = 0
    """Detection messages that have been used."""
    doubled: int = 0
    late: int = 0
    """Too old, or older than detections that have been used."""
    unplaced: int = 0
    """Detections without odometry at their stamp."""
    malformed: int = 0
    restarts: int = 0
    """Restarts of the robot's clock or odometry."""


class OdometryBuffer:
    """Odometry by time, in a map frame that persists over restarts of the robot.

    When the odometry restarts, the robot is assumed to be at its last known pose.
    """

    def __init__(self, counts: Counts) -> None:
        """Start empty; ``counts`` is updated."""
        self._counts = counts
        self._log: list[tuple[float, np.ndarray]] = []
        self.frame = np.zeros(3)
        """Pose of the robot's present odometry frame in the map frame, f64[3]."""
        self._late: list[tuple[float, np.ndarray]] = []

    @property
    def newest(self) -> float | None:
        """Stamp of the newest pose, seconds of the robot's clock; None if there is none."""
        return self._log[-1][0] if self._log else None

    @property
    def pose(self) -> np.ndarray | None:
        """The newest pose, f64[3], map frame; None if there is none."""
        return self._log[-1][1].copy() if self._log else None

    def add(self, stamp: float, pose: np.ndarray) -> None:
        """Add odometry: seconds of the robot's clock, and f64[3], odometry frame."""
        if self.newest is not None and stamp < self.newest - _MAX_AGE:
            self._add_late(stamp, pose)
            return
        self._late.clear()
        index = self._index(stamp)
        if index < len(self._log) and self._log[index][0] == stamp:
            self._counts.doubled += 1
            return
        if self._log and index == len(self._log):
            # A jump beyond the robot's speed is a restart.
            last_stamp, last_pose = self._log[-1]
            seconds = stamp - last_stamp
            distance = np.hypot(*(compose(self.frame, pose) - last_pose)[:2])
            is_zero = seconds > _MIN_SILENCE and bool((np.abs(pose) < _ZERO_TOLERANCE).all())
            if distance > _MAX_SPEED * seconds + _MAX_JUMP or (is_zero and self._has_moved(pose)):
                self._restart(pose)
        self._log.insert(index, (stamp, compose(self.frame, pose)))
        del self._log[: self._index(self._log[-1][0] - _BUFFER_SECONDS)]

    def _index(self, stamp: float) -> int:
        """Find the index of the first pose not before a stamp."""
        return bisect.bisect_left(self._log, stamp, key=operator.itemgetter(0))

    def at(self, stamp: float) -> np.ndarray | None:
        """Interpolate the pose at a stamp, f64[3], of a non-empty buffer; None if none is near."""
        index = self._index(stamp)
        neighbors = self._log[max(index - 1, 0) : index + 1]
        (start, start_pose), (end, end_pose) = neighbors[0], neighbors[-1]
        if min(abs(start - stamp), abs(end - stamp)) > _MAX_GAP:
            return None
        frac = (stamp - start) / (end - start) if end > start else 0.0
        return pose_between(start_pose, end_pose, frac)

    def _add_late(self, stamp: float, pose: np.ndarray) -> None:
        """Collect odometry that is too late, until a restart of the clock is evident."""
        if self._late and stamp <= self._late[-1][0]:
            self._late.clear()
        self._late.append((stamp, pose))
        self._counts.late += 1
        if len(self._late) < _MAX_LATE:
            return
        entries, self._late = self._late, []
        self._counts.late -= len(entries)
        self._restart(entries[0][1])
        for entry in entries:
            self.add(*entry)

    def _has_moved(self, pose: np.ndarray) -> bool:
        """Tell whether a pose, odometry frame, differs from the robot's last pose."""
        offset = compose(self.frame, pose) - self._log[-1][1]
        return bool(np.hypot(*offset[:2]) > _MAX_JUMP or abs(wrap(float(offset[2]))) > _MAX_JUMP)

    def _restart(self, pose: np.ndarray) -> None:
        """Set the new odometry frame such that the robot is at its last pose."""
        if self._has_moved(pose):
            self.frame = compose(self._log[-1][1], inverse(pose))
        self._log.clear()
        self._counts.restarts += 1


class Inbox:
    """Odometry and detections received from one robot."""

    def __init__(self) -> None:
        """Start empty."""
        self.counts = Counts()
        self.track = OdometryBuffer(self.counts)
        self._newest: tuple[float, Sequence[Detection]] | None = None
        self._last_used = -np.inf
        self._last_time = -np.inf

    def add_odometry(self, stamp: float, pose: np.ndarray) -> None:
        """Take in odometry, see ``OdometryBuffer.add``."""
        restarts = self.counts.restarts
        self.track.add(stamp, pose)
        if self.counts.restarts > restarts:
            # Stamps before the restart do not compare with the new clock.
            self._newest, self._last_used = None, -np.inf

    def add_detections(self, stamp: float, detections: Sequence[Detection], now: float) -> None:
        """Add detections; only the newest are kept.

        ``stamp`` is by the robot's clock, the time of arrival ``now`` by the local clock.
        """
        self._last_time = now
        if stamp == self._last_used or (self._newest is not None and stamp == self._newest[0]):
            self.counts.doubled += 1
        elif stamp < self._last_used or (self._newest is not None and stamp < self._newest[0]):
            self.counts.late += 1
        else:
            self._newest = stamp, detections

    def silent_for(self, now: float) -> float:
        """Return seconds of the local clock since the last detections; infinite at first."""
        return now - self._last_time

    def take(self) -> list[Detection] | None:
        """Take the newest detections, moved to the robot's present pose; None without new ones."""
        latest, pose = self.track.newest, self.track.pose
        if self._newest is None or latest is None or pose is None:
            return None
        stamp, detections = self._newest
        if stamp < latest - _MAX_AGE:
            self.counts.late += 1
            self._newest = None
            return None
        pose_then = self.track.at(stamp)
        if pose_then is None:
            if stamp < latest:
                self.counts.unplaced += 1
                self._newest = None
            return None
        self._newest, self._last_used = None, stamp
        self.counts.used += 1
        return transformed(detections, pose_then, pose)
