"""Initial tours and random changes of tours, for local search (section 3.4; ours)."""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.numerics import batching
from jaxlangnav.planner.latency import NUM_STOPS, Tour
from jaxlangnav.planner.search import SearchMap, viewpoints, visibility

NUM_GREEDY = 3
"""Greedy tours drafted at each decision."""
NUM_CHANGES = 8
"""Changes tried in a round."""
_MOVE, _MOVE_FAR, _INSERT, _REVERSE, _REMOVE = range(5)


def greedy(
    search: SearchMap, robot_x: Array, robot_y: Array, range_max: Array, area: Array
) -> Tour:
    """Draft tours over the lattice of viewpoints: always the most mass per metre next.

    They are leaves [NUM_GREEDY, K], and start at different viewpoints.

    Args:
        search: where looking is worth while.
        robot_x: f32[], metres, map frame.
        robot_y: f32[], metres.
        range_max: f32[], sensing range, metres.
        area: f32[4], operating area, metres.
    """
    view_x, view_y = viewpoints(area)
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
