"""What a drive is told in: its endings, its steps, and a robot's report as an observation."""

import dataclasses
import enum
import math
from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np

from jaxlangnav.messages import NONE, Fault, Observation, SensorParams, Status
from jaxlangnav.navigator import NavigatorInfo, NavigatorState
from jaxlangnav.robots.robot import Detection, Progress
from jaxlangnav.world.sensor import NUM_DETECTIONS


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
    progress: Progress


@dataclasses.dataclass(frozen=True, kw_only=True)
class Drive:
    """A drive that has ended."""

    ending: Ending
    why: str
    """In one line, for people."""
    steps: tuple[Step, ...]
    state: NavigatorState


OnStep = Callable[[Step, NavigatorState, NavigatorInfo | None], None]
"""Is told each decision; the info is None where there was no picture to decide by."""


def start_pose(pose: np.ndarray) -> tuple[float, float, float]:
    """Tell where a robot starts: its heading within a turn, as a navigator takes it.

    Args:
        pose: f64[3], x, y, heading by dead reckoning, which may have turned round often.

    Returns:
        x, y, metres, and the heading in [−π, π].
    """
    x, y, heading = pose.tolist()
    return x, y, math.remainder(heading, math.tau)


def observe(
    pose: np.ndarray, found: Sequence[Detection], sensor: SensorParams, size: int = NUM_DETECTIONS
) -> Observation:
    """Build the navigator's observation from a robot's report.

    Args:
        pose: f64[3], x, y, heading by dead reckoning.
        found: what has been detected; of more than ``size`` the nearest are kept.
        sensor: the detector's specification.
        size: D, slots of the observation.

    Returns:
        The observation.
    """
    kept = sorted(found, key=lambda one: one.range)[:size]
    empty = size - len(kept)
    return Observation(
        pose=jnp.asarray(pose, jnp.float32),
        detection_type=jnp.array([one.object_type for one in kept] + [NONE] * empty, jnp.int32),
        detection_range=jnp.array([one.range for one in kept] + [0.0] * empty, jnp.float32),
        detection_bearing=jnp.array([one.bearing for one in kept] + [0.0] * empty, jnp.float32),
        is_detection=jnp.arange(size) < len(kept),
        sensor=sensor,
    )
