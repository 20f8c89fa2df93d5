"""Truth, degree and rank of relations, on host and device."""

import math
from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxlangnav.messages import FAR
from jaxlangnav.relations.table import (
    NUM_RANKS,
    REGISTRY,
    SIDES,
    ReferenceFrame,
    robot_frame,
    to_frame,
    viewer_frame,
)

Values = TypeVar("Values", Array, np.ndarray)

HOLDS_MIN_COSINE = 0.7071
"""Directed relations hold within 45 degrees of their axis."""
_HOLDS_MAX_DISTANCE = 5.0  # metres; "far" begins where the others end
_BY_DISTANCE, _BY_SIDE = np.array([row.order or (-1.0, 0.0) for row in REGISTRY], np.float32).T
_COSINE, _SINE = (
    np.array([of(row.axis or 0.0) for row in REGISTRY], np.float32) for of in (math.cos, math.sin)
)
_IS_RING = np.array([row.axis is None for row in REGISTRY])  # "near", "far"


def degree(relation: ArrayLike, distance: Values, sideways: Values) -> Values:
    """Compute the degree to which a relation holds, for superlatives and ranks: larger is more.

    Arguments are f[...] metres from the landmark, and to the robot's left of it; NumPy or JAX.
    f[...], metres: "leftmost" is furthest to the left, "far" furthest, all others nearest.
    ``relation`` is an index or i32[...].
    """
    xp: Any = jnp if isinstance(relation, Array) else np
    by_distance, by_side = (xp.asarray(table)[relation] for table in (_BY_DISTANCE, _BY_SIDE))
    return by_distance * distance + by_side * sideways


def count_before(strength: np.ndarray, is_rival: np.ndarray) -> np.ndarray:
    """Count the rivals that rank before each figure, i[..., n] (host only): 0 for the first.

    Arguments are f[..., n] of ``degree``, and bool[..., n, n], the rivals of each figure.
    """
    return ((strength[..., None, :] > strength[..., :, None]) & is_rival).sum(-1)


def kth_smallest(rank: Array, values: Array, *, tie: float) -> Array:
    """Find the k-th smallest value over the first axis; ∞ if there are fewer, or k is too large.

    k is i32[...] from 1 to ``NUM_RANKS``; values, f32[n, ...], no farther apart than a tie count
    once, and ∞ not at all.
    """
    smallest = jnp.full(values.shape[1:], -jnp.inf)
    result = smallest
    for k in range(1, NUM_RANKS + 1):
        smallest = jnp.min(jnp.where(values > smallest[None] + tie, values, jnp.inf), axis=0)
        result = jnp.where(rank == k, smallest, result)
    return jnp.where(rank > NUM_RANKS, jnp.inf, result)


def is_on_side(relation: Array, offset_x: Array, offset_y: Array, robot: ReferenceFrame) -> Array:
    """Test whether objects are in the half-plane of a side of the robot, bool[...].

    Offsets are f32[...] from the robot, metres, map axes. Of relation indices, i32[...], all but
    front, behind, left, right hold everywhere.
    """
    backward, leftward = to_frame(robot, offset_x, offset_y)
    cosine, sine, is_ring = (jnp.asarray(table)[relation] for table in (_COSINE, _SINE, _IS_RING))
    return (backward * cosine + leftward * sine > 0) | is_ring


def holds_at(relation: ArrayLike, along: Array, lateral: Array, *, has_range: ArrayLike) -> Array:
    """Test whether a relation holds at an offset in its frame.

    Directed relations hold within 45 degrees of their axis and 5 m of the landmark, "near"
    within 5 m, "far" beyond. A side of the robot ("on your left") is a direction without a
    distance, in the density (``density.without_range``) as here: ``has_range``, bool[...].
    Indices, i32[...], are of relations with one landmark; offsets f[...], metres.
    """
    relation, distance = jnp.asarray(relation), jnp.sqrt(along * along + lateral * lateral)
    cosine, sine, is_ring = (jnp.asarray(table)[relation] for table in (_COSINE, _SINE, _IS_RING))
    is_toward = (along * cosine + lateral * sine >= HOLDS_MIN_COSINE * distance) | is_ring
    in_range = (distance <= _HOLDS_MAX_DISTANCE) != (relation == FAR)
    return is_toward & (in_range | ~jnp.asarray(has_range))


def holds(
    relation: int,
    figure: ArrayLike,
    landmark: ArrayLike,
    viewer: ArrayLike,
    heading: ArrayLike | None = None,
) -> Array:
    """Test whether a relation holds between positions: ``holds_at`` in its frame, bool[...].

    Args:
        relation: index into ``REGISTRY``, of a relation with one landmark.
        figure: f32[..., 2], metres, map frame.
        landmark: f32[..., 2], metres, map frame.
        viewer: f32[..., 2], where the speaker and robot stand at the utterance.
        heading: radians; given where the landmark is the robot itself.
    """
    figure, landmark, viewer = jnp.asarray(figure), jnp.asarray(landmark), jnp.asarray(viewer)
    if heading is None:
        frame = viewer_frame(viewer[..., 0], viewer[..., 1], landmark[..., 0], landmark[..., 1])
    else:
        frame = robot_frame(jnp.asarray(heading, jnp.float32))
    x, y = figure[..., 0] - landmark[..., 0], figure[..., 1] - landmark[..., 1]
    along, lateral = to_frame(frame, x, y)
    return holds_at(relation, along, lateral, has_range=heading is None or relation not in SIDES)
