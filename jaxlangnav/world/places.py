"""Random places that are not those of Table 2: crowds, goals all round, areas of any size.

Frame: the robot starts at the origin and faces +x, anywhere in a rectangular operating area. The
law, of which nothing is told to any policy:

- the goal is a hydrant 1.2-2.8 m behind (or in front of) its cone as seen from the start, turned
  from the line of sight by N(0, 0.25²) rad; the cone stands evenly anywhere in the area that is
  within the bearings and at least 1.5 m from the start;
- further hydrants and cones, and bystanders of other types, stand evenly anywhere in the area;
- goal and cone keep 0.9 m from all others, the others ``gap`` from each other;
- but for the goal and its cone, no hydrant may pass for standing to any cone as the sentence says
  (within 5 m and 72°). So a true sentence means one hydrant, and a false one none.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE
from jaxlangnav.pytree import field, pytree, replace, strong
from jaxlangnav.world.state import CONE, HYDRANT, Errors, Scenario

NUM_THINGS = 64
"""O, object slots of a place."""
NUM_HAUNTED = 4
"""G, places at which a detector may be apt to see what is not there."""
NUM_TYPES = 8
"""T, types of the shipped lexicon, that a detector tells apart; bystanders are of all but two."""
_NUM_CANDIDATES = 32
"""Places tried at once for each thing."""
OWN_GAP = 0.9  # metres from goal and cone to anything else
PAIR_GAP = (1.2, 2.8)  # metres from the cone to the goal
TURN_SD = 0.25  # radians
BORDER_MARGIN = 0.5  # metres from the border, of all things
PASSING_DISTANCE, PASSING_COSINE = 5.0, 0.3
_NEAREST = 1.5


@pytree
class PlaceLaw:
    """What fixes a random place; traced, so one program draws them all."""

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
    """Draw one place.

    Args:
        key: random key.
        law: what to draw; traced. One of more than ``NUM_THINGS`` things makes it invalid.

    Returns:
        The place; ``is_valid`` is False where something found no room. Without a goal
        ``goal_index`` is NONE, and ``goal`` where it would have been.
    """
    pair_key, kind_key, thing_key, haunt_key = jax.random.split(key, 4)
    goal, cone, is_met = _draw_pair(pair_key, law)
    # Types by slot, goal and cone first, and which slots are used.
    slots, paired = jnp.arange(NUM_THINGS), 2 + 2 * law.num_pairs
    pair = jnp.where(slots % 2 == 0, HYDRANT, CONE)
    others = jax.random.randint(kind_key, (NUM_THINGS,), 2, NUM_TYPES)
    kind = jnp.where(slots < paired, pair, others).astype(jnp.int32)
    number = paired + law.num_bystanders
    is_object = (slots < number) & ((slots != 0) | law.has_goal) & ((slots != 1) | law.has_cone)
    first = jnp.stack([goal, cone], axis=1)
    placed = jnp.pad(first, ((0, 0), (0, NUM_THINGS - 2)))
    tried = _anywhere(thing_key, law.area, (NUM_THINGS, _NUM_CANDIDATES))

    def put(index: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        placed, is_met = carry
        before = is_object & (slots < index)
        is_fit = _fits(tried[:, index], kind[index], placed, kind, before, law)
        chosen = tried[:, index, jnp.argmax(is_fit)]
        return placed.at[:, index].set(chosen), is_met & (jnp.any(is_fit) | ~is_object[index])

    placed, is_met = jax.lax.fori_loop(2, NUM_THINGS, put, (placed, is_met))
    return Scenario(
        object_type=jnp.where(is_object, kind, NONE),
        object_x=jnp.where(is_object, placed[0], 0.0),
        object_y=jnp.where(is_object, placed[1], 0.0),
        is_object=is_object,
        goal=goal,
        goal_index=jnp.where(law.has_goal, 0, NONE).astype(jnp.int32),
        start=jnp.zeros(3, jnp.float32),
        area=law.area,
        is_valid=is_met & (number <= NUM_THINGS),
        errors=_errors(haunt_key, law),
    )


def passes_for(figure: Array, cone: Array, side: Array) -> Array:
    """Tell which hydrants f32[2, ...] may pass for standing to cones as said, seen from the start.

    ``side``, f32[]: 1 behind, −1 in front; 0: nothing passes.
    """
    span = figure - cone
    far = jnp.hypot(span[0], span[1])
    along = (span[0] * cone[0] + span[1] * cone[1]) / jnp.maximum(jnp.hypot(cone[0], cone[1]), 1e-6)
    is_near = far < PASSING_DISTANCE
    return is_near & (side != 0.0) & (side * along > PASSING_COSINE * far)


def _draw_pair(key: Array, law: PlaceLaw) -> tuple[Array, Array, Array]:
    """Place the goal and its cone: f32[2] each, and whether a place was found, bool[]."""
    place_key, gap_key, turn_key = jax.random.split(key, 3)
    cone = _anywhere(place_key, law.area, (8 * _NUM_CANDIDATES,))
    uniform = jax.random.uniform(gap_key, cone.shape[1:])
    gap = PAIR_GAP[0] + (PAIR_GAP[1] - PAIR_GAP[0]) * uniform
    bearing = jnp.arctan2(cone[1], cone[0])
    turn = bearing + TURN_SD * jax.random.normal(turn_key, cone.shape[1:])
    goal = cone + law.side * jnp.stack([gap * jnp.cos(turn), gap * jnp.sin(turn)])
    is_fit = (jnp.hypot(cone[0], cone[1]) > _NEAREST) & (jnp.abs(bearing) <= law.bearing)
    is_fit &= jnp.hypot(goal[0], goal[1]) > _NEAREST
    low, high = _within(law.area)
    is_fit &= jnp.all((goal >= low[:, None]) & (goal <= high[:, None]), axis=0)
    at = jnp.argmax(is_fit)
    return goal[:, at], cone[:, at], jnp.any(is_fit)


def _fits(
    place: Array, kind: Array, placed: Array, kinds: Array, is_placed: Array, law: PlaceLaw
) -> Array:
    """Tell at which places f32[2, K] a thing of a type may stand beside those f32[2, O] there."""

    def beside(other: Array, other_kind: Array, gap: Array) -> Array:
        other = other[:, None]
        apart = jnp.hypot(place[0] - other[0], place[1] - other[1])
        as_hydrant = passes_for(place, other, law.said) & (other_kind == CONE) & (kind == HYDRANT)
        as_cone = passes_for(other, place, law.said) & (other_kind == HYDRANT) & (kind == CONE)
        return (apart >= gap) & ~as_hydrant & ~as_cone

    gaps = jnp.where(jnp.arange(kinds.size) < 2, OWN_GAP, law.gap)
    is_fit = jax.vmap(beside, in_axes=(1, 0, 0))(placed, kinds, gaps)
    return jnp.all(is_fit | ~is_placed[:, None], axis=0)


def _errors(key: Array, law: PlaceLaw) -> Errors:
    """Draw where the detector is apt to see a hydrant or a cone that is not there."""
    place_key, kind_key = jax.random.split(key)
    place = _anywhere(place_key, law.area, (NUM_HAUNTED,))
    kind = jax.random.randint(kind_key, (NUM_HAUNTED,), HYDRANT, CONE + 1)
    is_haunted = jnp.arange(NUM_HAUNTED) < law.num_haunted
    return Errors(
        is_type=jnp.ones(NUM_TYPES, bool),
        is_invented=law.is_invented,
        haunt_type=jnp.where(is_haunted, kind, NONE).astype(jnp.int32),
        haunt_x=place[0],
        haunt_y=place[1],
        haunt_probability=law.haunt_probability,
    )


def _within(area: Array) -> tuple[Array, Array]:
    """Leave out the border of an area: f32[4] to its corners, f32[2] each."""
    return area[0::2] + BORDER_MARGIN, area[1::2] - BORDER_MARGIN


def _anywhere(key: Array, area: Array, shape: tuple[int, ...]) -> Array:
    """Draw places evenly from the area but for its border, f32[2, *shape] metres."""
    low, high = (one.reshape(2, *(1,) * len(shape)) for one in _within(area))
    return low + (high - low) * jax.random.uniform(key, (2, *shape))


def place_law(*, area: tuple[float, float, float, float], **numbers: Any) -> PlaceLaw:
    """Build a law of places.

    Hydrants and cones are what is invented, the worst for a sentence about them.

    Args:
        area: x_min, x_max, y_min, y_max, metres; the origin is in it.
        **numbers: other fields of ``PlaceLaw``.

    Raises:
        ValueError: more things than there are slots, or more haunted places.
    """
    invented = jnp.isin(jnp.arange(NUM_TYPES), jnp.array([HYDRANT, CONE]))
    law = PlaceLaw(area=jnp.array(area, jnp.float32), is_invented=invented, **numbers)
    number = 2 + 2 * int(law.num_pairs) + int(law.num_bystanders)
    if number > NUM_THINGS or int(law.num_haunted) > NUM_HAUNTED:
        raise ValueError(
            f"a place of {number} things and {law.num_haunted} haunted places was asked for, but "
            f"must have at most {NUM_THINGS} and {NUM_HAUNTED}: take fewer"
        )
    # So many things would find no room at a metre from each other.
    return strong(replace(law, gap=0.5) if number > 30 else law)
