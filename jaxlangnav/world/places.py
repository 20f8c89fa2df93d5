"""Sampling of random worlds unlike Table 2's: many objects, any bearing, areas of any size.

Frame: the robot starts at the origin and faces +x, anywhere in a rectangular operating area. The
distribution, which is unknown to all policies:

- the goal is a hydrant 1.2-2.8 m behind (or in front of) its cone as seen from the start, rotated
  from the line of sight by N(0, 0.25²) rad; the cone is uniform in the part of the area that is at
  least 1.5 m from the start;
- further hydrants and cones, and objects of other types, are uniform in the area;
- goal and cone keep 0.9 m from all others, the others ``gap`` from each other;
- except for the goal and its cone, no hydrant satisfies the sentence's relation to any cone
  (within 5 m and 72°). So a true sentence has one referent, and a false one none.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE
from jaxlangnav.pytree import field, pytree, replace, strong_types
from jaxlangnav.world.state import CONE, HYDRANT, NUM_TYPES, Errors, Scenario

WORLD_SLOTS = 64
"""O, object slots of a world."""
NUM_FIXED_CLUTTER = 4
"""G, limit of fixed positions of recurring false detections."""
_NUM_CANDIDATES = 32
"""Candidate positions sampled in parallel for each object."""
GOAL_GAP = 0.9  # metres from goal and cone to other objects
PAIR_GAP = (1.2, 2.8)  # metres from the cone to the goal
DIRECTION_SD = 0.25  # radians
BORDER_MARGIN = 0.5  # metres from the border, of all objects
MAX_RELATION_DISTANCE, MIN_RELATION_COSINE = 5.0, 0.3
_MIN_DISTANCE = 1.5  # metres from the start


@pytree
class WorldParams:
    """Parameters of a distribution of worlds; traced, so one program samples them all."""

    area: Array  # f32[4] x_min, x_max, y_min, y_max metres; the start, at the origin, is in it
    side: Array = field("1: the goal is behind its cone, −1: in front of it", default=1.0)
    stated_side: Array = field("of the sentence, ±1, which no other pair has; 0: any", default=1.0)
    has_goal: Array = field("whether the goal exists", default=True)
    has_cone: Array = field("whether the goal's cone exists", default=True)
    num_pairs: Array = field("further hydrants, and as many further cones", default=0)
    num_bystanders: Array = field("objects of all other types", default=0)
    gap: Array = field("metres between objects", default=GOAL_GAP)
    num_clutter: Array = field("fixed clutter, at most NUM_FIXED_CLUTTER", default=0)
    clutter_probability: Array = field("of fixed clutter in view, in one scan", default=0.0)


def draw_world(key: Array, spec: WorldParams) -> Scenario:
    """Sample one world.

    Args:
        key: random key.
        spec: distribution of worlds; traced. With more than ``WORLD_SLOTS`` objects it is invalid.

    Returns:
        The world; ``is_valid`` is False where an object could not be placed. Without a goal
        ``goal_index`` is NONE, and ``goal`` where it would have been.
    """
    pair_key, type_key, position_key, clutter_key = jax.random.split(key, 4)
    goal, cone, is_valid = _draw_pair(pair_key, spec)
    # Types by slot, goal and cone first, and which slots are used.
    slots, num_paired = jnp.arange(WORLD_SLOTS), 2 + 2 * spec.num_pairs
    pair_types = jnp.where(slots % 2 == 0, HYDRANT, CONE)
    other_types = jax.random.randint(type_key, (WORLD_SLOTS,), 2, NUM_TYPES)
    types = jnp.where(slots < num_paired, pair_types, other_types).astype(jnp.int32)
    count = num_paired + spec.num_bystanders
    is_present = ((slots != 0) | spec.has_goal) & ((slots != 1) | spec.has_cone)
    is_object = (slots < count) & is_present
    placed = jnp.pad(jnp.stack([goal, cone], axis=1), ((0, 0), (0, WORLD_SLOTS - 2)))
    candidates = _uniform_points(position_key, spec.area, (WORLD_SLOTS, _NUM_CANDIDATES))

    def insert(index: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        placed, is_valid = carry
        is_placed = is_object & (slots < index)
        is_free = _are_free(candidates[:, index], types[index], placed, types, is_placed, spec)
        position = candidates[:, index, jnp.argmax(is_free)]
        return placed.at[:, index].set(position), is_valid & (jnp.any(is_free) | ~is_object[index])

    placed, is_valid = jax.lax.fori_loop(2, WORLD_SLOTS, insert, (placed, is_valid))
    return Scenario(
        object_type=jnp.where(is_object, types, NONE),
        object_x=jnp.where(is_object, placed[0], 0.0),
        object_y=jnp.where(is_object, placed[1], 0.0),
        is_object=is_object,
        goal=goal,
        goal_index=jnp.where(spec.has_goal, 0, NONE).astype(jnp.int32),
        start=jnp.zeros(3, jnp.float32),
        area=spec.area,
        is_valid=is_valid & (count <= WORLD_SLOTS),
        errors=_errors(clutter_key, spec),
    )


def is_related(figure: Array, cone: Array, side: Array) -> Array:
    """Test which hydrants f32[2, ...] satisfy the relation to cones, seen from the start.

    ``side``, f32[]: 1 behind, −1 in front; 0: none does.
    """
    d = figure - cone
    distance = jnp.hypot(d[0], d[1])
    along = (d[0] * cone[0] + d[1] * cone[1]) / jnp.maximum(jnp.hypot(cone[0], cone[1]), 1e-6)
    is_near = distance < MAX_RELATION_DISTANCE
    return is_near & (side != 0.0) & (side * along > MIN_RELATION_COSINE * distance)


def _draw_pair(key: Array, spec: WorldParams) -> tuple[Array, Array, Array]:
    """Sample positions of the goal and its cone, f32[2] each, and their validity, bool[]."""
    position_key, gap_key, turn_key = jax.random.split(key, 3)
    cone = _uniform_points(position_key, spec.area, (8 * _NUM_CANDIDATES,))
    uniform = jax.random.uniform(gap_key, cone.shape[1:])
    gap = PAIR_GAP[0] + (PAIR_GAP[1] - PAIR_GAP[0]) * uniform
    turn = DIRECTION_SD * jax.random.normal(turn_key, cone.shape[1:])
    direction = jnp.arctan2(cone[1], cone[0]) + turn
    goal = cone + spec.side * jnp.stack([gap * jnp.cos(direction), gap * jnp.sin(direction)])
    is_valid = jnp.hypot(cone[0], cone[1]) > _MIN_DISTANCE
    is_valid &= jnp.hypot(goal[0], goal[1]) > _MIN_DISTANCE
    low, high = _inner_corners(spec.area)
    is_valid &= jnp.all((goal >= low[:, None]) & (goal <= high[:, None]), axis=0)
    index = jnp.argmax(is_valid)
    return goal[:, index], cone[:, index], jnp.any(is_valid)


def _are_free(
    point: Array, type_id: Array, placed: Array, types: Array, is_placed: Array, spec: WorldParams
) -> Array:
    """Test at which positions f32[2, K] an object of a type is valid given f32[2, O] others."""
    point, other, other_type = point[:, None, :], placed[:, :, None], types[:, None]
    gap, side = jnp.where(jnp.arange(types.size) < 2, GOAL_GAP, spec.gap), spec.stated_side
    is_apart = jnp.hypot(point[0] - other[0], point[1] - other[1]) >= gap[:, None]
    as_hydrant = is_related(point, other, side) & (other_type == CONE) & (type_id == HYDRANT)
    as_cone = is_related(other, point, side) & (other_type == HYDRANT) & (type_id == CONE)
    return jnp.all((is_apart & ~as_hydrant & ~as_cone) | ~is_placed[:, None], axis=0)


def _errors(key: Array, spec: WorldParams) -> Errors:
    """Sample the fixed positions of recurring false detections of hydrants and cones."""
    position_key, type_key = jax.random.split(key)
    position = _uniform_points(position_key, spec.area, (NUM_FIXED_CLUTTER,))
    types = jax.random.randint(type_key, (NUM_FIXED_CLUTTER,), HYDRANT, CONE + 1)
    is_used = jnp.arange(NUM_FIXED_CLUTTER) < spec.num_clutter
    return Errors(
        clutter_type=jnp.where(is_used, types, NONE).astype(jnp.int32),
        clutter_x=position[0],
        clutter_y=position[1],
        clutter_probability=spec.clutter_probability,
    )


def _inner_corners(area: Array) -> tuple[Array, Array]:
    """Compute the corners of an area without its border: f32[4] to f32[2] each."""
    return area[0::2] + BORDER_MARGIN, area[1::2] - BORDER_MARGIN


def _uniform_points(key: Array, area: Array, shape: tuple[int, ...]) -> Array:
    """Sample positions uniformly from the area without its border, f32[2, *shape] metres."""
    lower, upper = (corner.reshape(2, *(1,) * len(shape)) for corner in _inner_corners(area))
    return lower + (upper - lower) * jax.random.uniform(key, (2, *shape))


def world_params(*, area: tuple[float, float, float, float], **fields: Any) -> WorldParams:
    """Build a distribution of worlds.

    False detections are of hydrants and cones, the worst case for a sentence about them.

    Args:
        area: x_min, x_max, y_min, y_max, metres; the origin is in it.
        **fields: other fields of ``WorldParams``; ``gap`` is 0.5 by default for over 30 objects.

    Raises:
        ValueError: more objects or more fixed clutter than there are slots.
    """
    spec = WorldParams(area=jnp.array(area, jnp.float32), **fields)
    count = 2 + 2 * int(spec.num_pairs) + int(spec.num_bystanders)
    if count > WORLD_SLOTS or int(spec.num_clutter) > NUM_FIXED_CLUTTER:
        raise ValueError(
            f"{count} objects and {spec.num_clutter} places of fixed clutter were asked for, but "
            f"at most {WORLD_SLOTS} and {NUM_FIXED_CLUTTER} fit: take fewer"
        )
    # So many objects would not fit with the default between them.
    is_crowded = count > 30 and "gap" not in fields
    return strong_types(replace(spec, gap=0.5) if is_crowded else spec)
