"""Sampling of random worlds unlike Table 2: many objects, goals all round, areas of any size.

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

NUM_THINGS = 64
"""O, object slots of a world."""
NUM_HAUNTED = 4
"""G, limit of fixed positions of recurring false detections."""
NUM_TYPES = 8
"""T, types of the shipped lexicon; bystanders are of all but two of them."""
_NUM_CANDIDATES = 32
"""Candidate positions sampled in parallel for each object."""
OWN_GAP = 0.9  # metres from goal and cone to anything else
PAIR_GAP = (1.2, 2.8)  # metres from the cone to the goal
TURN_SD = 0.25  # radians
BORDER_MARGIN = 0.5  # metres from the border, of all things
PASSING_DISTANCE, PASSING_COSINE = 5.0, 0.3
_MIN_RANGE = 1.5


@pytree
class PlaceLaw:
    """Parameters of a distribution of worlds; traced, so one program samples them all."""

    area: Array  # f32[4] x_min, x_max, y_min, y_max metres; the start, at the origin, is in it
    bearing: Array = field(
        "radians: the goal's cone is within ± of straight ahead", default=math.pi
    )
    side: Array = field("1: the goal is behind its cone, −1: in front of it", default=1.0)
    said: Array = field("no other pair passes for: 1 behind, −1 in front; 0 any may", default=1.0)
    has_goal: Array = field("whether the goal is there", default=True)
    has_cone: Array = field("whether the goal's cone is there", default=True)
    num_pairs: Array = field("further hydrants, and as many further cones", default=0)
    num_bystanders: Array = field("things of other types", default=0)
    gap: Array = field("metres between things", default=OWN_GAP)
    num_haunted: Array = field("fixed places of false detections, at most NUM_HAUNTED", default=0)
    haunt_probability: Array = field(
        "of such a place in view to be reported in a look", default=0.0
    )
    is_invented: Array  # bool[T] types that false detections take


def draw_place(key: Array, law: PlaceLaw) -> Scenario:
    """Sample one world.

    Args:
        key: random key.
        law: the distribution; traced. With more than ``NUM_THINGS`` objects it is invalid.

    Returns:
        The world; ``is_valid`` is False where an object could not be placed. Without a goal
        ``goal_index`` is NONE, and ``goal`` where it would have been.
    """
    pair_key, type_key, position_key, clutter_key = jax.random.split(key, 4)
    goal, cone, is_met = _draw_pair(pair_key, law)
    # Types by slot, goal and cone first, and which slots are used.
    slots, num_paired = jnp.arange(NUM_THINGS), 2 + 2 * law.num_pairs
    pair_types = jnp.where(slots % 2 == 0, HYDRANT, CONE)
    other_types = jax.random.randint(type_key, (NUM_THINGS,), 2, NUM_TYPES)
    types = jnp.where(slots < num_paired, pair_types, other_types).astype(jnp.int32)
    count = num_paired + law.num_bystanders
    is_object = (slots < count) & ((slots != 0) | law.has_goal) & ((slots != 1) | law.has_cone)
    pair_positions = jnp.stack([goal, cone], axis=1)
    placed = jnp.pad(pair_positions, ((0, 0), (0, NUM_THINGS - 2)))
    tried = _uniform_points(position_key, law.area, (NUM_THINGS, _NUM_CANDIDATES))

    def insert(index: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        placed, is_met = carry
        is_set = is_object & (slots < index)
        is_valid = _are_valid(tried[:, index], types[index], placed, types, is_set, law)
        position = tried[:, index, jnp.argmax(is_valid)]
        return placed.at[:, index].set(position), is_met & (jnp.any(is_valid) | ~is_object[index])

    placed, is_met = jax.lax.fori_loop(2, NUM_THINGS, insert, (placed, is_met))
    return Scenario(
        object_type=jnp.where(is_object, types, NONE),
        object_x=jnp.where(is_object, placed[0], 0.0),
        object_y=jnp.where(is_object, placed[1], 0.0),
        is_object=is_object,
        goal=goal,
        goal_index=jnp.where(law.has_goal, 0, NONE).astype(jnp.int32),
        start=jnp.zeros(3, jnp.float32),
        area=law.area,
        is_valid=is_met & (count <= NUM_THINGS),
        errors=_errors(clutter_key, law),
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


def _draw_pair(key: Array, law: PlaceLaw) -> tuple[Array, Array, Array]:
    """Sample positions of the goal and its cone, f32[2] each, and their validity, bool[]."""
    place_key, gap_key, turn_key = jax.random.split(key, 3)
    cone = _uniform_points(place_key, law.area, (8 * _NUM_CANDIDATES,))
    uniform = jax.random.uniform(gap_key, cone.shape[1:])
    gap = PAIR_GAP[0] + (PAIR_GAP[1] - PAIR_GAP[0]) * uniform
    bearing = jnp.arctan2(cone[1], cone[0])
    direction = bearing + TURN_SD * jax.random.normal(turn_key, cone.shape[1:])
    goal = cone + law.side * jnp.stack([gap * jnp.cos(direction), gap * jnp.sin(direction)])
    is_valid = (jnp.hypot(cone[0], cone[1]) > _MIN_RANGE) & (jnp.abs(bearing) <= law.bearing)
    is_valid &= jnp.hypot(goal[0], goal[1]) > _MIN_RANGE
    low, high = _inner_corners(law.area)
    is_valid &= jnp.all((goal >= low[:, None]) & (goal <= high[:, None]), axis=0)
    i = jnp.argmax(is_valid)
    return goal[:, i], cone[:, i], jnp.any(is_valid)


def _are_valid(
    point: Array, label: Array, placed: Array, labels: Array, is_placed: Array, law: PlaceLaw
) -> Array:
    """Tell at which positions f32[2, K] an object of a type is valid given f32[2, O] others."""

    def beside(other: Array, other_label: Array, gap: Array) -> Array:
        other = other[:, None]
        distance = jnp.hypot(point[0] - other[0], point[1] - other[1])
        as_hydrant = is_related(point, other, law.said) & (other_label == CONE) & (label == HYDRANT)
        as_cone = is_related(other, point, law.said) & (other_label == HYDRANT) & (label == CONE)
        return (distance >= gap) & ~as_hydrant & ~as_cone

    gaps = jnp.where(jnp.arange(labels.size) < 2, OWN_GAP, law.gap)
    is_free = jax.vmap(beside, in_axes=(1, 0, 0))(placed, labels, gaps)
    return jnp.all(is_free | ~is_placed[:, None], axis=0)


def _errors(key: Array, law: PlaceLaw) -> Errors:
    """Sample the fixed positions of recurring false detections of hydrants and cones."""
    place_key, type_key = jax.random.split(key)
    place = _uniform_points(place_key, law.area, (NUM_HAUNTED,))
    clutter_type = jax.random.randint(type_key, (NUM_HAUNTED,), HYDRANT, CONE + 1)
    is_used = jnp.arange(NUM_HAUNTED) < law.num_haunted
    return Errors(
        is_type=jnp.ones(NUM_TYPES, bool),
        is_invented=law.is_invented,
        haunt_type=jnp.where(is_used, clutter_type, NONE).astype(jnp.int32),
        haunt_x=place[0],
        haunt_y=place[1],
        haunt_probability=law.haunt_probability,
    )


def _inner_corners(area: Array) -> tuple[Array, Array]:
    """Compute the corners of an area without its border: f32[4] to f32[2] each."""
    return area[0::2] + BORDER_MARGIN, area[1::2] - BORDER_MARGIN


def _uniform_points(key: Array, area: Array, shape: tuple[int, ...]) -> Array:
    """Sample positions uniformly from the area without its border, f32[2, *shape] metres."""
    lower, upper = (corner.reshape(2, *(1,) * len(shape)) for corner in _inner_corners(area))
    return lower + (upper - lower) * jax.random.uniform(key, (2, *shape))


def place_law(*, area: tuple[float, float, float, float], **fields: Any) -> PlaceLaw:
    """Build a distribution of worlds.

    False detections are of hydrants and cones, the worst case for a sentence about them.

    Args:
        area: x_min, x_max, y_min, y_max, metres; the origin is in it.
        **fields: other fields of ``PlaceLaw``.

    Raises:
        ValueError: more things than there are slots, or more haunted places.
    """
    is_invented = jnp.isin(jnp.arange(NUM_TYPES), jnp.array([HYDRANT, CONE]))
    law = PlaceLaw(area=jnp.array(area, jnp.float32), is_invented=is_invented, **fields)
    count = 2 + 2 * int(law.num_pairs) + int(law.num_bystanders)
    if count > NUM_THINGS or int(law.num_haunted) > NUM_HAUNTED:
        raise ValueError(
            f"a place of {count} things and {law.num_haunted} haunted places was asked for, but "
            f"must have at most {NUM_THINGS} and {NUM_HAUNTED}: take fewer"
        )
    # So many objects would not fit with a metre between them.
    return strong_types(replace(law, gap=0.5) if count > 30 else law)
