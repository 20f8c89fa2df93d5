"""Search tours of least expected latency, by randomized local search (section 3.4; ours).

Each decision starts from the current tour and from greedy tours over a lattice of viewpoints, and
improves the best, that of least ``latency``, by rounds of random moves: shift a stop, insert one,
remove one, reverse a segment. As the current tour is among the candidates, it is replaced only by
one of lower cost. The larger the area beside the sensing range, the more rounds. Stops near
forbidden objects cost the distance in and out (``constraints``).
"""

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import SensorParams
from jaxlangnav.numerics import batching
from jaxlangnav.planner.constraints import cost_at, keep_out
from jaxlangnav.planner.latency import NUM_STOPS, Tour, is_reached, latency
from jaxlangnav.planner.search import LATTICE, SearchMap, grid, visibility
from jaxlangnav.pytree import pytree
from jaxlangnav.terrain.view import Position

NUM_GREEDY = 3
"""Number of greedy initial tours at each decision."""
NUM_CHANGES = 8
"""Number of random moves tried in a round."""
_MOVE, _MOVE_FAR, _INSERT, _REVERSE, _REMOVE = range(5)


def greedy(search: SearchMap, robot: Position, range_max: Array, area: Array) -> Tour:
    """Build greedy tours over the lattice of viewpoints, by maximum mass per metre.

    Leaves [NUM_GREEDY, K], with different first viewpoints; arguments as for ``plan``.
    """
    view_x, view_y = grid(area, LATTICE)
    visible = visibility(view_x, view_y, search, range_max, area)
    metres = search.terrain.travel.metres
    between = metres(view_x[:, None], view_y[:, None], view_x[None, :], view_y[None, :])
    distance = metres(*robot, view_x, view_y)
    # A metre is added to each distance, so that a ratio stays finite at distance 0.
    _, first = jax.lax.top_k((visible @ search.mass) / (distance + 1.0), NUM_GREEDY)

    def extend(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        current, mass = carry
        best = jnp.argmax((mass @ visible.T) / (between[current] + 1.0), axis=1)
        return (best, mass * (1.0 - visible[best])), best

    mass = search.mass[None, :] * (1.0 - visible[first])
    _, rest = jax.lax.scan(extend, (first, mass), length=NUM_STOPS - 1)
    chosen = jnp.concatenate([first[None], rest]).T
    return Tour(x=view_x[chosen], y=view_y[chosen])


def random_moves(key: Array, tour: Tour, search: SearchMap, area: Array) -> Tour:
    """Apply NUM_CHANGES random moves to a tour, leaves [K], each to a copy: [NUM_CHANGES, K].

    New stops are sampled from the mass, and clipped to the area f32[4].
    """
    uniform = batching.uniforms(key[None], 5 * NUM_CHANGES).reshape(5, NUM_CHANGES)
    move = (jnp.arange(NUM_CHANGES) % 5)[:, None]
    stop = jnp.arange(NUM_STOPS)[None, :]
    first, second = jnp.floor(uniform[:2] * NUM_STOPS).astype(jnp.int32)[:, :, None]
    low, high = jnp.minimum(first, second), jnp.maximum(first, second)
    inserted = jnp.where(stop > first, stop - 1, stop)
    reversed_ = jnp.where((stop >= low) & (stop <= high), low + high - stop, stop)
    removed = jnp.where(stop >= first, jnp.minimum(stop + 1, NUM_STOPS - 1), stop)
    moves = [move == _INSERT, move == _REVERSE, move == _REMOVE]
    source = jnp.select(moves, [inserted, reversed_, removed], stop)
    cumulative = jnp.cumsum(search.mass)
    drawn = jnp.sum(cumulative[None, :] <= (uniform[2] * cumulative[-1])[:, None], axis=1)
    drawn = jnp.minimum(drawn, cumulative.shape[0] - 1)[:, None]
    distance = (0.3 * 10.0 ** uniform[3])[:, None]
    angle = (2.0 * jnp.pi * uniform[4])[:, None]
    is_new = ((move == _INSERT) & (stop == first)) | ((move == _REMOVE) & (stop == NUM_STOPS - 1))
    is_moved = (move <= _MOVE_FAR) & (stop == first)

    def rearrange(stops: Array, cells: Array, offset: Array, lower: Array, upper: Array) -> Array:
        stops = jnp.where(is_new, cells[drawn], stops[source])
        return jnp.clip(stops + jnp.where(is_moved, offset, 0.0), lower, upper)

    return Tour(
        x=rearrange(tour.x, search.x, distance * jnp.cos(angle), area[0], area[1]),
        y=rearrange(tour.y, search.y, distance * jnp.sin(angle), area[2], area[3]),
    )


_MIN_ROUNDS, _MAX_ROUNDS, _VIEWS_PER_ROUND = 3, 32, 3.0
"""Rounds of local search at each decision: one for every three views that fill the area."""
_IS_KEPT_OUT = np.arange(NUM_CHANGES) % 2 == 1
"""Moves whose stops are projected out of the keep-out zones of forbidden objects. Those of the
initial tours are, except of the current tour."""


@pytree
class Plan:
    """Candidate tours of the last round; T = NUM_CHANGES + 1, the best of earlier rounds first."""

    tours: Tour  # leaves [T, K]
    latency: Array  # f32[T] expected metres until found, times the mass
    mass: Array  # f32[] expected number of objects still to be found
    anchored: Array  # f32[] of them, those anchored to an observed object
    ordered: Array | np.float32 = np.float32(0.0)  # f32[] those before the observed one of a rank


def _drop_reached(tour: Tour, robot: Position) -> Tour:
    """Drop the first stop if it is reached; the last one is repeated."""
    is_done = is_reached(tour.x[0], tour.y[0], robot)
    later = jax.tree.map(lambda stops: jnp.append(stops[1:], stops[-1]), tour)
    return jax.tree.map(lambda new, old: jnp.where(is_done, new, old), later, tour)


def _prepend(first: Tour, others: Tour) -> Tour:
    """Prepend a tour, leaves [K], to others, leaves [T, K]."""
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, others)


def plan(
    key: Array, tour: Tour, search: SearchMap, robot: Position, sensor: SensorParams, area: Array
) -> Plan:
    """Improve the current tour by local search, or replace it by a better one.

    Args:
        key: random key, consumed.
        tour: leaves [K], the current tour.
        search: search map.
        robot: believed position.
        sensor: sensing range and field of view.
        area: f32[4], operating area, metres.
    """
    chex.assert_shape([tour.x, tour.y, area], [(NUM_STOPS,), (NUM_STOPS,), (4,)])
    chex.assert_equal_shape([search.x, search.unanchored, search.anchored, search.partner_x])
    chex.assert_rank([*robot, sensor.range_max, sensor.field_of_view], 0)
    chex.assert_type([tour.x, search.unanchored, area], float)
    start = _drop_reached(_drop_reached(tour, robot), robot)
    first = _prepend(start, greedy(search, robot, sensor.range_max, area))
    num_views = (area[1] - area[0]) * (area[3] - area[2]) / (jnp.pi * sensor.range_max**2)
    rounds = jnp.clip(jnp.ceil(num_views / _VIEWS_PER_ROUND), _MIN_ROUNDS, _MAX_ROUNDS)
    # As many initial tours as moves, so that one program evaluates both.
    first = jax.tree.map(lambda leaf: leaf[np.minimum(np.arange(NUM_CHANGES), NUM_GREEDY)], first)

    def improve(index: Array, carry: tuple[Tour, Array]) -> tuple[Tour, Array]:
        """Keep the best tour and evaluate moves of it; in round 0, the initial tours."""
        tours, cost = carry
        idx = jnp.argmin(cost)
        best = Tour(x=tours.x[idx], y=tours.y[idx])
        changed = random_moves(jax.random.fold_in(key, index), best, search, area)
        tried = jax.tree.map(lambda a, b: jnp.where(index == 0, a, b), first, changed)
        if search.forbidden is not None:
            is_out = jnp.where(index == 0, np.arange(NUM_CHANGES) > 0, _IS_KEPT_OUT)[:, None]
            x, y = keep_out(tried.x, tried.y, search.forbidden, sensor.range_max, area)
            tried = Tour(x=jnp.where(is_out, x, tried.x), y=jnp.where(is_out, y, tried.y))
        new_cost = latency(tried, search, robot, sensor, area)
        if search.forbidden is not None:
            stop_cost = jnp.sum(cost_at(tried.x, tried.y, search.forbidden), axis=1)
            new_cost = new_cost + jnp.sum(search.mass) * stop_cost
        return _prepend(best, tried), jnp.append(cost[idx], new_cost)

    # Nothing has been evaluated yet: placeholders of infinite cost.
    placeholders = jax.tree.map(lambda a: jnp.tile(a, (NUM_CHANGES + 1, 1)), start)
    costs = jnp.full(NUM_CHANGES + 1, jnp.inf)
    last = rounds.astype(jnp.int32) + 1
    tours, cost = jax.lax.fori_loop(0, last, improve, (placeholders, costs))
    mass, anchored = jnp.sum(search.mass), jnp.sum(search.anchored)
    return Plan(tours=tours, latency=cost, mass=mass, anchored=anchored, ordered=search.ordered)
