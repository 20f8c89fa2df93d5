"""What the subsystems say to each other.

Language tells the map its ``Readings``; the world tells the navigator an ``Observation``;
grounding tells the planner a ``Behavior``; the navigator tells the robot an ``Action``.
The specification of the sensor and of the odometry (``SensorParams``, ``MotionParams``) stands
here too, because a simulated world and the belief both read it and must never import each other.

Axis letters, for the whole package: **E** episodes, **P** particles, **N** object slots,
**M** mentions, **J** annotated relations, **K** readings, **H** phrases, **C** clauses,
**D** detections, **A** actions (graph nodes), **G** coverage cells a side, **T** time.
"""

import dataclasses
import enum

import jax.numpy as jnp
from jax import Array

from jaxlangnav.pytree import pytree

RELATIONS = ("front", "behind", "left", "right", "near", "far")
"""The six relations of section 3.1; an index into this tuple is a relation index."""
FRONT, BEHIND, LEFT, RIGHT, NEAR, FAR = range(6)
AT = 6
"""Region "at an object": the seventh region of the behavior symbols."""
REGIONS = (*RELATIONS, "at")
ACTIONS = ("navigate", "find")
MODES = ("normal", "quickly", "carefully")
NONE = -1
"""Sentinel: no relation, no mention, no slot."""
ROBOT = -2
"""Sentinel type of the robot itself, where it is the landmark ("on your left")."""


def _none() -> Array:
    return jnp.float32(0.0)


class Fault(enum.IntFlag):
    """Why a look is left out and the robot stands still; ``Fault(int(info.fault))`` names them.

    A flag stays up until a sound look comes; ``PLACE`` until the robot is started anew.
    """

    PLACE = 1  # the operating area, or the pose at the start, cannot be
    POSE = 2  # the pose is not finite, or far out of the operating area
    JUMP = 4  # the pose is farther from the last one than the robot can have gone
    SENSOR = 8  # the detector's specification cannot be
    DETECTION = 16  # a detection is out of range, out of view, or of no known type
    CONTRADICTION = 32  # two detections are of one place
    WEIGHTS = 64  # no particle had any weight left, and all have been made equal
    COMMAND = 128  # nothing has been asked for


class Status(enum.IntEnum):
    """What the robot is doing about its task, or how the task ended: ``Action.status``.

    ``Status(int(action.status)).word`` names it. The first two are under way; ``ARRIVED`` and
    ``NOT_FOUND`` are endings: the robot stands still until it hears another command.
    """

    SEARCHING = 0  # looking for the goal, or for what tells it from others
    APPROACHING = 1  # on its way to something seen that may be the goal
    ARRIVED = 2  # the command has been carried out
    NOT_FOUND = 3  # what can be looked at has been looked at, and there is no goal
    HALTED = 4  # it was told to halt; the task is kept
    IDLE = 5  # there is nothing to do

    @property
    def word(self) -> str:
        """The status in words as documents hold it: "not_found"."""
        return self.name.lower()


@pytree
class Readings:
    """The k best readings of an instruction: what it says of the unseen world (section 3.1).

    A reading names up to M things (mentions) and up to J relations among them, ordered so that
    each relation touches a mention that an earlier relation has touched, or a new pair.
    Things of one type in one reading are one thing.
    """

    mention_type: Array  # i32[K, M] object type index; ROBOT; NONE in empty slots
    figure: Array  # i32[K, J] mention index of what is placed; NONE in empty slots
    relation: Array  # i32[K, J] relation index; NONE where the thing merely exists
    landmark: Array  # i32[K, J] mention index it is placed against; NONE where relation is NONE
    is_superlative: Array  # bool[K, J] "nearest": of all of the figure's type, the extreme one
    rank: Array  # i32[K, J] 1 where the extreme one is meant, 2 the second, ...; 0 elsewhere
    log_probability: Array  # f32[K] normalised; -inf in empty readings


@pytree
class BehaviorWorld:
    """One particle's objects as the behavior model sees them (section 3.3).

    The last slot, index N, is the robot itself (type ``ROBOT``), so that "on your left" has a
    landmark. Relations are the edges of the particle's topology, or geometry on the host.
    """

    object_type: Array  # i32[N + 1] type index; ROBOT last
    is_object: Array  # bool[N + 1]
    is_related: Array  # bool[6, N + 1, N + 1] relation, figure slot, landmark slot
    is_superlative: Array  # bool[6, N + 1, N + 1] and no other of the figure's type more so
    is_later: Array  # bool[6, N + 1, N + 1] the second, third, ... that the sentence means
    is_previous: Array  # bool[N + 1] the goal of the previous command ("the other cone")


@pytree
class Behavior:
    """Distribution over behaviors at the root of the parse tree, one world (section 3.3)."""

    action: Array  # f32[2] probability of navigate, find
    mode: Array  # f32[3] probability of normal, quickly, carefully
    goal: Array  # f32[7, N + 1] probability of each goal region; sums to 1 - p(no goal here)
    constraint: Array  # f32[7, N + 1] probability that each region is to be kept out of


@pytree
class SensorParams:
    """Specification of the object detector; traced, so a sweep never recompiles."""

    range_max: Array  # f32[] metres
    field_of_view: Array  # f32[] radians, full opening angle, centred on the heading; 2π: all round
    detection_probability: Array  # f32[] in [0, 1]
    noise: Array  # f32[] metres, standard deviation of a relative position, each axis
    false_detections: Array = dataclasses.field(default_factory=_none)  # f32[] expected in one
    # look, of each type, anywhere in view
    mislabelled: Array = dataclasses.field(default_factory=_none)  # f32[] in [0, 1), probability
    # that a detection names another type than the thing's, any of them


@pytree
class MotionParams:
    """Specification of motion and odometry; traced."""

    step_length: Array  # f32[] metres travelled in one decision cycle at normal speed
    odometry_noise: Array  # f32[] standard deviation per axis as a share of the way (0.02: 2 %)


@pytree
class Observation:
    """What a robot senses in one decision cycle."""

    pose: Array  # f32[3] x, y, heading by dead reckoning since the start; map frame, m, rad
    detection_type: Array  # i32[D] object type index
    detection_range: Array  # f32[D] metres
    detection_bearing: Array  # f32[D] radians, robot frame, counter-clockwise from the heading
    is_detection: Array  # bool[D]
    sensor: SensorParams  # the specification in force (range, field of view)


@pytree
class Action:
    """What the navigator asks of the robot."""

    waypoint: Array  # f32[2] map frame, metres: where to go in the end
    step: Array  # f32[2] map axes, metres: displacement for this decision cycle
    is_stop: Array  # bool[] the task has ended: it is carried out, or cannot be
    status: Array  # i32[] a Status: what the robot is doing, or how the task has ended
    speed: Array  # f32[] factor on the normal speed, from the behavior's mode
    clearance: Array  # f32[] metres to keep from objects, from the behavior's mode


def default_sensor(range_max: float = 3.0) -> SensorParams:
    """Build the default detector: 95 % detection, 0.1 m noise, all round.

    Args:
        range_max: sensing range, metres.

    Returns:
        The specification as f32 scalars.
    """
    return SensorParams(
        range_max=jnp.float32(range_max),
        field_of_view=jnp.float32(2 * jnp.pi),
        detection_probability=jnp.float32(0.95),
        noise=jnp.float32(0.1),
    )


def default_motion() -> MotionParams:
    """Build the default odometry: 1 m a cycle, 2 % of the way."""
    return MotionParams(step_length=jnp.float32(1.0), odometry_noise=jnp.float32(0.02))
