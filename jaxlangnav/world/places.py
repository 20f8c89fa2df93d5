"""Sampling of random worlds other than Table 2: many objects, any bearing, areas of any size.

Frame: the robot starts at the origin and faces +x, anywhere in a rectangular operating area. The
distribution, which is unknown to all policies:

- the goal is a hydrant 1.2-2.8 m behind (or in front of) its cone as seen from the start, rotated
  from the line of sight by N(0, 0.25²) rad; the cone is uniform in the part of the area that is
  within the bearings and at least 1.5 m from the start;
- further hydrants and cones, and objects of other types, are uniform in the area;
- goal and cone keep 0.9 m from all others, the others ``gap`` from each other;
- except for the goal and its cone, no hydrant satisfies the sentence's relation to any cone
  (within 5 m and 72°). So a true sentence has one referent, and a false one none.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE
from jaxlangnav.pytree import field, pytree, replace, strong_types
from jaxlangnav.world.state import CONE, HYDRANT, Errors, Scenario

PLACE_SLOTS = 64
"""O, object slots of a world."""
NUM_FIXED_CLUTTER = 4
"""G, limit of fixed positions of recurring false detections."""
NUM_TYPES = 8
"""T, types of the shipped lexicon; bystanders are of all but two of them."""
_NUM_CANDIDATES = 32
"""Candidate positions sampled in parallel for each object."""
GOAL_GAP = 0.9  # metres from goal and cone to other objects
PAIR_GAP = (1.2, 2.8)  # metres from the cone to the goal
TURN_SD = 0.25  # radians
BORDER_MARGIN = 0.5  # metres from the border, of all objects
PASSING_DISTANCE, PASSING_COSINE = 5.0, 0.3
_MIN_RANGE = 1.5


@pytree
class PlaceParams:
    """Parameters of a distribution of worlds; traced, so one program samples them all."""

    area: Array  # f32[4] x_min, x_max, y_min, y_max metres; the start, at the origin, is in it
    bearing: Array = field("radians: limit of the goal cone's bearing, either way", default=math.pi)
    side: Array = field("1: the goal is behind its cone, −1: in front of it", default=1.0)
    said: Array = field("no other pair has: 1 behind, −1 in front; 0 unconstrained", default=1.0)
    has_goal: Array = field("whether the goal exists", default=True)
    has_cone: Array = field("whether the goal's cone exists", default=True)
    num_pairs: Array = field("further hydrants, and as many further cones", default=0)
    num_bystanders: Array = field("objects of other types", default=0)
    gap: Array = field("metres between objects", default=GOAL_GAP)
    num_clutter: Array = field("fixed clutter, at most NUM_FIXED_CLUTTER", default=0)
    clutter_probability: Array = field("of fixed clutter in view, in one scan", default=0.0)
    is_clutter: Array  # bool[T] types of false detections


def draw_place(key: Array, dist: PlaceParams) -> Scenario:
    """Sample one world.

    Args:
        key: random key.
        dist: distribution; traced. With more than ``PLACE_SLOTS`` objects it is invalid.

    Returns:
        The world; ``is_valid`` is False where an object could not be placed. Without a goal
        ``goal_index`` is NONE, and ``goal`` where it would have been.
    """
    pair_key, type_key, position_key, clutter_key = jax.random.split(key, 4)
    goal, cone, is_met = _draw_pair(pair_key, dist)
    # Types by slot, goal and cone first, and which slots are used.
    slots, num_paired = jnp.arange(PLACE_SLOTS), 2 + 2 * dist.num_pairs
    pair_types = jnp.where(slots % 2 == 0, HYDRANT, CONE)
    other_types = jax.random.randint(type_key, (PLACE_SLOTS,), 2, NUM_TYPES)
    types = jnp.where(slots < num_paired, pair_types, other_types).astype(jnp.int32)
    count = num_paired + dist.num_bystanders
    is_present = ((slots != 0) | dist.has_goal) & ((slots != 1) | dist.has_cone)
    is_object = (slots < count) & is_present
    placed = jnp.pad(jnp.stack([goal, cone], axis=1), ((0, 0), (0, PLACE_SLOTS - 2)))
    candidates = _uniform_points(position_key, dist.area, (PLACE_SLOTS, _NUM_CANDIDATES))

    def insert(index: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        placed, is_met = carry
        is_set = is_object & (slots < index)
        is_valid = _are_valid(candidates[:, index], types[index], placed, types, is_set, dist)
        position = candidates[:, index, jnp.argmax(is_valid)]
        return placed.at[:, index].set(position), is_met & (jnp.any(is_valid) | ~is_object[index])

    placed, is_met = jax.lax.fori_loop(2, PLACE_SLOTS, insert, (placed, is_met))
    return Scenario(
        object_type=jnp.where(is_object, types, NONE),
        object_x=jnp.where(is_object, placed[0], 0.0),
        object_y=jnp.where(is_object, placed[1], 0.0),
        is_object=is_object,
        goal=goal,
        goal_index=jnp.where(dist.has_goal, 0, NONE).astype(jnp.int32),
        start=jnp.zeros(3, jnp.float32),
        area=dist.area,
        is_valid=is_met & (count <= PLACE_SLOTS),
        errors=_errors(clutter_key, dist),
    )


def is_related(figure: Array, cone: Array, side: Array) -> Array:
    """Tell which hydrants f32[2, ...] satisfy the relation to cones, seen from the start.

    ``side``, f32[]: 1 behind, −1 in front; 0: none does.
    """
    d = figure - cone
    distance = jnp.hypot(d[0], d[1])
    along = (d[0] * cone[0] + d[1] * cone[1]) / jnp.maximum(jnp.hypot(cone[0], cone[1]), 1e-6)
    is_near = distance < PASSING_DISTANCE
    return is_near & (side != 0.0) & (side * along > PASSING_COSINE * distance)


def _draw_pair(key: Array, dist: PlaceParams) -> tuple[Array, Array, Array]:
    """Sample positions of the goal and its cone, f32[2] each, and their validity, bool[]."""
    position_key, gap_key, turn_key = jax.random.split(key, 3)
    cone = _uniform_points(position_key, dist.area, (8 * _NUM_CANDIDATES,))
    uniform = jax.random.uniform(gap_key, cone.shape[1:])
    gap = PAIR_GAP[0] + (PAIR_GAP[1] - PAIR_GAP[0]) * uniform
    bearing = jnp.arctan2(cone[1], cone[0])
    direction = bearing + TURN_SD * jax.random.normal(turn_key, cone.shape[1:])
    goal = cone + dist.side * jnp.stack([gap * jnp.cos(direction), gap * jnp.sin(direction)])
    is_valid = (jnp.hypot(cone[0], cone[1]) > _MIN_RANGE) & (jnp.abs(bearing) <= dist.bearing)
    is_valid &= jnp.hypot(goal[0], goal[1]) > _MIN_RANGE
    low, high = _inner_corners(dist.area)
    is_valid &= jnp.all((goal >= low[:, None]) & (goal <= high[:, None]), axis=0)
    index = jnp.argmax(is_valid)
    return goal[:, index], cone[:, index], jnp.any(is_valid)


def _are_valid(
    point: Array, label: Array, placed: Array, labels: Array, is_placed: Array, dist: PlaceParams
) -> Array:
    """Tell at which positions f32[2, K] an object of a type is valid given f32[2, O] others."""

    def beside(other: Array, other_label: Array, gap: Array) -> Array:
        other = other[:, None]
        distance = jnp.hypot(point[0] - other[0], point[1] - other[1])
        as_hydrant = is_related(point, other, side) & (other_label == CONE) & (label == HYDRANT)
        as_cone = is_related(other, point, side) & (other_label == HYDRANT) & (label == CONE)
        return (distance >= gap) & ~as_hydrant & ~as_cone

    gaps, side = jnp.where(jnp.arange(labels.size) < 2, GOAL_GAP, dist.gap), dist.said
    is_free = jax.vmap(beside, in_axes=(1, 0, 0))(placed, labels, gaps)
    return jnp.all(is_free | ~is_placed[:, None], axis=0)


def _errors(key: Array, dist: PlaceParams) -> Errors:
    """Sample the fixed positions of recurring false detections of hydrants and cones."""
    position_key, type_key = jax.random.split(key)
    position = _uniform_points(position_key, dist.area, (NUM_FIXED_CLUTTER,))
    types = jax.random.randint(type_key, (NUM_FIXED_CLUTTER,), HYDRANT, CONE + 1)
    is_used = jnp.arange(NUM_FIXED_CLUTTER) < dist.num_clutter
    return Errors(
        is_type=jnp.ones(NUM_TYPES, bool),
        is_clutter=dist.is_clutter,
        clutter_type=jnp.where(is_used, types, NONE).astype(jnp.int32),
        clutter_x=position[0],
        clutter_y=position[1],
        clutter_probability=dist.clutter_probability,
    )


def _inner_corners(area: Array) -> tuple[Array, Array]:
    """Compute the corners of an area without its border: f32[4] to f32[2] each."""
    return area[0::2] + BORDER_MARGIN, area[1::2] - BORDER_MARGIN


def _uniform_points(key: Array, area: Array, shape: tuple[int, ...]) -> Array:
    """Sample positions uniformly from the area without its border, f32[2, *shape] metres."""
    lower, upper = (corner.reshape(2, *(1,) * len(shape)) for corner in _inner_corners(area))
    return lower + (upper - lower) * jax.random.uniform(key, (2, *shape))


def place_params(*, area: tuple[float, float, float, float], **fields: Any) -> PlaceParams:
    """Build a distribution of worlds.

    False detections are of hydrants and cones, the worst case for a sentence about them.

    Args:
        area: x_min, x_max, y_min, y_max, metres; the origin is in it.
        **fields: other fields of ``PlaceParams``.

    Raises:
        ValueError: more objects or more fixed clutter than there are slots.
    """
    is_clutter = jnp.isin(jnp.arange(NUM_TYPES), jnp.array([HYDRANT, CONE]))
    dist = PlaceParams(area=jnp.array(area, jnp.float32), is_clutter=is_clutter, **fields)
    count = 2 + 2 * int(dist.num_pairs) + int(dist.num_bystanders)
    if count > PLACE_SLOTS or int(dist.num_clutter) > NUM_FIXED_CLUTTER:
        raise ValueError(
            f"a place of {count} things and {dist.num_clutter} haunted places was asked for, but "
            f"must have at most {PLACE_SLOTS} and {NUM_FIXED_CLUTTER}: take fewer"
        )
    # So many objects would not fit with a metre between them.
    return strong_types(replace(dist, gap=0.5) if count > 30 else dist)
