"""What a robot is to the navigator, and what its drives are told in (section 4.3).

A robot has a pose, a look, waypoints and a halt; a drive has steps and an ending. Frames: the *map*
frame is where the robot started, as its odometry has it ever since; the *robot* frame has x ahead
and y to the left. Metres, radians, seconds.
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
    """How far a robot has come with its waypoints."""

    STANDING = "standing"
    """It has none."""
    UNDER_WAY = "under way"
    THERE = "there"
    """At the last of them, or as near to it as things allow, and facing it."""
    GAVE_UP = "gave up"
    """Its motion planner finds no way, or no longer comes any nearer."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Detection:
    """One thing that the detector has found in the present look."""

    object_type: int
    """Index into the navigator's ``type_names``."""
    range: float
    """Metres from the robot to the middle of the thing."""
    bearing: float
    """Radians, robot frame, counter-clockwise from straight ahead."""

    def offset(self, heading: float = 0.0) -> np.ndarray:
        """Place it to the robot, f64[2], metres, in the axes that a robot's heading is of."""
        angle = heading + self.bearing
        return np.array([self.range * math.cos(angle), self.range * math.sin(angle)])


@runtime_checkable
class Robot(Protocol):
    """A robot: simulated or real. It never tells where it truly is, as it does not know."""

    @property
    def sensor(self) -> SensorParams:
        """What the belief is told of the detector: its gates, its rate and its error."""
        ...

    @property
    def area(self) -> tuple[float, float, float, float]:
        """The operating area x_min, x_max, y_min, y_max, metres, map frame."""
        ...

    def pose(self) -> np.ndarray:
        """Tell x, y, heading by dead reckoning, f64[3], map frame: slip and drift are in it."""
        ...

    def detections(self) -> Sequence[Detection] | None:
        """Look: things found now; None where the camera delivers no picture."""

    def go_to(
        self, waypoints: np.ndarray, *, speed: float, clearance: float, facing: float | None = None
    ) -> None:
        """Make for waypoints one after the other; returns at once, ``wait`` lets it happen.

        Args:
            waypoints: f64[W, 2], map frame, metres. One that cannot be stood on, such as a thing,
                is gone up to as near as the body allows.
            speed: factor on the robot's normal speed.
            clearance: metres to keep between the body and things, but for what is gone up to.
            facing: heading at the end, radians, map frame; towards a waypoint that could not be
                reached, or any, if None.
        """

    def wait(self, seconds: float) -> WaypointStatus:
        """Let seconds pass, and tell how far it has come with the waypoints by then."""
        ...

    def stop(self) -> None:
        """Stand still as soon as the body can, and forget the waypoints."""


class Ending(enum.Enum):
    """How a drive has ended."""

    ARRIVED = "arrived"
    NOT_FOUND = "not_found"
    IDLE = "idle"
    """It was told to drop the task."""
    BLOCKED = "blocked"
    """It cannot get where it would have to go."""
    WHICH_ONE = "which_one"
    """Several things may be meant, and nothing is left to see that would tell."""
    BLIND = "blind"
    """Its camera delivers no pictures."""
    LOST = "lost"
    """What it reports of itself cannot be."""
    HALTED = "halted"
    """It was told to halt, and its time ran out before it was told to go on."""
    OUT_OF_TIME = "out_of_time"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Step:
    """One decision, as the robot knows of it."""

    seconds: float
    pose: tuple[float, float, float]
    """By dead reckoning, metres and radians."""
    detections: tuple[Detection, ...] | None
    status: Status
    fault: Fault
    target: tuple[float, float] | None
    """Where it was sent, in the frame of ``pose``, metres; None: it was told to stand."""
    progress: WaypointStatus


@dataclasses.dataclass(frozen=True, kw_only=True)
class NavigationRun:
    """A drive that has ended."""

    ending: Ending
    why: str
    """In one line, for people."""
    steps: tuple[Step, ...]
    state: NavigatorState


OnStep = Callable[[Step, NavigatorState, NavigatorInfo | None], None]
"""Is told each decision; the info is None where there was no picture to decide by."""


def wrap_heading(pose: np.ndarray) -> tuple[float, float, float]:
    """Tell x, y, metres, and heading in [−π, π] of a pose f64[3] that may have turned often."""
    x, y, heading = pose.tolist()
    return x, y, math.remainder(heading, math.tau)


def observe(pose: np.ndarray, found: Sequence[Detection], sensor: SensorParams) -> Observation:
    """Build the navigator's observation from a robot's report.

    Args:
        pose: f64[3], x, y, heading by dead reckoning.
        found: what has been detected; of more than ``NUM_DETECTIONS`` the nearest are kept.
        sensor: the detector's specification.
    """
    kept = sorted(found, key=lambda one: one.range)[:NUM_DETECTIONS]
    empty = NUM_DETECTIONS - len(kept)
    return Observation(
        pose=jnp.asarray(pose, jnp.float32),
        detection_type=jnp.array([one.object_type for one in kept] + [NONE] * empty, jnp.int32),
        detection_range=jnp.array([one.range for one in kept] + [0.0] * empty, jnp.float32),
        detection_bearing=jnp.array([one.bearing for one in kept] + [0.0] * empty, jnp.float32),
        is_detection=jnp.arange(NUM_DETECTIONS) < len(kept),
        sensor=sensor,
    )
