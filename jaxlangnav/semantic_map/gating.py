"""Gating: an observation that cannot be is left out (section 3.2; fail safe).

Every field is held against what it can be, as one impossible number would poison every particle.
Where one is out of its law the whole look is left out, as whoever reports it may err in the rest,
too: the filter takes the step of a robot that has stood still with its eyes shut.

A pose that is farther from the last one than the robot can have gone is doubted at first. Where the
next look stands by it, it is taken over, and all of the jump that motion does not explain becomes
doubt of where the robot is. Both looks are said to be at fault.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.inputs.limits import FARTHEST, MOST_FALSE, MOST_WRONG, RANGES, VIEWS
from jaxlangnav.inputs.object_types import ATTRIBUTE_BITS
from jaxlangnav.inputs.observations import DEVIATIONS, MIN_NOISE, TURNS
from jaxlangnav.messages import NONE, Fault, Observation, SensorParams, default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.terrain.view import beyond

AREA_SIDES = (0.1, 1e4)
"""Metres, shortest and longest side of an operating area."""
MOST_TURNED = 1e4
"""Radians of a heading, either way: float32 is a milliradian coarse there."""


def _is_between(value: Array, low: Array | float, high: Array | float) -> Array:
    """Tell where a value lies between two bounds; NaN lies nowhere."""
    return (value >= low) & (value <= high)


def is_area(area: Array) -> Array:
    """Tell whether an operating area f32[4] is one, bool[]."""
    low, high = area[::2], area[1::2]
    is_near = _is_between(area, -FARTHEST, FARTHEST)
    return jnp.all(is_near) & jnp.all(_is_between(high - low, *AREA_SIDES))


def is_pose(pose: Array, area: Array) -> Array:
    """Tell whether a pose f32[3] lies in an area or no farther from it than it is wide, bool[]."""
    low, high = area[::2], area[1::2]
    margin = jnp.sum(high - low)
    is_here = jnp.all(_is_between(pose[:2], low - margin, high + margin))
    return is_here & _is_between(pose[2], -MOST_TURNED, MOST_TURNED)


def check_place(pose: Sequence[float], area: Sequence[float]) -> None:
    """Refuse an operating area or a start pose that cannot be with a ValueError (host only)."""
    with np.errstate(over="ignore"):
        bounds, start = (jnp.asarray(np.array(one, float), jnp.float32) for one in (area, pose))
    # An area that was laid about a pose that cannot be is not to blame.
    is_posed = start.shape == (3,) and bool(jnp.all(jnp.isfinite(start)))
    if is_posed and (bounds.shape != (4,) or not is_area(bounds)):
        raise ValueError(
            f"area is {tuple(area)}, but must be (x_min, x_max, y_min, y_max) with x_min < x_max "
            f"and y_min < y_max, in metres, sides of {AREA_SIDES[0]:g} to {AREA_SIDES[1]:g} m, "
            f"all within {FARTHEST:g} m of the map's origin"
        )
    if not is_posed or not is_pose(start, bounds):
        raise ValueError(
            f"pose is {tuple(pose)}, but must be (x, y, heading), finite, in metres and radians, "
            f"in the area {tuple(area)} or near it: move the area to where the robot is"
        )


def sound_place(pose: Array, area: Array) -> tuple[Array, Array, Array]:
    """Put something harmless in place of a start pose f32[3] or an area f32[4] that cannot be.

    Pose and area, and bool[], whether both are as they were given.
    """
    has_area = is_area(area)
    area = jnp.where(has_area, area, jnp.array([-1.0, 1.0, -1.0, 1.0], jnp.float32))
    has_pose = is_pose(pose, area)
    middle = jnp.stack([area[0] + area[1], area[2] + area[3], jnp.zeros_like(area[0])]) / 2.0
    return jnp.where(has_pose, pose, middle), area, has_area & has_pose


class Look(NamedTuple):
    """An observation on its way through a step of the filter, and what is believed of it."""

    observation: Observation  # as it came; then what the particles are updated by
    farthest: Array | None = None  # f32[] metres the robot can have gone since; None: anywhere
    spoken: Array | None = None  # bool[T] types that the task speaks of; None: all
    fault: Array | int = 0  # i32[] bits of Fault; 0 for a sound look
    is_jump: Array | bool = False  # bool[] motion does not explain the pose, which is taken over
    others: Observation | None = None  # detections of types that the task does not speak of
    num_lost: Array | int = 0  # i32[] of those, how many found no room


def _is_sensor(sensor: SensorParams) -> Array:
    """Tell whether the detector's specification is one, bool[]."""
    return (
        _is_between(sensor.range_max, *RANGES)
        & _is_between(sensor.field_of_view, *VIEWS)
        & _is_between(sensor.detection_probability, 0.0, 1.0)
        # What errs by more than it sees far tells nothing.
        & _is_between(sensor.noise, 0.0, sensor.range_max)
        & _is_between(sensor.false_detections, 0.0, MOST_FALSE)
        & _is_between(sensor.mislabelled, 0.0, MOST_WRONG)
    )


def _is_detectable(observation: Observation, num_types: Array) -> Array:
    """Tell which detections the detector can have made, bool[D]."""
    sensor, metres = observation.sensor, observation.detection_range
    bearing = observation.detection_bearing
    slack = DEVIATIONS * sensor.noise + MIN_NOISE
    code = observation.detection_attribute
    return (
        _is_between(observation.detection_type, 0, num_types - 1)
        & (True if code is None else _is_between(code, 0, 2**ATTRIBUTE_BITS - 1))
        & _is_between(bearing, -TURNS, TURNS)
        & (metres >= 0.0)
        & (beyond(metres, bearing, sensor.range_max, sensor.field_of_view) <= slack)
    )


def _is_contradiction(observation: Observation, is_seen: Array) -> Array:
    """Tell whether two of the detections bool[D] are of one place, whatever they are of, bool[]."""
    x = observation.detection_range * jnp.cos(observation.detection_bearing)
    y = observation.detection_range * jnp.sin(observation.detection_bearing)
    squared = (x[:, None] - x[None]) ** 2 + (y[:, None] - y[None]) ** 2
    is_pair = is_seen[:, None] & is_seen[None] & ~np.eye(x.shape[0], dtype=bool)
    return jnp.any(is_pair & (squared < MIN_NOISE**2))


def _is_within(pose: Array, other: Array, metres: Array) -> Array:
    """Tell whether two poses f32[3] are no farther apart than so many metres, bool[]."""
    span = pose[:2] - other[:2]
    return jnp.sum(span * span) <= metres * metres


def gate(belief: ParticleBelief, look: Look) -> tuple[ParticleBelief, Look]:
    """Hold every field of an observation, which may be anything, against what it can be.

    What is believed, all finite: as it came, or from the last pose, eyes shut; and what is wrong.
    """
    observation, farthest = look.observation, look.farthest
    pose, last = observation.pose, belief.last_pose
    has_pose = is_pose(pose, belief.coverage.area)
    is_far = is_steady = jnp.asarray(False)
    if farthest is not None:
        is_far = has_pose & ~_is_within(pose, last, farthest)
        is_steady = _is_within(pose, belief.reported_pose, farthest)
    has_sensor, given = _is_sensor(observation.sensor), observation.is_detection
    # What a detector cannot detect is not known of one that cannot be.
    is_odd = given & has_sensor & ~_is_detectable(observation, belief.num_types)
    raised = {
        Fault.PLACE: ~belief.is_placed,
        Fault.POSE: ~has_pose,
        Fault.JUMP: is_far,
        Fault.SENSOR: ~has_sensor,
        Fault.DETECTION: jnp.any(is_odd),
        Fault.CONTRADICTION: _is_contradiction(observation, given & has_sensor & ~is_odd),
    }
    fault = sum((jnp.where(is_up, int(bit), 0) for bit, is_up in raised.items()), jnp.int32(0))
    is_sound = fault == 0
    is_jump = (fault == int(Fault.JUMP)) & is_steady
    is_seen = given & is_sound
    shut = replace(default_sensor(), detection_probability=jnp.float32(0.0))
    sensor = jax.tree.map(partial(jnp.where, is_sound), observation.sensor, shut)
    believed = replace(
        observation,
        pose=jnp.where(is_sound | is_jump, pose, last),
        detection_type=jnp.where(is_seen, observation.detection_type, NONE),
        detection_range=jnp.where(is_seen, observation.detection_range, 0.0),
        detection_bearing=jnp.where(is_seen, observation.detection_bearing, 0.0),
        is_detection=is_seen,
        sensor=sensor,
    )
    reported = jnp.where(has_pose, pose, belief.reported_pose)
    look = look._replace(observation=believed, fault=fault, is_jump=is_jump)
    return replace(belief, reported_pose=reported), look
