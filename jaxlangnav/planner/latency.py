"""Expected latency of search tours: distance until the target is in view (section 3.4; ours).

A tour is a polyline of K stops. Its *latency* is the expected distance travelled until the target
comes into view:

    L = Σ_c m_c t_c + Σ_{c missed} m_c (T + |c − q_K| + B / 4R)

m_c is the mass of cell c, t_c the distance after which the tour first comes within sensing range
of it (or of its unanchored landmark, plus half the way between the two: all of it for a tour that
makes for them, next to none for one that passes by), T the length, q_K the last stop and B the area
that the tour misses, so that B / 4R is about half of a sweep of it (R sin h for a view of
half-angle h below a right angle, whose swath is narrower).

The target may not exist, with probability q (``termination``): then all of the area has to be
viewed before that is known (of an unanchored pair either place), in whatever order, and the total
distance counts:

    L' = (1 − q) L + q M (T + mean_{c missed} |c − q_K| + B / 2R + G),   M = Σ_c m_c

G is the distance between the patches that the tour misses, visited in boustrophedon lanes. If the
tour misses nothing, everything has been viewed after max_c t_c metres, and L' is exact.

Cells missed within the keep-out distance of a forbidden object are farther away by the cost of
entering it (``constraints``): as a rule they are viewed from outside.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import SensorParams
from jaxlangnav.numerics.batching import materialize
from jaxlangnav.planner.constraints import cost_at
from jaxlangnav.planner.search import SearchMap
from jaxlangnav.pytree import pytree
from jaxlangnav.terrain import OPEN, Terrain
from jaxlangnav.terrain.view import LARGE, Position, Segment

NUM_STOPS = 6
"""K, stops of a tour."""
_ARRIVAL = 0.5  # metres from a stop within which it counts as reached
SIGHT_MARGIN = 0.5
"""Metres inside the sensing range within which an object is counted as visible."""


@pytree
class Tour:
    """Stops to visit in order; K = NUM_STOPS."""

    x: Array  # f32[..., K] metres, map frame
    y: Array  # f32[..., K]


def is_reached(x: Array, y: Array, robot: Position) -> Array:
    """Test which positions count as reached by the robot."""
    return (x - robot[0]) ** 2 + (y - robot[1]) ** 2 < _ARRIVAL * _ARRIVAL


def first_sight(
    tours: Tour,
    x: Array,
    y: Array,
    robot: Position,
    radius: Array,
    fov: Array | None = None,
    *,
    terrain: Terrain = OPEN,
) -> tuple[Array, Array]:
    """Compute the distance, f32[T, C] metres, after which each tour first views each position.

    Also f32[T] metres, the whole length of each tour. Limits: 0 for a position already in view;
    ``LARGE`` or more for one that never is.

    Args:
        tours: leaves [T, K].
        x: f32[C], positions, metres, map frame.
        y: f32[C].
        robot: start of the tours.
        radius: f32[], metres, sensing range.
        fov: f32[], radians, field of view about the direction of travel; None: all round.
        terrain: lines of sight and travel distances.
    """
    start = jnp.ones_like(tours.x[:, :1])
    from_x = jnp.concatenate([robot[0] * start, tours.x[:, :-1]], axis=1)
    from_y = jnp.concatenate([robot[1] * start, tours.y[:, :-1]], axis=1)
    length = terrain.travel.metres(from_x, from_y, tours.x, tours.y)
    travelled = jnp.cumsum(length, axis=1)
    # All segments of all tours against all positions, [T, K, C].
    segment = Segment(from_x, from_y, tours.x, tours.y)
    offset = terrain.travel.first_sight(terrain.view, segment, x, y, radius, fov)
    sight_at = (travelled - length)[:, :, None] + offset
    first = sight_at[:, 0]
    for stop in range(1, sight_at.shape[1]):  # a reduction over a middle axis is not vectorised
        first = jnp.minimum(first, sight_at[:, stop])
    return materialize(first), travelled[:, -1]


def _patch_travel(is_missed: Array, area: Array) -> Array:
    """Compute the distance between the patches that tours miss, f32[T] metres."""
    side = int(np.sqrt(is_missed.shape[1])) // 2
    blocks = jnp.any(is_missed.reshape(-1, side, 2, side, 2), axis=(2, 4))  # [T, y, x]
    size = jnp.stack([area[1] - area[0], area[3] - area[2]]) / side
    row, column = np.divmod(np.arange(side * side), side)
    column = np.where(row % 2 == 0, column, side - 1 - column)

    def gaps_along_lanes(blocks: Array, step: Array, lane_step: Array) -> Array:
        """Sum the gaps between missed blocks, in the order of lanes."""
        is_missed_in_order = blocks.reshape(-1, side * side)[:, row * side + column]
        index = jnp.where(is_missed_in_order, np.arange(side * side)[None], -1)
        last = jnp.pad(jax.lax.cummax(index, axis=1), ((0, 0), (1, 0)), constant_values=-1)[:, :-1]
        x, y = step * column.astype(np.float32), lane_step * row.astype(np.float32)
        from_last = jnp.hypot(x[None] - x[last], y[None] - y[last])
        gap = jnp.maximum(from_last - 1.5 * jnp.max(size), 0.0)
        return jnp.sum(jnp.where(is_missed_in_order & (last >= 0), gap, 0.0), axis=1)

    return jnp.minimum(gaps_along_lanes(blocks, *size), gaps_along_lanes(blocks.mT, *size[::-1]))


def latency(
    tours: Tour, search: SearchMap, robot: Position, sensor: SensorParams, area: Array
) -> Array:
    """Compute the expected latency of tours, times the target's mass, f32[T].

    Limits: at q = 0 the distance until all has been viewed does not count; a view of half a circle
    or more sweeps a swath of 2 R; large for a tour that starts where the robot is.

    Args:
        tours: leaves [T, K].
        search: search map.
        robot: start of the tours.
        sensor: sensing range and field of view.
        area: f32[4], operating area, metres.
    """
    radius = jnp.maximum(sensor.range_max - SIGHT_MARGIN, 0.5 * sensor.range_max)
    fov = sensor.field_of_view
    half_width = sensor.range_max * jnp.sin(jnp.minimum(0.5 * fov, 0.5 * jnp.pi))
    x = jnp.concatenate([search.x, search.partner_x])
    y = jnp.concatenate([search.y, search.partner_y])
    sight_at, length = first_sight(tours, x, y, robot, radius, fov, terrain=search.terrain)
    own_at, partner_at = jnp.split(sight_at, 2, axis=1)  # distance at which either point is viewed
    gap = jnp.hypot(search.x - search.partner_x, search.y - search.partner_y)
    first_at = jnp.minimum(own_at, partner_at + 0.5 * gap[None])
    distance = search.terrain.travel.metres(
        tours.x[:, -1:], tours.y[:, -1:], search.x[None], search.y[None]
    )
    if search.forbidden is not None:  # cells that a tour misses have to be entered
        distance = distance + cost_at(search.x, search.y, search.forbidden)[None]
    mass = search.mass
    # Cells of negligible mass are not worth a detour.
    is_relevant = (mass > 0.1 * jnp.mean(mass))[None, :]
    cell_area = (area[1] - area[0]) * (area[3] - area[2]) / mass.shape[0]
    num_missed = jnp.sum((first_at >= LARGE) & is_relevant, axis=1)
    later_at = (length + num_missed * cell_area / (4.0 * half_width))[:, None] + distance
    cost_unanchored = search.unanchored[None, :] * jnp.where(first_at < LARGE, first_at, later_at)
    cost_anchored = search.anchored[None, :] * jnp.where(own_at < LARGE, own_at, later_at)
    total = jnp.sum(cost_unanchored + cost_anchored, axis=1)
    is_anchored = (search.anchored > search.unanchored)[None]
    either_at = jnp.where(is_anchored, own_at, jnp.minimum(own_at, partner_at))
    is_missed = (either_at >= LARGE) & is_relevant
    missed = jnp.sum(is_missed, axis=1)
    to_missed = jnp.sum(jnp.where(is_missed, distance, 0.0), axis=1) / jnp.maximum(missed, 1)
    later_at = length + to_missed + missed * cell_area / (2.0 * half_width)
    last_at = jnp.max(jnp.where(is_relevant, either_at, 0.0), axis=1)
    all_at = jnp.where(missed > 0, later_at + _patch_travel(is_missed, area), last_at)
    total = (1.0 - search.prob_absent) * total + search.prob_absent * jnp.sum(mass) * all_at
    return total + jnp.where(is_reached(tours.x[:, 0], tours.y[:, 0], robot), LARGE, 0.0)
