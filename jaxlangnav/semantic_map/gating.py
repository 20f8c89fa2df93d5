"""Gating: rejection of observations with an impossible field (section 3.2; fail safe).

Every field is checked against its bounds, as one impossible number would corrupt every particle.
If one is out of bounds the whole observation is rejected, as the rest may be wrong, too: the
filter steps as if the robot had not moved and detected nothing.

A pose farther from the last one than the robot can have gone is rejected at first. If the next
observation repeats it, the pose alone is accepted, and the square of the whole jump is added to the
variance of the robot's position (``motion.predict``). Both observations are flagged as faulty.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.inputs.limits import FOV_SPAN, MAX_FALSE, MAX_METRES, MAX_WRONG, RANGES
from jaxlangnav.inputs.object_types import ATTRIBUTE_BITS
from jaxlangnav.inputs.observations import GATE_SIGMAS, MAX_ANGLE, MIN_NOISE
from jaxlangnav.messages import NONE, Fault, Observation, SensorParams, default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.terrain.view import out_of_view

AREA_SIDES = (0.1, 1e4)
"""Metres, minimum and maximum side of an operating area."""
MAX_HEADING = 1e4
"""Radians, bound of a heading, either sign: the resolution of float32 there is a milliradian."""


def _is_between(value: Array, low: Array | float, high: Array | float) -> Array:
    """Test whether values lie between two bounds, inclusive; NaN does not."""
    return (value >= low) & (value <= high)


def is_area(area: Array) -> Array:
    """Test whether an operating area f32[4] is valid, bool[]."""
    low, high = area[::2], area[1::2]
    is_in_range = _is_between(area, -MAX_METRES, MAX_METRES)
    return jnp.all(is_in_range) & jnp.all(_is_between(high - low, *AREA_SIDES))


def is_pose(pose: Array, area: Array) -> Array:
    """Test whether a pose f32[3] lies in an area or no farther from it than its size, bool[]."""
    low, high = area[::2], area[1::2]
    margin = jnp.sum(high - low)
    is_in_area = jnp.all(_is_between(pose[:2], low - margin, high + margin))
    return is_in_area & _is_between(pose[2], -MAX_HEADING, MAX_HEADING)


def check_start(pose: Sequence[float], area: Sequence[float]) -> None:
    """Raise a ValueError if an area of four or a start pose of three numbers is invalid (host)."""
    bounds = jnp.asarray(area, jnp.float32)
    if not is_area(bounds):
        raise ValueError(
            f"area is {tuple(area)}, but must be (x_min, x_max, y_min, y_max) with x_min < x_max "
            f"and y_min < y_max, in metres, sides of {AREA_SIDES[0]:g} to {AREA_SIDES[1]:g} m, "
            f"all within {MAX_METRES:g} m of the map's origin"
        )
    if not is_pose(jnp.asarray(pose, jnp.float32), bounds):
        raise ValueError(
            f"pose is {tuple(pose)}, but must be (x, y, heading), finite, in metres and radians, "
            f"in the area {tuple(area)} or near it: move the area to where the robot is"
        )


def valid_start(pose: Array, area: Array) -> tuple[Array, Array, Array]:
    """Replace an invalid start pose f32[3] or area f32[4] by a harmless default.

    Returns pose and area, and bool[], whether both were valid.
    """
    has_area = is_area(area)
    area = jnp.where(has_area, area, jnp.array([-1.0, 1.0, -1.0, 1.0], jnp.float32))
    has_pose = is_pose(pose, area)
    centre = jnp.stack([area[0] + area[1], area[2] + area[3], jnp.zeros_like(area[0])]) / 2.0
    return jnp.where(has_pose, pose, centre), area, has_area & has_pose


class GatedStep(NamedTuple):
    """An observation on its way through a filter step, with the results of gating."""

    observation: Observation  # as reported; after gating, what the particles are updated with
    max_travel: Array | None = None  # f32[] metres of motion since the last one; None: unbounded
    mentioned: Array | None = None  # bool[T] types that the task mentions; None: all
    fault: Array | int = 0  # i32[] bits of Fault; 0 for a valid observation
    is_jump: Array | bool = False  # bool[] motion does not explain the pose, which is accepted
    others: Observation | None = None  # detections of types that the task does not mention
    num_dropped: Array | int = 0  # i32[] number of those that did not fit into their list


def _is_sensor(sensor: SensorParams) -> Array:
    """Test whether the detector's specification is valid, bool[]."""
    return (
        _is_between(sensor.range_max, *RANGES)
        & _is_between(sensor.field_of_view, *FOV_SPAN)
        & _is_between(sensor.detection_probability, 0.0, 1.0)
        # Noise above the range would carry no information.
        & _is_between(sensor.noise, 0.0, sensor.range_max)
        & _is_between(sensor.false_detections, 0.0, MAX_FALSE)
        & _is_between(sensor.mislabelled, 0.0, MAX_WRONG)
    )


def _is_detectable(observation: Observation, num_types: Array) -> Array:
    """Test which detections are possible for this detector, bool[D]."""
    sensor, distance = observation.sensor, observation.detection_range
    bearing = observation.detection_bearing
    slack = GATE_SIGMAS * sensor.noise + MIN_NOISE
    code = observation.detection_attribute
    return (
        _is_between(observation.detection_type, 0, num_types - 1)
        & (True if code is None else _is_between(code, 0, 2**ATTRIBUTE_BITS - 1))
        & _is_between(bearing, -MAX_ANGLE, MAX_ANGLE)
        & (distance >= 0.0)
        & (out_of_view(distance, bearing, sensor.range_max, sensor.field_of_view) <= slack)
    )


def _is_coincident(observation: Observation, is_valid: Array) -> Array:
    """Test whether two of the detections bool[D] coincide, of whatever types, bool[]."""
    x = observation.detection_range * jnp.cos(observation.detection_bearing)
    y = observation.detection_range * jnp.sin(observation.detection_bearing)
    squared = (x[:, None] - x[None]) ** 2 + (y[:, None] - y[None]) ** 2
    is_pair = is_valid[:, None] & is_valid[None] & ~np.eye(x.shape[0], dtype=bool)
    return jnp.any(is_pair & (squared < MIN_NOISE**2))


def _is_within(pose: Array, other: Array, distance: Array) -> Array:
    """Test whether two poses f32[3] are at most a distance f32[] in metres apart, bool[]."""
    offset = pose[:2] - other[:2]
    return jnp.sum(offset * offset) <= distance * distance


def gate(belief: ParticleBelief, gated: GatedStep) -> tuple[ParticleBelief, GatedStep]:
    """Gate an observation: check every field, reject it if one is impossible, record the fault.

    The result is finite: as reported, or, if rejected, nothing detected from the last pose, or
    from the new one where that repeats a jump.
    """
    observation, max_travel = gated.observation, gated.max_travel
    pose, last = observation.pose, belief.last_pose
    has_pose = is_pose(pose, belief.coverage.area)
    is_jumped = is_repeated = jnp.asarray(False)
    if max_travel is not None:
        is_jumped = has_pose & ~_is_within(pose, last, max_travel)
        is_repeated = _is_within(pose, belief.reported_pose, max_travel)
    has_sensor, detected = _is_sensor(observation.sensor), observation.is_detection
    # Detections can be checked only against a valid specification.
    is_invalid = detected & has_sensor & ~_is_detectable(observation, belief.num_types)
    faults = {
        Fault.PLACE: ~belief.is_placed,
        Fault.POSE: ~has_pose,
        Fault.JUMP: is_jumped,
        Fault.SENSOR: ~has_sensor,
        Fault.DETECTION: jnp.any(is_invalid),
        Fault.CONTRADICTION: _is_coincident(observation, detected & has_sensor & ~is_invalid),
    }
    fault = sum((jnp.where(is_set, int(bit), 0) for bit, is_set in faults.items()), jnp.int32(0))
    is_valid = fault == 0
    is_jump = (fault == int(Fault.JUMP)) & is_repeated
    is_used = detected & is_valid
    blind = replace(default_sensor(), detection_probability=jnp.float32(0.0))
    accepted = replace(
        observation,
        pose=jnp.where(is_valid | is_jump, pose, last),
        detection_type=jnp.where(is_used, observation.detection_type, NONE),
        detection_range=jnp.where(is_used, observation.detection_range, 0.0),
        detection_bearing=jnp.where(is_used, observation.detection_bearing, 0.0),
        is_detection=is_used,
        sensor=jax.tree.map(partial(jnp.where, is_valid), observation.sensor, blind),
    )
    gated = gated._replace(observation=accepted, fault=fault, is_jump=is_jump)
    return replace(belief, reported_pose=jnp.where(has_pose, pose, belief.reported_pose)), gated
