"""What a robot is to the navigator: a pose, a look, waypoints, and a halt (section 4.3).

Frames: the *map* frame is where the robot started, as its odometry has it ever since; the *robot*
frame has x ahead and y to the left. Metres, radians, seconds.
"""

import dataclasses
import enum
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from jaxlangnav.messages import SensorParams


class Progress(enum.Enum):
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
        ...

    def go_to(
        self,
        waypoints: np.ndarray,
        *,
        speed: float,
        clearance: float,
        facing: float | None = None,
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
        ...

    def wait(self, seconds: float) -> Progress:
        """Let time pass: a real robot sleeps, a simulated one computes.

        Args:
            seconds: how long.

        Returns:
            How far it has come with the waypoints by then.
        """
        ...

    def stop(self) -> None:
        """Stand still as soon as the body can, and forget the waypoints."""
        ...
