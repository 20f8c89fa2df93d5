"""The ``Robot`` protocol, and the records of a drive (section 4.3).

A robot reports pose and detections, drives to a goal and stops; a drive has steps and an ending.
Frames: the *map* frame is that of the robot's odometry; the *robot* frame has x ahead and y to the
left. Metres, radians, seconds.
"""

import dataclasses
import enum
import math
from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np

from jaxlangnav.messages import NONE, Fault, Observation, SensorParams, Status
from jaxlangnav.navigator import NavigatorInfo, NavigatorState
from jaxlangnav.world.sensor import NUM_DETECTIONS


class WaypointStatus(enum.Enum):
    """Progress of a robot to its goal."""

    STANDING = "standing"
    """It has none."""
    UNDER_WAY = "under way"
    REACHED = "there"
    """At the goal, or as near as obstacles allow, and facing it."""
    FAILED = "gave up"
    """Its motion planner finds no path, or makes no progress."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Detection:
    """One detection of the present observation."""

    object_type: int
    """Index into the navigator's ``type_names``."""
    range: float
    """Metres from the robot to the center of the object."""
    bearing: float
    """Radians, robot frame, counter-clockwise from straight ahead."""

    def offset(self, heading: float = 0.0) -> np.ndarray:
        """Offset from the robot, f64[2], metres, in the frame in which ``heading`` is measured."""
        angle = heading + self.bearing
        return np.array([self.range * math.cos(angle), self.range * math.sin(angle)])


@runtime_checkable
class Robot(Protocol):
    """A robot, simulated or real; it reports odometry, never its ground-truth pose."""

    @property
    def sensor(self) -> SensorParams:
        """Sensor model that the belief assumes: gates, detection probability and noise."""
        ...

    @property
    def area(self) -> tuple[float, float, float, float]:
        """The operating area x_min, x_max, y_min, y_max, metres, map frame."""
        ...

    def pose(self) -> np.ndarray:
        """Return x, y, heading by dead reckoning, f64[3], map frame, with slip and drift."""
        ...

    def detections(self) -> Sequence[Detection] | None:
        """Return the present detections; None where the camera delivers no picture."""

    def go_to(
        self, goal: np.ndarray, *, speed: float, clearance: float, facing: float | None = None
    ) -> None:
        """Set the goal to drive to; returns at once, motion happens during ``wait``.

        Args:
            goal: f64[2], map frame, metres. An occupied one, such as an object, is approached as
                near as the body allows.
            speed: factor on the robot's normal speed.
            clearance: metres to keep between body and obstacles, except an occupied goal.
            facing: heading at the end, radians, map frame; None: any, or towards a goal that
                could not be reached.
        """

    def wait(self, seconds: float) -> WaypointStatus:
        """Drive for some seconds, and return the progress to the goal."""
        ...

    def stop(self) -> None:
        """Brake to a stop, and drop the goal."""


class Ending(enum.Enum):
    """How a drive has ended."""

    ARRIVED = "arrived"
    NOT_FOUND = "not_found"
    IDLE = "idle"
    """The task was cancelled by an utterance."""
    BLOCKED = "blocked"
    """No path leads to any waypoint that it would need."""
    WHICH_ONE = "which_one"
    """Several objects may be meant, and no further observation would tell them apart."""
    BLIND = "blind"
    """The camera delivers no pictures."""
    LOST = "lost"
    """Its observations are persistently invalid."""
    HALTED = "halted"
    """It was halted by an utterance, and time ran out before it was resumed."""
    OUT_OF_TIME = "out_of_time"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Step:
    """Record of one decision, without ground truth."""

    seconds: float
    pose: tuple[float, float, float]
    """By dead reckoning, metres and radians."""
    detections: tuple[Detection, ...] | None
    status: Status
    fault: Fault
    target: tuple[float, float] | None
    """Waypoint, in the frame of ``pose``, metres; None: the robot was to stand."""
    progress: WaypointStatus


@dataclasses.dataclass(frozen=True, kw_only=True)
class NavigationRun:
    """Result of a drive."""

    ending: Ending
    why: str
    """Reason for the ending, in one line."""
    steps: tuple[Step, ...]
    state: NavigatorState


OnStep = Callable[[Step, NavigatorState, NavigatorInfo | None], None]
"""Callback after each decision; the info is None where there was no picture."""


def wrap_heading(pose: np.ndarray) -> tuple[float, float, float]:
    """Convert a pose f64[3] to x, y, metres, and heading wrapped to [−π, π]."""
    x, y, heading = pose.tolist()
    return x, y, math.remainder(heading, math.tau)


def observe(pose: np.ndarray, detections: Sequence[Detection], sensor: SensorParams) -> Observation:
    """Build the navigator's observation from a robot's report.

    Args:
        pose: f64[3], x, y, heading by dead reckoning.
        detections: of more than ``NUM_DETECTIONS`` the nearest are kept.
        sensor: the detector's specification.
    """
    nearest = sorted(detections, key=lambda d: d.range)[:NUM_DETECTIONS]
    pad = NUM_DETECTIONS - len(nearest)
    return Observation(
        pose=jnp.asarray(pose, jnp.float32),
        detection_type=jnp.array([d.object_type for d in nearest] + [NONE] * pad, jnp.int32),
        detection_range=jnp.array([d.range for d in nearest] + [0.0] * pad, jnp.float32),
        detection_bearing=jnp.array([d.bearing for d in nearest] + [0.0] * pad, jnp.float32),
        is_detection=jnp.arange(NUM_DETECTIONS) < len(nearest),
        sensor=sensor,
    )
