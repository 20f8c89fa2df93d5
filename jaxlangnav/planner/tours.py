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
from jaxlangnav.planner.constraints import keep_out, price_of_stop
from jaxlangnav.planner.latency import NUM_STOPS, Tour, is_underfoot, latency
from jaxlangnav.planner.search import SearchMap
from jaxlangnav.planner.tour_proposals import NUM_CHANGES, NUM_GREEDY, change, greedy
from jaxlangnav.pytree import pytree

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
    hung: Array  # f32[] of them, those that hang on an observed object


def best_tour(plan: Plan, value: Array) -> Tour:
    """Take, of T tours, the one whose first stop is valued most by the first T values f32[A]."""
    index = jnp.argmax(value[: plan.latency.shape[0]])
    return Tour(x=plan.tours.x[index], y=plan.tours.y[index])


def no_tour(x: Array, y: Array) -> Tour:
    """Build the tour of a robot that has not planned yet: it has arrived everywhere."""
    stay = jnp.ones(NUM_STOPS, jnp.float32)
    return Tour(x=stay * x, y=stay * y)


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
    chex.assert_equal_shape([search.x, search.y, search.free, search.hung, search.partner_x])
    chex.assert_rank([robot_x, robot_y, sensor.range_max, sensor.field_of_view], 0)
    chex.assert_type([tour.x, search.free, area], float)
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
    return Plan(tours=tours, latency=cost, mass=jnp.sum(search.mass), hung=jnp.sum(search.hung))
