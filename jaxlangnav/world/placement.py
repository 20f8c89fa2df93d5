"""Where the objects of a random world stand (section 4.2; the geometry is ours).

A world is built part by part, each part taking the first of K candidates that fits what stands.
The hydrants come first and alike, then for each of them the cone that it would have as the
anchor, then the free cones: nothing in a placement tells which hydrant will be the anchor.
"""

import math

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.numerics import batching
from jaxlangnav.pytree import pytree
from jaxlangnav.relations import to_map, viewer_frame
from jaxlangnav.world.templates import MAX_CONES, MAX_HYDRANTS, RELATION_NAMES

AREA_SIGMAS = 2.5
OBJECT_BEARING_MAX = math.pi / 4
SEPARATION = 4.0  # metres between objects that do not belong together
CONE_DISTANCE_MIN = 1.5  # metres from the cone to its hydrant
CONE_DISTANCE_MAX = 3.5
NEAREST_DISTANCE_MAX = 3.0
LATERAL_SD = 0.4
WEDGE_COSINE = math.cos(math.pi / 4)
NUM_FREE = MAX_CONES - 1
NULL, _BEHIND, _NEAREST = range(len(RELATION_NAMES))


@pytree
class ScenarioLaw:
    """What a template and a relation fix about a world; traced, so one program draws them all."""

    num_hydrants: Array  # i32[] 1 to MAX_HYDRANTS
    num_cones: Array  # i32[] 0 to MAX_CONES
    relation: Array  # i32[] index into RELATION_NAMES
    range_mean: Array  # f32[] metres from the start to a hydrant
    range_sd: Array  # f32[] metres


@pytree
class _Draws:
    """Unchecked draws, K candidates of each: hydrants first, then the free cones' points."""

    point: Array  # f32[2, B + F, K] metres, by the law of hydrants
    offset: Array  # f32[2, B + F, K] metres, from a point to its cone; along, across line of sight


@pytree
class Placement:
    """A world before the lot: B = MAX_HYDRANTS hydrants, F = NUM_FREE free cones."""

    hydrant: Array  # f32[2, B] x, y metres, map frame
    anchor_cone: Array  # f32[2, B] metres, the first cone, should this hydrant be the anchor
    free_cone: Array  # f32[2, F] metres, the further cones
    is_met: Array  # bool[] everything found its place


def area_depth(law: ScenarioLaw) -> Array:
    """Compute D, how far the operating area reaches ahead.

    Args:
        law: the law.

    Returns:
        f32[], metres.
    """
    return law.range_mean + AREA_SIGMAS * law.range_sd


def try_placement(key: Array, law: ScenarioLaw, num_candidates: int) -> Placement:
    """Try once to build a world.

    Args:
        key: random key.
        law: what to build; traced.
        num_candidates: K, places tried for each part.

    Returns:
        The placement; ``is_met`` is False where some part found no place.
    """
    draws = _draw(key, law, num_candidates)
    is_hydrant = jnp.arange(MAX_HYDRANTS) < law.num_hydrants
    fits = jax.vmap(_hydrants_fit, in_axes=(-1, None, None))
    is_fit = fits(draws.point[:, :MAX_HYDRANTS], is_hydrant, area_depth(law))
    hydrant = draws.point[:, :MAX_HYDRANTS, jnp.argmax(is_fit)]
    anchor_cone, is_anchored = _place_anchor_cones(draws, law, hydrant, is_hydrant)
    free_cone, is_free_met = _place_free_cones(draws, law, hydrant, anchor_cone)
    return Placement(
        hydrant=hydrant,
        anchor_cone=anchor_cone,
        free_cone=free_cone,
        is_met=jnp.any(is_fit) & is_anchored & is_free_met,
    )


def _place_anchor_cones(
    draws: _Draws, law: ScenarioLaw, hydrant: Array, is_hydrant: Array
) -> tuple[Array, Array]:
    """Give each hydrant the cone it would have as the anchor: f32[2, B] and bool[], all found."""
    cones, is_met = [], jnp.array(True)
    for index in range(MAX_HYDRANTS):
        own = hydrant[:, index : index + 1]
        rest = is_hydrant & (jnp.arange(MAX_HYDRANTS) != index)
        candidate = _beside(own, draws.offset[:, index])
        is_only = is_behind(own, candidate) & ~_has_behind(candidate, hydrant, rest)
        is_fit = _is_inside(candidate, area_depth(law)) & _is_clear(candidate, hydrant, rest)
        is_fit &= is_only | (law.relation == _NEAREST)
        is_met &= jnp.any(is_fit) | ~is_hydrant[index] | (law.num_cones == 0)
        cones.append(candidate[:, jnp.argmax(is_fit)])
    return jnp.stack(cones, axis=1), is_met


def _place_free_cones(
    draws: _Draws, law: ScenarioLaw, hydrant: Array, anchor_cone: Array
) -> tuple[Array, Array]:
    """Place the cones that belong to no hydrant: f32[2, F] and bool[], all found."""
    depth, is_met = area_depth(law), jnp.array(True)
    is_hydrant = jnp.arange(MAX_HYDRANTS) < law.num_hydrants
    placed = jnp.concatenate([hydrant, anchor_cone], axis=1)
    is_placed = jnp.concatenate([is_hydrant, is_hydrant])
    for index in range(NUM_FREE):
        point = draws.point[:, MAX_HYDRANTS + index]
        candidate = _beside(point, draws.offset[:, MAX_HYDRANTS + index])
        is_stray = _has_behind(candidate, hydrant, is_hydrant) & (law.relation != _NEAREST)
        is_fit = _is_inside(point, depth) & _is_inside(candidate, depth) & ~is_stray
        is_fit &= _is_clear(candidate, placed, is_placed)
        is_used = index < law.num_cones - 1
        is_met &= jnp.any(is_fit) | ~is_used
        placed = jnp.concatenate([placed, candidate[:, jnp.argmax(is_fit)][:, None]], axis=1)
        is_placed = jnp.concatenate([is_placed, is_used[None]])
    return placed[:, 2 * MAX_HYDRANTS :], is_met


def _draw(key: Array, law: ScenarioLaw, num_candidates: int) -> _Draws:
    """Draw points of the hydrant law and the way from each to a cone, nothing checked."""
    shape = (MAX_HYDRANTS + NUM_FREE, num_candidates)
    drawn = batching.uniforms(jax.random.split(key, 5), math.prod(shape)).reshape(5, *shape)
    distance = law.range_mean + law.range_sd * batching.normal(drawn[0])
    bearing = batching.between(drawn[1], -OBJECT_BEARING_MAX, OBJECT_BEARING_MAX)
    point = jnp.stack([distance * jnp.cos(bearing), distance * jnp.sin(bearing)])

    is_nearest = law.relation == _NEAREST
    gap_max = jnp.where(is_nearest, NEAREST_DISTANCE_MAX, CONE_DISTANCE_MAX)
    gap = CONE_DISTANCE_MIN + (gap_max - CONE_DISTANCE_MIN) * drawn[2]
    direction = batching.between(drawn[3], -math.pi, math.pi)
    lateral = LATERAL_SD * batching.normal(drawn[4])
    # The gap is exact; the lateral part only turns it away from the line of sight.
    lateral = jnp.clip(lateral, -gap, gap)
    toward = -jnp.sqrt(gap**2 - lateral**2)
    along = jnp.where(is_nearest, gap * jnp.cos(direction), toward)
    across = jnp.where(is_nearest, gap * jnp.sin(direction), lateral)
    return _Draws(point=point, offset=jnp.stack([along, across]))


def _beside(point: Array, offset: Array) -> Array:
    """Place cones by points: f32[2, K or 1], offsets along and across the sight, to f32[2, K]."""
    frame = viewer_frame(0.0, 0.0, point[0], point[1])
    x, y = to_map(frame, offset[0], offset[1])
    return jnp.stack([point[0] + x, point[1] + y])


def _hydrants_fit(hydrant: Array, is_hydrant: Array, depth: Array) -> Array:
    """Check one candidate set of hydrants: f32[2, B], bool[B], f32[] to bool[]."""
    pairs = is_hydrant[:, None] & is_hydrant[None, :] & ~jnp.eye(MAX_HYDRANTS, dtype=bool)
    offset = hydrant[:, :, None] - hydrant[:, None, :]
    is_far = jnp.sum(offset**2, axis=0) >= SEPARATION**2
    return jnp.all(_is_inside(hydrant, depth) | ~is_hydrant) & jnp.all(is_far | ~pairs)


def _is_inside(point: Array, depth: Array) -> Array:
    """Tell which points lie in the operating area: f32[2, K], f32[] to bool[K]."""
    side = depth / math.sqrt(2.0)
    return (point[0] >= 0.0) & (point[0] <= depth) & (jnp.abs(point[1]) <= side)


def _is_clear(point: Array, placed: Array, is_placed: Array) -> Array:
    """Tell which points are 4 m from all placed: f32[2, K], f32[2, L], bool[L] to bool[K]."""
    offset = point[:, None, :] - placed[:, :, None]
    is_far = jnp.sum(offset**2, axis=0) >= SEPARATION**2
    return jnp.all(is_far | ~is_placed[:, None], axis=0)


def _has_behind(cone: Array, hydrant: Array, is_hydrant: Array) -> Array:
    """Tell behind which cones a hydrant is: f32[2, K], f32[2, B], bool[B] to bool[K]."""
    is_related = is_behind(hydrant[:, :, None], cone[:, None, :])
    return jnp.any(is_related & is_hydrant[:, None], axis=0)


def is_behind(figure: Array, landmark: Array) -> Array:
    """Tell whether figures are behind landmarks, seen from the start: within 45°, any distance.

    The distance is left open so that what is drawn as "not behind" is so at every distance.

    Args:
        figure: f32[2, ...], x and y metres, map frame.
        landmark: f32[2, ...], metres.

    Returns:
        bool[...].
    """
    frame = viewer_frame(0.0, 0.0, landmark[0], landmark[1])
    x, y = figure[0] - landmark[0], figure[1] - landmark[1]
    along = x * frame.along_x + y * frame.along_y
    return along >= WEDGE_COSINE * jnp.sqrt(x**2 + y**2)
