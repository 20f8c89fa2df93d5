"""Whether a relation holds, and how strongly, between things whose places are known."""

import math

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from jaxlangnav.messages import FAR, LEFT, NEAR, RIGHT
from jaxlangnav.relations.frames import Frame, robot_frame, viewer_frame
from jaxlangnav.relations.table import AXIS, SIDES

_HOLDS_MIN_COSINE = 0.7071  # within 45 degrees of the axis
_HOLDS_MAX_DISTANCE = 5.0  # metres; "far" begins where the others end


def degree(relation: Array, distance: Array, sideways: Array) -> Array:
    """Measure how much relations hold, to find the extreme, the second, ...: larger is more so.

    Args:
        relation: i32[...], relation index.
        distance: f32[...], metres from the landmark.
        sideways: f32[...], metres to the robot's left of the landmark.

    Returns:
        f32[...], metres: "leftmost" is furthest to the left, "far" furthest, all others nearest.
    """
    held = jnp.where(relation == FAR, distance, -distance)
    held = jnp.where(relation == LEFT, sideways, held)
    return jnp.where(relation == RIGHT, -sideways, held)


def is_on_side(relation: Array, offset_x: Array, offset_y: Array, robot: Frame) -> Array:
    """Tell on which side of the robot something is, to compare things there: half-planes.

    Args:
        relation: i32[...], relation index; all but front, behind, left, right hold everywhere.
        offset_x: f32[...] from the robot, metres, map axes.
        offset_y: f32[...]
        robot: the robot's own frame.

    Returns:
        bool[...]
    """
    backward = offset_x * robot.along_x + offset_y * robot.along_y
    leftward = offset_x * robot.lateral_x + offset_y * robot.lateral_y
    holds = jnp.ones(jnp.broadcast_shapes(relation.shape, offset_x.shape), bool)
    for side in SIDES:
        inward = backward * math.cos(AXIS[side]) + leftward * math.sin(AXIS[side])
        holds = jnp.where(relation == side, inward > 0, holds)
    return holds


def holds(
    relation: int,
    figure: ArrayLike,
    landmark: ArrayLike,
    viewer: ArrayLike,
    heading: float | None = None,
) -> Array:
    """Decide whether a relation holds between known positions, as people would say it.

    Directed relations hold within 45 degrees of their axis and 5 m of the landmark, "near"
    within 5 m, "far" beyond. Used for worlds whose truth is known (labels, the known-map
    baseline), never by the filter.

    Args:
        relation: relation index in [0, 6).
        figure: f32[..., 2], metres, map frame.
        landmark: f32[..., 2], metres, map frame.
        viewer: f32[..., 2], where the speaker and robot stand at the utterance.
        heading: radians; given where the landmark is the robot itself.

    Returns:
        bool[...].
    """
    figure, landmark, viewer = jnp.asarray(figure), jnp.asarray(landmark), jnp.asarray(viewer)
    if heading is None:
        frame = viewer_frame(viewer[..., 0], viewer[..., 1], landmark[..., 0], landmark[..., 1])
    else:
        frame = robot_frame(jnp.asarray(heading, jnp.float32))
    x, y = figure[..., 0] - landmark[..., 0], figure[..., 1] - landmark[..., 1]
    distance = jnp.sqrt(x * x + y * y)
    if relation == NEAR:
        return distance <= _HOLDS_MAX_DISTANCE
    if relation == FAR:
        return distance > _HOLDS_MAX_DISTANCE
    along = x * frame.along_x + y * frame.along_y
    lateral = x * frame.lateral_x + y * frame.lateral_y
    projection = along * math.cos(AXIS[relation]) + lateral * math.sin(AXIS[relation])
    return (projection >= _HOLDS_MIN_COSINE * distance) & (distance <= _HOLDS_MAX_DISTANCE)
