"""How long a tour takes until it shows what is looked for (section 3.4; ours).

A tour is a line of K stops. Its *latency* is the expected length of the way until what is looked
for comes into view:

    L = Σ_c m_c t_c + Σ_{c missed} m_c (T + |c − q_K| + B / 4R)

m_c is the mass of cell c, t_c the length of the way at which the line of stops first comes within
sensing range of it (of a free pair: of either), T the whole length, q_K the last stop and B the
area that the tour has missed, so that B / 4R is about half of a sweep of it (R sin h of a view of
half-angle h below a right angle, which shows less abreast).

What is looked for may be nowhere, with probability q (``termination``): then all of the area is
looked at before that is known, in whatever order, and the way until then is what counts:

    L' = (1 − q) L + q M (T + mean_{c missed} |c − q_K| + B / 2R + G),   M = Σ_c m_c

G is the way between the patches that the tour would leave, from patch to patch in lanes. Where the
tour leaves nothing, all has been looked at after max_c t_c metres, and L' is exact.

Where something is forbidden, what is missed within its berth is as much farther away as it costs to
go in (``constraints``): as a rule it is looked at from outside.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import SensorParams
from jaxlangnav.numerics.batching import materialize
from jaxlangnav.planner.constraints import price_of_stop
from jaxlangnav.planner.search import SearchMap
from jaxlangnav.pytree import pytree
from jaxlangnav.terrain import OPEN, Terrain
from jaxlangnav.terrain.view import NEVER, Stretch

NUM_STOPS = 6
"""K, stops of a tour."""
_ARRIVAL = 0.5  # metres from a stop that count as having been there
SIGHT_MARGIN = 0.5
"""Metres by which a thing must be inside the sensing range to count on seeing it."""


@pytree
class Tour:
    """Places to go to in turn; K = NUM_STOPS."""

    x: Array  # f32[..., K] metres, map frame
    y: Array  # f32[..., K]


def is_underfoot(x: Array, y: Array, robot_x: Array, robot_y: Array) -> Array:
    """Tell which places count as reached."""
    return (x - robot_x) ** 2 + (y - robot_y) ** 2 < _ARRIVAL * _ARRIVAL


def first_sight(
    tours: Tour,
    x: Array,
    y: Array,
    robot_x: Array,
    robot_y: Array,
    radius: Array,
    opening: Array | None = None,
    *,
    terrain: Terrain = OPEN,
) -> tuple[Array, Array]:
    """Compute after how many metres, f32[T, C], each tour first comes in sight of each place.

    And f32[T] metres, the whole length of each tour. Limits: 0 for a place already in sight;
    ``NEVER`` or more for one that never is.

    Args:
        tours: leaves [T, K].
        x: f32[C], places, metres, map frame.
        y: f32[C].
        robot_x: f32[], where the tours start.
        robot_y: f32[].
        radius: f32[], metres, how far one sees.
        opening: f32[], radians, how wide one sees about the way ahead; None: all round.
        terrain: what can be seen, and how far it is to walk.
    """
    start = jnp.ones_like(tours.x[:, :1])
    from_x = jnp.concatenate([robot_x * start, tours.x[:, :-1]], axis=1)
    from_y = jnp.concatenate([robot_y * start, tours.y[:, :-1]], axis=1)
    length = terrain.travel.metres(from_x, from_y, tours.x, tours.y)
    walked = jnp.cumsum(length, axis=1)
    # All stretches of all tours against all places, [T, K, C].
    stretch = Stretch(from_x, from_y, tours.x, tours.y)
    enter = terrain.travel.first_sight(terrain.view, stretch, x, y, radius, opening)
    met = (walked - length)[:, :, None] + enter
    first = met[:, 0]
    for stop in range(1, met.shape[1]):  # a reduction over a middle axis is not vectorised
        first = jnp.minimum(first, met[:, stop])
    return materialize(first), walked[:, -1]


def _between_patches(is_missed: Array, area: Array) -> Array:
    """Measure the way between the patches that tours leave, f32[T] metres."""
    side = int(np.sqrt(is_missed.shape[1])) // 2
    blocks = jnp.any(is_missed.reshape(-1, side, 2, side, 2), axis=(2, 4))  # [T, y, x]
    size = jnp.stack([area[1] - area[0], area[3] - area[2]]) / side
    row, column = np.divmod(np.arange(side * side), side)
    column = np.where(row % 2 == 0, column, side - 1 - column)

    def in_lanes(blocks: Array, step: Array, lane: Array) -> Array:
        is_left = blocks.reshape(-1, side * side)[:, row * side + column]
        own = jnp.where(is_left, np.arange(side * side)[None], -1)
        last = jnp.pad(jax.lax.cummax(own, axis=1), ((0, 0), (1, 0)), constant_values=-1)[:, :-1]
        x, y = step * column.astype(np.float32), lane * row.astype(np.float32)
        from_last = jnp.hypot(x[None] - x[last], y[None] - y[last])
        beyond = jnp.maximum(from_last - 1.5 * jnp.max(size), 0.0)
        return jnp.sum(jnp.where(is_left & (last >= 0), beyond, 0.0), axis=1)

    return jnp.minimum(in_lanes(blocks, *size), in_lanes(blocks.mT, *size[::-1]))


def latency(
    tours: Tour,
    search: SearchMap,
    robot_x: Array,
    robot_y: Array,
    sensor: SensorParams,
    area: Array,
) -> Array:
    """Compute the expected way until what is looked for comes into view, times its mass, f32[T].

    Limits: at q = 0 the way until all has been looked at does not count; a view of half a circle
    or more sweeps 2 R abreast; large for a tour that starts underfoot.

    Args:
        tours: leaves [T, K].
        search: where looking is worth while.
        robot_x: f32[], metres, map frame.
        robot_y: f32[], metres.
        sensor: how far and how wide one sees.
        area: f32[4], operating area, metres.
    """
    radius = jnp.maximum(sensor.range_max - SIGHT_MARGIN, 0.5 * sensor.range_max)
    opening = sensor.field_of_view
    abreast = sensor.range_max * jnp.sin(jnp.minimum(0.5 * opening, 0.5 * jnp.pi))
    places_x = jnp.concatenate([search.x, search.partner_x])
    places_y = jnp.concatenate([search.y, search.partner_y])
    sight, walked = first_sight(
        tours, places_x, places_y, robot_x, robot_y, radius, opening, terrain=search.terrain
    )
    anchored, partner = jnp.split(sight, 2, axis=1)
    free = jnp.minimum(anchored, partner)
    away = search.terrain.travel.metres(
        tours.x[:, -1:], tours.y[:, -1:], search.x[None], search.y[None]
    )
    if search.forbidden is not None:  # what a tour misses has to be gone in for
        away = away + price_of_stop(search.x, search.y, search.forbidden)[None]
    mass = search.mass
    # What is as good as looked at is not worth a way.
    counts = (mass > 0.1 * jnp.mean(mass))[None, :]
    is_left = (free >= NEVER) & counts
    cell = (area[1] - area[0]) * (area[3] - area[2]) / mass.shape[0]
    sweep = jnp.sum(is_left, axis=1) * cell / (4.0 * abreast)
    rest = (walked + sweep)[:, None] + away
    of_unanchored = search.unanchored[None, :] * jnp.where(free < NEVER, free, rest)
    of_anchored = search.anchored[None, :] * jnp.where(anchored < NEVER, anchored, rest)
    total = jnp.sum(of_unanchored + of_anchored, axis=1)
    is_missed = (anchored >= NEVER) & counts
    number = jnp.sum(is_missed, axis=1)
    back = jnp.sum(jnp.where(is_missed, away, 0.0), axis=1) / jnp.maximum(number, 1)
    rest = walked + back + number * cell / (2.0 * abreast) + _between_patches(is_missed, area)
    whole = jnp.where(number > 0, rest, jnp.max(jnp.where(counts, anchored, 0.0), axis=1))
    total = (1.0 - search.nowhere) * total + search.nowhere * jnp.sum(mass) * whole
    is_there = is_underfoot(tours.x[:, 0], tours.y[:, 0], robot_x, robot_y)
    return total + jnp.where(is_there, NEVER, 0.0)
