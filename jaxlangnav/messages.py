"""Records passed between the subsystems.

Language passes ``Readings`` to the map; the world passes an ``Observation`` to the navigator;
grounding passes a ``Behavior`` to the planner; the navigator passes an ``Action`` to the robot.
The specification of the sensor and of the odometry (``SensorParams``, ``MotionParams``) is
here too, because a simulated world and the belief both use it and must never import each other.

Axis letters, for the whole package: **E** episodes, **P** particles, **N** object slots,
**M** mentions, **J** annotated relations, **K** readings, **H** phrases, **C** clauses,
**D** detections, **A** actions (graph nodes), **G** coverage cells a side, **T** time.
"""

import dataclasses
import enum
import logging
from collections.abc import Iterable, Sequence
from typing import Any, Self

import chex
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.inputs import observations
from jaxlangnav.inputs.sanitize import quote
from jaxlangnav.pytree import field, pytree

RELATIONS = ("front", "behind", "left", "right", "near", "far")
"""The six relations of section 3.1; an index into this tuple is a relation index."""
FRONT, BEHIND, LEFT, RIGHT, NEAR, FAR = range(6)
AT = 6
"""Region "at an object", the seventh region of the behavior symbols."""
REGIONS = (*RELATIONS, "at")
BETWEEN = 7
"""The relation with two landmarks ("between the cone and the car"): one edge for each of them."""
ACTIONS = ("navigate", "find")
MODES = ("normal", "quickly", "carefully")
NONE = -1
"""Sentinel: no relation, no mention, no slot."""
ROBOT = -2
"""Sentinel type of the robot itself, where it is the landmark ("on your left")."""
MAX_PLAUSIBLE_RANGE = 1000.0
"""Sensing range, metres, above which a warning is logged: probably millimetres."""
_log = logging.getLogger(__name__)


class Fault(enum.IntFlag):
    """Reasons why an observation is discarded and the robot stands still; bits of ``info.fault``.

    A flag is cleared by the next valid observation, ``PLACE`` only by a new start.
    """

    PLACE = 1  # the operating area or the initial pose is invalid
    POSE = 2  # the pose is not finite, or far outside the operating area
    JUMP = 4  # the pose is farther from the last one than the robot can have moved
    SENSOR = 8  # the sensor specification is invalid
    DETECTION = 16  # a detection is out of range, out of view, or of an unknown type
    CONTRADICTION = 32  # two detections have the same position
    WEIGHTS = 64  # all particle weights were zero, and have been reset to uniform
    COMMAND = 128  # there is no command


class Status(enum.IntEnum):
    """State or termination of the robot's task: ``Action.status``.

    ``Status(int(action.status)).word`` names it. The first two are in progress; ``ARRIVED``,
    ``NOT_FOUND``, ``WHICH_ONE`` and ``BLOCKED`` end the task: the robot stands still until it hears
    more.
    """

    SEARCHING = 0  # exploring for the goal, or for objects that disambiguate it
    APPROACHING = 1  # moving to an observed object that may be the goal
    ARRIVED = 2  # the command has been carried out
    NOT_FOUND = 3  # the area has been explored, and there is no goal
    HALTED = 4  # stopped by an utterance; the task is kept
    IDLE = 5  # there is no task
    WHICH_ONE = 6  # the command is ambiguous, and nothing is left to explore that would resolve it
    BLOCKED = 7  # the goal is unreachable, and other paths have been tried

    @property
    def word(self) -> str:
        """The lower-case name, as used in documents: "not_found"."""
        return self.name.lower()


@pytree
class Readings:
    """The k best readings of an instruction: its annotations of the unseen world (section 3.1).

    A reading has up to M mentions (objects) and up to J relations among them, ordered so that
    each relation shares a mention with an earlier one, or begins a new pair.
    Mentions of one type in one reading are the same object.
    """

    mention_type: Array  # i32[K, M] object type (``object_types``); ROBOT; NONE in empty slots
    figure: Array  # i32[K, J] mention index of the figure; NONE in empty slots
    relation: Array  # i32[K, J] in ``relations.REGISTRY``; NONE for an object without relation
    landmark: Array  # i32[K, J] mention index of the landmark; NONE where relation is NONE
    rank: Array  # i32[K, J] superlative rank among the figure's type: 1 first, 2 second; 0 none
    log_probability: Array  # f32[K] normalised; -inf in empty readings

    @property
    def is_ordinal(self) -> Array:
        """Whether relations rank objects: "second", "farthest", not "nearest to X", bool[K, J]."""
        landmark = jnp.take_along_axis(self.mention_type, self.landmark, axis=-1)
        return (self.rank > 1) | ((self.rank == 1) & ((landmark == ROBOT) | (self.relation == FAR)))

    def edges(self, reading: int = 0) -> np.ndarray:
        """List figure, relation, landmark and rank of a reading's relations, i32[J, 4] (host)."""
        columns = (self.figure, self.relation, self.landmark, self.rank)
        return np.stack([np.asarray(column[reading]) for column in columns], axis=1)


@pytree
class UtteranceContext:
    """Viewpoint of each relation of ``Readings``, and the objects excluded for each mention."""

    viewer: Array  # f32[K, J, 3] robot pose (x, y, heading) when the relation was heard; map frame
    excluded: Array  # i32[K, M] bit mask of observed slots excluded for a mention: bit s is slot s


@pytree
class BehaviorWorld:
    """One particle's objects as input of the behavior model (section 3.3).

    The last slot, index N, is the robot itself (type ``ROBOT``), so that "on your left" has a
    landmark. Relations are the edges of the particle's topology, or geometry on the host.
    """

    object_type: Array  # i32[N + 1] object type; ROBOT last
    is_object: Array  # bool[N + 1]
    is_related: Array  # bool[6, N + 1, N + 1] relation, figure slot, landmark slot
    is_superlative: Array  # bool[6, N + 1, N + 1] related, and the extreme one of the figure's type
    is_ordinal: Array  # bool[6, N + 1, N + 1] related, at the sentence's rank (second, third, ...)
    is_previous: Array  # bool[N + 1] the goal of the previous command ("the other cone")


@pytree
class Behavior:
    """Behavior distribution at the root of the parse tree, for one world (section 3.3)."""

    action: Array  # f32[2] probability of navigate, find
    mode: Array  # f32[3] probability of normal, quickly, carefully
    goal: Array  # f32[7, N + 1] probability of each goal region; sums to 1 - p(no goal here)
    constraint: Array  # f32[7, N + 1] probability that each region is to be avoided


@pytree
class SensorParams:
    """Specification of the object detector; traced, so a sweep never recompiles."""

    range_max: Array = field("metres")  # f32[]
    field_of_view: Array = field(  # f32[]
        "radians, full opening angle, centred on the heading; 2π: all round"
    )
    detection_probability: Array = field("in [0, 1]")  # f32[]
    noise: Array = field("metres, standard deviation of a relative position, each axis")  # f32[]
    false_detections: Array = field(  # f32[]
        "false detections expected in one look, of each type, anywhere in view", default=0.0
    )
    mislabelled: Array = field(  # f32[]
        "in [0, 1), probability that a detection names another type than the thing's, any of them",
        default=0.0,
    )


@pytree
class MotionParams:
    """Specification of motion and odometry; traced."""

    step_length: Array = field(  # f32[]
        "metres travelled in one decision cycle at normal speed", default=1.0
    )
    odometry_noise: Array = field(  # f32[]
        "standard deviation per axis as a share of the way (0.02: 2 %)", default=0.02
    )
    heading_bias: Array = field(  # f32[]
        "radians a metre by which the heading drifts steadily; the belief knows all but its sign",
        default=0.0,
    )
    heading_noise: Array = field(  # f32[]
        "radians per √metre, standard deviation of the heading's drift", default=0.0
    )
    turn_noise: Array = field(  # f32[]
        "radians per √radian, standard deviation of the heading's drift as the robot turns",
        default=0.0,
    )


DRIFTS = ("heading_bias", "heading_noise", "turn_noise")
"""Fields of ``MotionParams`` for heading drift; all 0 with a compass."""


def is_drifting(motion: MotionParams) -> bool:
    """Test whether the motion model has heading drift, as without a compass (host only)."""
    return any(float(jnp.max(getattr(motion, name))) > 0.0 for name in DRIFTS)


@pytree
class Observation:
    """Sensor data of one decision cycle."""

    pose: Array  # f32[3] x, y, heading by dead reckoning since the start; map frame, m, rad
    detection_type: Array  # i32[D] object type: index into the detector's labels
    detection_range: Array  # f32[D] metres
    detection_bearing: Array  # f32[D] radians, robot frame, counter-clockwise from the heading
    is_detection: Array  # bool[D]
    sensor: SensorParams  # the current specification (range, field of view)
    detection_attribute: Array | None = None  # i32[D] codes of ``attributes``; 0 unknown

    @classmethod
    def of(
        cls,
        pose: Sequence[Any],
        detections: Iterable[Sequence[Any]] = (),
        sensor: "SensorParams | None" = None,
        *,
        types: Sequence[str] = observations.TYPES,
    ) -> Self:
        """Build a padded, cast and validated observation (host only).

        However many are detected, up to eight take the same compiled program; up to 16, 32 and
        64 take one each.

        Args:
            pose: x, y, heading, metres and radians, map frame.
            detections: (type, range, bearing) each: a type by name or index, metres, radians in
                the robot's frame, counter-clockwise from the heading. A fourth entry says how it
                looks, by groups of ``ATTRIBUTES``: ``{"colour": "red"}``; what is left out
                is not known.
            sensor: specification of the detector; ``default_sensor()`` if None.
            types: what a type index is an index into: ``navigator.type_names`` where the navigator
                knows other types than the shipped ones.

        Returns:
            The observation, leaves on the host.

        Raises:
            ValueError: what cannot be, such as an unknown type, degrees for radians or a range
                beyond the sensor's: one line that names the value, the limit and the remedy.
        """
        params = default_sensor() if sensor is None else sensor
        if not isinstance(params, SensorParams):
            raise ValueError(
                f"sensor is {quote(params)}, but must be SensorParams, "
                "as of default_sensor(range_max)"
            )
        numbers = check_sensor(params)
        arrays: dict[str, Any] = observations.detection_arrays(detections, numbers, types)
        arrays["pose"] = observations.validate_pose(pose)
        # NumPy's numbers pass for JAX's: nothing is sent to a device before it is used.
        return cls(sensor=_sensor(numbers), **arrays)


def assert_observation(observation: Observation) -> None:
    """Check shapes and types of an observation at trace time.

    Raises:
        AssertionError: names what is of another shape or type.
    """
    chex.assert_shape(observation.pose, (3,))
    metres, bearing = observation.detection_range, observation.detection_bearing
    chex.assert_rank(metres, 1)
    chex.assert_equal_shape([metres, bearing, observation.detection_type, observation.is_detection])
    chex.assert_type([observation.pose, metres, bearing], float)
    chex.assert_type([observation.detection_type, observation.is_detection], [int, bool])
    chex.assert_rank([observation.sensor.range_max, observation.sensor.field_of_view], 0)


@pytree
class Action:
    """Output of the navigator for the robot."""

    waypoint: Array  # f32[2] map frame, metres: final destination
    step: Array  # f32[2] axes of odometry (the map's, with a compass), metres: displacement for
    # this decision cycle
    is_stop: Array  # bool[] the task has ended, successfully or not
    status: Array  # i32[] a Status: state or termination of the task
    speed: Array  # f32[] factor on the normal speed, from the behavior's mode
    clearance: Array  # f32[] metres to keep from objects, from the behavior's mode


def _sensor(numbers: Sequence[np.float32]) -> SensorParams:
    """Build the record from values in the order of its fields."""
    names = [item.name for item in dataclasses.fields(SensorParams)]
    return SensorParams(**dict(zip(names, map(jnp.asarray, numbers), strict=True)))


def check_sensor(sensor: SensorParams) -> tuple[np.float32, ...]:
    """Validate a sensor specification (host only).

    Args:
        sensor: of one robot.

    Returns:
        Its numbers, in the order of the fields.

    Raises:
        ValueError: names the value, the limits and the remedy.
    """
    return observations.validate_sensor(*vars(sensor).values())


def default_sensor(
    range_max: float = 3.0,
    *,
    field_of_view: float = 2.0 * np.pi,
    detection_probability: float = 0.95,
    noise: float = 0.1,
    false_detections: float = 0.0,
    mislabelled: float = 0.0,
) -> SensorParams:
    """Build a sensor specification: by default 95 % detection, 0.1 m noise, 360°, no false labels.

    The specification matters: what is not seen where it would have been is evidence, and what is
    seen is as good as the detector is said to be.

    Args:
        range_max: sensing range, metres; beyond a kilometre a warning is logged, as for
            millimetres.
        field_of_view: full opening angle centred on the heading, radians.
        detection_probability: of a thing in view in one look, above 0 and at most 1.
        noise: metres, standard deviation of a relative position on each axis.
        false_detections: expected in one look, of each type, anywhere in view.
        mislabelled: share of detections that name another type than the thing's.

    Returns:
        The specification as f32 scalars.

    Raises:
        ValueError: degrees, percent, or what cannot be; one line.
    """
    numbers = observations.validate_sensor(
        range_max, field_of_view, detection_probability, noise, false_detections, mislabelled
    )
    if numbers[0] > MAX_PLAUSIBLE_RANGE:
        _log.warning(
            "range_max is %g m: one look shows all that is there in the operating area, and what "
            "it does not show counts as not there; give metres, if these are millimetres",
            float(numbers[0]),
        )
    return _sensor(numbers)


def default_motion() -> MotionParams:
    """Build the default odometry: 1 m a cycle, 2 % of the way."""
    return MotionParams()
