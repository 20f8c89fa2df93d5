"""The way that finds things soonest: tours improved step by step (section 3.4; ours).

Each decision starts from the tour under way and from greedy tours over a lattice of viewpoints, and
improves the best, that of least ``latency``, by a few rounds of random changes: move a stop, put
one in, take one out, turn a stretch round. As the tour under way is among the candidates, it is
left only for one that costs less. Stops near what is forbidden cost the way in and out
(``constraints``).
"""

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import SensorParams
from jaxlangnav.numerics import batching
from jaxlangnav.planner.constraints import keep_out, price_of_stop
from jaxlangnav.planner.latency import NUM_STOPS, Tour, is_underfoot, latency
from jaxlangnav.planner.search import LATTICE, SearchMap, grid, visibility
from jaxlangnav.pytree import pytree

NUM_GREEDY = 3
"""Greedy tours drafted at each decision."""
NUM_CHANGES = 8
"""Changes tried in a round."""
_MOVE, _MOVE_FAR, _INSERT, _REVERSE, _REMOVE = range(5)


def greedy(
    search: SearchMap, robot_x: Array, robot_y: Array, range_max: Array, area: Array
) -> Tour:
    """Draft tours over the lattice of viewpoints: always the most mass per metre next.

    They are leaves [NUM_GREEDY, K], and start at different viewpoints; arguments as for ``plan``.
    """
    view_x, view_y = grid(area, LATTICE)
    sees = visibility(view_x, view_y, search, range_max, area)
    metres = search.terrain.travel.metres
    between = metres(view_x[:, None], view_y[:, None], view_x[None, :], view_y[None, :])
    distance = metres(robot_x, robot_y, view_x, view_y)
    # A metre is added to each way: what can be had for nothing is not worth all.
    _, first = jax.lax.top_k((sees @ search.mass) / (distance + 1.0), NUM_GREEDY)

    def go_on(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        here, mass = carry
        there = jnp.argmax((mass @ sees.T) / (between[here] + 1.0), axis=1)
        return (there, mass * (1.0 - sees[there])), there

    left = search.mass[None, :] * (1.0 - sees[first])
    _, others = jax.lax.scan(go_on, (first, left), length=NUM_STOPS - 1)
    chosen = jnp.concatenate([first[None], others]).T
    return Tour(x=view_x[chosen], y=view_y[chosen])


def change(key: Array, tour: Tour, search: SearchMap, area: Array) -> Tour:
    """Change a tour, leaves [K], in NUM_CHANGES ways at random, leaves [NUM_CHANGES, K].

    New stops are drawn where mass is, and stay in the area f32[4].
    """
    uniform = batching.uniforms(key[None], 5 * NUM_CHANGES).reshape(5, NUM_CHANGES)
    kind = (jnp.arange(NUM_CHANGES) % 5)[:, None]
    place = jnp.arange(NUM_STOPS)[None, :]
    one, other = jnp.floor(uniform[:2] * NUM_STOPS).astype(jnp.int32)[:, :, None]
    low, high = jnp.minimum(one, other), jnp.maximum(one, other)
    inserted = jnp.where(place > one, place - 1, place)
    reversed_ = jnp.where((place >= low) & (place <= high), low + high - place, place)
    removed = jnp.where(place >= one, jnp.minimum(place + 1, NUM_STOPS - 1), place)
    kinds = [kind == _INSERT, kind == _REVERSE, kind == _REMOVE]
    source = jnp.select(kinds, [inserted, reversed_, removed], place)
    cumulative = jnp.cumsum(search.mass)
    drawn = jnp.sum(cumulative[None, :] <= (uniform[2] * cumulative[-1])[:, None], axis=1)
    drawn = jnp.minimum(drawn, cumulative.shape[0] - 1)[:, None]
    length = (0.3 * 10.0 ** uniform[3])[:, None]
    angle = (2.0 * jnp.pi * uniform[4])[:, None]
    is_new = ((kind == _INSERT) & (place == one)) | ((kind == _REMOVE) & (place == NUM_STOPS - 1))
    is_moved = (kind <= _MOVE_FAR) & (place == one)

    def rearrange(stops: Array, cells: Array, step: Array, least: Array, most: Array) -> Array:
        stops = jnp.where(is_new, cells[drawn], stops[source])
        return jnp.clip(stops + jnp.where(is_moved, step, 0.0), least, most)

    return Tour(
        x=rearrange(tour.x, search.x, length * jnp.cos(angle), area[0], area[1]),
        y=rearrange(tour.y, search.y, length * jnp.sin(angle), area[2], area[3]),
    )


NUM_ROUNDS = 3
"""Rounds of changes at each decision."""
_IS_OUT = np.arange(NUM_CHANGES) % 2 == 1
"""Of the changes: those whose stops are put outside the berths of what is forbidden. A draft's are,
unless it is under way."""


@pytree
class Plan:
    """The candidates of the last round; T = NUM_CHANGES + 1, the best one before it first."""

    tours: Tour  # leaves [T, K]
    latency: Array  # f32[T] expected metres until found, times the mass
    mass: Array  # f32[] expected number of things still to be found
    anchored: Array  # f32[] of them, those that hang on an observed object


def best_tour(plan: Plan, value: Array) -> Tour:
    """Take, of T tours, the one whose first stop is valued most by the first T values f32[A]."""
    index = jnp.argmax(value[: plan.latency.shape[0]])
    return Tour(x=plan.tours.x[index], y=plan.tours.y[index])


def no_tour(x: Array, y: Array) -> Tour:
    """Build the tour of a robot that has not planned yet: it has arrived everywhere."""
    return Tour(x=jnp.full(NUM_STOPS, x), y=jnp.full(NUM_STOPS, y))


def _drop_reached(tour: Tour, robot_x: Array, robot_y: Array) -> Tour:
    """Drop the first stop once the robot is there; the last one is repeated."""
    is_there = is_underfoot(tour.x[0], tour.y[0], robot_x, robot_y)
    later = jax.tree.map(lambda stops: jnp.append(stops[1:], stops[-1]), tour)
    return jax.tree.map(lambda new, old: jnp.where(is_there, new, old), later, tour)


def _before(first: Tour, others: Tour) -> Tour:
    """Put a tour, leaves [K], before others, leaves [T, K]."""
    return jax.tree.map(lambda one, more: jnp.concatenate([one[None], more]), first, others)


def plan(
    key: Array,
    tour: Tour,
    search: SearchMap,
    robot_x: Array,
    robot_y: Array,
    sensor: SensorParams,
    area: Array,
) -> Plan:
    """Improve the tour under way, or leave it for a better one.

    Args:
        key: random key, consumed.
        tour: leaves [K], the tour under way.
        search: where looking is worth while.
        robot_x: f32[], metres, map frame.
        robot_y: f32[], metres.
        sensor: how far and how wide one sees.
        area: f32[4], operating area, metres.
    """
    chex.assert_shape([tour.x, tour.y, area], [(NUM_STOPS,), (NUM_STOPS,), (4,)])
    chex.assert_equal_shape([search.x, search.unanchored, search.anchored, search.partner_x])
    chex.assert_rank([robot_x, robot_y, sensor.range_max, sensor.field_of_view], 0)
    chex.assert_type([tour.x, search.unanchored, area], float)
    here = _drop_reached(_drop_reached(tour, robot_x, robot_y), robot_x, robot_y)
    drafts = _before(here, greedy(search, robot_x, robot_y, sensor.range_max, area))
    keys = jax.random.split(key, NUM_ROUNDS)
    # As many drafts as changes: one program weighs them all.
    drafts = jax.tree.map(lambda leaf: leaf[np.minimum(np.arange(NUM_CHANGES), NUM_GREEDY)], drafts)

    def improve(index: Array, carry: tuple[Tour, Array]) -> tuple[Tour, Array]:
        """Keep the best tour and weigh changes of it; at first, the drafts."""
        tours, cost = carry
        least = jnp.argmin(cost)
        best = Tour(x=tours.x[least], y=tours.y[least])
        changed = change(keys[index - 1], best, search, area)
        tried = jax.tree.map(lambda one, other: jnp.where(index == 0, one, other), drafts, changed)
        if search.forbidden is not None:
            is_out = jnp.where(index == 0, np.arange(NUM_CHANGES) > 0, _IS_OUT)[:, None]
            x, y = keep_out(tried.x, tried.y, search.forbidden, sensor.range_max, area)
            tried = Tour(x=jnp.where(is_out, x, tried.x), y=jnp.where(is_out, y, tried.y))
        weighed = latency(tried, search, robot_x, robot_y, sensor, area)
        if search.forbidden is not None:
            stops = jnp.sum(price_of_stop(tried.x, tried.y, search.forbidden), axis=1)
            weighed = weighed + jnp.sum(search.mass) * stops
        return _before(best, tried), jnp.append(cost[least], weighed)

    # Nothing has been weighed yet: the first best is any of those that cost too much to be kept.
    untried = jax.tree.map(lambda one: jnp.tile(one, (NUM_CHANGES + 1, 1)), here)
    costs = jnp.full(NUM_CHANGES + 1, jnp.inf)
    tours, cost = jax.lax.fori_loop(0, NUM_ROUNDS + 1, improve, (untried, costs))
    mass, anchored = jnp.sum(search.mass), jnp.sum(search.anchored)
    return Plan(tours=tours, latency=cost, mass=mass, anchored=anchored)
