"""Sampling of random worlds of a template (section 4.2; the paper does not specify geometry).

Frame: the robot starts at the origin and faces +x. The operating area is
[0, D] x [-D/√2, D/√2], D = Known mean + 2.5 sd of the row of Table 2. The distribution:

- a hydrant is at range N(Known mean, sd) and bearing U(-45°, 45°), whether goal or not;
- each cone is near a point of the same distribution, 1.5-3.5 m from it toward the robot, lateral
  sd 0.4 m ("behind", null), or 1.5-3 m from it in any direction ("nearest");
- the first cone's point is the *anchor* hydrant, the further cones' points are empty;
- but for the anchor and its cone all objects are 4 m apart, and the anchor is the only hydrant
  behind any cone (viewer at the start, a wedge of ±45°, at any distance);
- with a relation the anchor is the goal; without one the goal is any hydrant, uniformly.

Sampling treats all hydrants alike: first their positions, then for each the cone that it would have
as the anchor, then the free cones; the anchor is chosen last. So the positions of hydrants are not
informative about the goal, and a policy that ignores cones is right once in the number of
hydrants. A null world has the geometry of "behind", as the paper issues both commands in one
environment.
"""

import math

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE
from jaxlangnav.numerics import batching
from jaxlangnav.pytree import pytree
from jaxlangnav.relations import to_map, viewer_frame
from jaxlangnav.world.state import CONE, HYDRANT, Scenario
from jaxlangnav.world.templates import (
    MAX_CONES,
    MAX_HYDRANTS,
    RELATION_NAMES,
    Template,
    check_relation,
    known_map_distance,
    parse_template,
)

AREA_SIGMAS = 2.5
OBJECT_BEARING_MAX = math.pi / 4
SEPARATION = 4.0  # metres between objects that are not a pair
CONE_DISTANCE_MIN = 1.5  # metres from the cone to its hydrant
CONE_DISTANCE_MAX = 3.5
NEAREST_DISTANCE_MAX = 3.0
LATERAL_SD = 0.4
WEDGE_COSINE = math.cos(math.pi / 4)
NUM_FREE = MAX_CONES - 1
NUM_ATTEMPTS = 16
"""Worlds sampled in parallel; the first that meets all constraints is used."""
NUM_CANDIDATES = 32
"""K, candidate positions sampled in parallel for each part of a world."""
NULL, _BEHIND, _NEAREST = range(len(RELATION_NAMES))


@pytree
class ScenarioParams:
    """Parameters of a template's world distribution; traced, so one program samples them all."""

    num_hydrants: Array  # i32[] 1 to MAX_HYDRANTS
    num_cones: Array  # i32[] 0 to MAX_CONES
    relation: Array  # i32[] index into RELATION_NAMES
    range_mean: Array  # f32[] metres from the start to a hydrant
    range_sd: Array  # f32[] metres


def _area_depth(dist: ScenarioParams) -> Array:
    """Compute D, the depth of the operating area."""
    return dist.range_mean + AREA_SIGMAS * dist.range_sd


def _sample_placement(key: Array, dist: ScenarioParams) -> tuple[Array, Array, Array, Array]:
    """Sample one world before its goal is chosen; it may violate the constraints.

    Positions of the hydrants f32[2, B], of each one's cone if it is the anchor f32[2, B] and of the
    free cones f32[2, F], metres, map frame; bool[], all constraints are met. B = MAX_HYDRANTS,
    F = NUM_FREE.
    """
    points, offsets = _sample_candidates(key, dist)
    is_hydrant = jnp.arange(MAX_HYDRANTS) < dist.num_hydrants
    check = jax.vmap(_are_valid, in_axes=(-1, None, None))
    is_valid = check(points[:, :MAX_HYDRANTS], is_hydrant, _area_depth(dist))
    hydrant = points[:, :MAX_HYDRANTS, jnp.argmax(is_valid)]
    anchor_cone, is_anchor_met = _place_anchor_cones(offsets, dist, hydrant, is_hydrant)
    free_cone, is_free_met = _place_free_cones(points, offsets, dist, hydrant, anchor_cone)
    return hydrant, anchor_cone, free_cone, jnp.any(is_valid) & is_anchor_met & is_free_met


def _place_anchor_cones(
    offset: Array, dist: ScenarioParams, hydrant: Array, is_hydrant: Array
) -> tuple[Array, Array]:
    """Place each hydrant's cone in case it is the anchor: f32[2, B]; bool[], all are placed."""
    cones, is_met = [], jnp.array(True)
    for i in range(MAX_HYDRANTS):
        figure = hydrant[:, i : i + 1]
        rest = is_hydrant & (jnp.arange(MAX_HYDRANTS) != i)
        candidate = _place_cones(figure, offset[:, i])
        is_sole = is_behind(figure, candidate) & ~_has_behind(candidate, hydrant, rest)
        is_valid = _is_inside(candidate, _area_depth(dist)) & _is_clear(candidate, hydrant, rest)
        is_valid &= is_sole | (dist.relation == _NEAREST)
        is_met &= jnp.any(is_valid) | ~is_hydrant[i] | (dist.num_cones == 0)
        cones.append(candidate[:, jnp.argmax(is_valid)])
    return jnp.stack(cones, axis=1), is_met


def _place_free_cones(
    points: Array, offset: Array, dist: ScenarioParams, hydrant: Array, anchor_cone: Array
) -> tuple[Array, Array]:
    """Place the cones without a hydrant: f32[2, F]; bool[], all are placed."""
    depth, is_met = _area_depth(dist), jnp.array(True)
    is_hydrant = jnp.arange(MAX_HYDRANTS) < dist.num_hydrants
    placed = jnp.concatenate([hydrant, anchor_cone], axis=1)
    is_placed = jnp.concatenate([is_hydrant, is_hydrant])
    for index in range(NUM_FREE):
        point = points[:, MAX_HYDRANTS + index]
        candidate = _place_cones(point, offset[:, MAX_HYDRANTS + index])
        is_ambiguous = _has_behind(candidate, hydrant, is_hydrant) & (dist.relation != _NEAREST)
        is_valid = _is_inside(point, depth) & _is_inside(candidate, depth) & ~is_ambiguous
        is_valid &= _is_clear(candidate, placed, is_placed)
        is_used = index < dist.num_cones - 1
        is_met &= jnp.any(is_valid) | ~is_used
        placed = jnp.concatenate([placed, candidate[:, jnp.argmax(is_valid)][:, None]], axis=1)
        is_placed = jnp.concatenate([is_placed, is_used[None]])
    return placed[:, 2 * MAX_HYDRANTS :], is_met


def _sample_candidates(key: Array, dist: ScenarioParams) -> tuple[Array, Array]:
    """Sample candidates of hydrants and offsets to their cones, f32[2, B + F, K] each."""
    # Without constraints. Hydrants come first, then the free cones' points; offsets are along and
    # across the line of sight.
    shape = (MAX_HYDRANTS + NUM_FREE, NUM_CANDIDATES)
    uniform = batching.uniforms(jax.random.split(key, 5), math.prod(shape)).reshape(5, *shape)
    distance = dist.range_mean + dist.range_sd * batching.normal(uniform[0])
    bearing = batching.to_interval(uniform[1], -OBJECT_BEARING_MAX, OBJECT_BEARING_MAX)
    point = jnp.stack([distance * jnp.cos(bearing), distance * jnp.sin(bearing)])

    is_nearest = dist.relation == _NEAREST
    gap_max = jnp.where(is_nearest, NEAREST_DISTANCE_MAX, CONE_DISTANCE_MAX)
    gap = CONE_DISTANCE_MIN + (gap_max - CONE_DISTANCE_MIN) * uniform[2]
    direction = batching.to_interval(uniform[3], -math.pi, math.pi)
    lateral = LATERAL_SD * batching.normal(uniform[4])
    # The gap is exact; the lateral part only rotates it away from the line of sight.
    lateral = jnp.clip(lateral, -gap, gap)
    radial = -jnp.sqrt(gap**2 - lateral**2)
    along = jnp.where(is_nearest, gap * jnp.cos(direction), radial)
    across = jnp.where(is_nearest, gap * jnp.sin(direction), lateral)
    return point, jnp.stack([along, across])


def _place_cones(point: Array, offset: Array) -> Array:
    """Place cones at offsets along and across the line of sight to points: f32[2, K]."""
    frame = viewer_frame(0.0, 0.0, point[0], point[1])
    x, y = to_map(frame, offset[0], offset[1])
    return jnp.stack([point[0] + x, point[1] + y])


def _are_valid(hydrant: Array, is_hydrant: Array, depth: Array) -> Array:
    """Check the constraints of candidate hydrants: f32[2, B], bool[B], f32[] to bool[]."""
    pairs = is_hydrant[:, None] & is_hydrant[None, :] & ~jnp.eye(MAX_HYDRANTS, dtype=bool)
    is_inside = jnp.all(_is_inside(hydrant, depth) | ~is_hydrant)
    return is_inside & jnp.all(_are_apart(hydrant, hydrant) | ~pairs)


def _is_inside(point: Array, depth: Array) -> Array:
    """Test which points are in the operating area: f32[2, K], f32[] to bool[K]."""
    half_width = depth / math.sqrt(2.0)
    return (point[0] >= 0.0) & (point[0] <= depth) & (jnp.abs(point[1]) <= half_width)


def _is_clear(point: Array, placed: Array, is_placed: Array) -> Array:
    """Test which points are 4 m from all objects: f32[2, K], f32[2, L], bool[L] to bool[K]."""
    return jnp.all(_are_apart(point, placed) | ~is_placed[:, None], axis=0)


def _are_apart(point: Array, placed: Array) -> Array:
    """Test which pairs are 4 m apart: f32[2, K], f32[2, L] to bool[L, K]."""
    offset = point[:, None, :] - placed[:, :, None]
    return jnp.sum(offset**2, axis=0) >= SEPARATION**2


def _has_behind(cone: Array, hydrant: Array, is_hydrant: Array) -> Array:
    """Test which cones have a hydrant behind: f32[2, K], f32[2, B], bool[B] to bool[K]."""
    return jnp.any(is_behind(hydrant[:, :, None], cone[:, None, :]) & is_hydrant[:, None], axis=0)


def is_behind(figure: Array, landmark: Array) -> Array:
    """Test whether figures f32[2, ...] are behind landmarks, seen from the start: within 45°.

    The distance is unbounded, so that a hydrant "not behind" is so at every distance.
    """
    frame = viewer_frame(0.0, 0.0, landmark[0], landmark[1])
    x, y = figure[0] - landmark[0], figure[1] - landmark[1]
    along = x * frame.along_x + y * frame.along_y
    return along >= WEDGE_COSINE * jnp.sqrt(x**2 + y**2)


def scenario_params(*, template: str | Template, relation: str) -> ScenarioParams:
    """Build the distribution of a template's worlds, for ``draw_scenario``.

    Args:
        template: a template or its name, such as "2H1C".
        relation: "null", "behind" or "nearest".

    Raises:
        ValueError: unknown template or relation, or a relation to a cone in a world without.
    """
    record = parse_template(template) if isinstance(template, str) else template
    relation_index = check_relation(relation)
    if record.num_cones == 0 and relation != "null":
        raise ValueError(
            f"world template {record.name!r} has no cone for the relation {relation!r}: "
            "choose one with 1 cone or more, or the relation 'null'"
        )
    mean, sd = known_map_distance(record, relation)
    return ScenarioParams(
        num_hydrants=jnp.int32(record.num_hydrants),
        num_cones=jnp.int32(record.num_cones),
        relation=jnp.int32(relation_index),
        range_mean=jnp.float32(mean),
        range_sd=jnp.float32(sd),
    )


def sample_scenario(key: Array, *, template: str | Template, relation: str) -> Scenario:
    """Sample one world of a template; ``vmap`` over keys for many.

    Args:
        key: random key.
        template: a template or its name, such as "2H1C".
        relation: "null", "behind" or "nearest": the relation of the command.

    Returns:
        The world. ``is_valid`` is False where no candidate met the constraints.

    Raises:
        ValueError: unknown template or relation.
    """
    return draw_scenario(key, scenario_params(template=template, relation=relation))


@jax.jit
def draw_scenario(key: Array, dist: ScenarioParams) -> Scenario:
    """Sample one world by rejection: the first of a fixed number of attempts that is valid.

    Args:
        key: random key.
        dist: parameters of the distribution; traced.

    Returns:
        The world; where no attempt is valid, the first one with ``is_valid`` False.
    """
    key_place, key_goal = jax.random.split(key)
    keys = jax.random.split(key_place, NUM_ATTEMPTS)
    attempts = jax.vmap(_sample_placement, in_axes=(0, None))(keys, dist)
    first = jnp.argmax(attempts[-1])
    hydrants, anchor_cones, free_cones, is_met = (part[first] for part in attempts)
    choices = (jax.random.uniform(key_goal, (2,)) * dist.num_hydrants).astype(jnp.int32)
    anchor, other = jnp.minimum(choices, dist.num_hydrants - 1)
    goal_index = jnp.where(dist.relation == NULL, other, anchor)
    # Slots: hydrants, then the anchor's cone, then the free cones.
    cone = anchor_cones[:, anchor]
    position = jnp.concatenate([hydrants, cone[:, None], free_cones], axis=1)
    object_type = jnp.array([HYDRANT] * MAX_HYDRANTS + [CONE] * MAX_CONES, jnp.int32)
    is_object = jnp.concatenate(
        [jnp.arange(MAX_HYDRANTS) < dist.num_hydrants, jnp.arange(MAX_CONES) < dist.num_cones]
    )
    order = jnp.argsort(~is_object, stable=True)
    is_slot = is_object[order]
    depth = _area_depth(dist)
    half_width = depth / math.sqrt(2.0)
    return Scenario(
        object_type=jnp.where(is_slot, object_type[order], NONE),
        object_x=jnp.where(is_slot, position[0, order], 0.0),
        object_y=jnp.where(is_slot, position[1, order], 0.0),
        is_object=is_slot,
        goal=position[:, goal_index],
        goal_index=goal_index,
        start=jnp.zeros(3, jnp.float32),
        area=jnp.stack([jnp.zeros_like(depth), depth, -half_width, half_width]),
        is_valid=is_met,
    )
