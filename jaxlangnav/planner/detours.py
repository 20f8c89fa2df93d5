"""Cheapest ways round what a constraint forbids: shortest paths on a visibility graph (ours).

The graph has the robot, the nodes, corners about each forbidden thing, just outside its berth, and
the middle between any two of them. An edge costs its metres and what ``constraints`` charges along
it, to a place also what stopping there costs (``price_of_stop``).
"""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.numerics.batching import skip_unless_any
from jaxlangnav.planner.blocked import open_nodes
from jaxlangnav.planner.constraints import (
    MOST_FORBIDDEN,
    NUM_TURNS,
    RADIUS,
    Forbidden,
    price_along,
    price_of_stop,
)
from jaxlangnav.planner.graph import VISITED, Nodes
from jaxlangnav.planner.situation import Situation
from jaxlangnav.terrain import Eye
from jaxlangnav.terrain.view import NEVER

_MOST_CORNERS = 12  # corners of one way
_UNDERFOOT = 0.1  # metres from a corner that count as having been there
_TURNS = np.linspace(0.0, 2.0 * np.pi, NUM_TURNS, endpoint=False, dtype=np.float32)
_PAIRS = np.array(list(itertools.combinations(range(MOST_FORBIDDEN), 2))).T


def _corners(things: Forbidden, situation: Situation) -> Nodes:
    """Place corners about things and between them, where the robot may go and is not yet."""
    first, second = _PAIRS
    ring_x = things.x[:, None] + RADIUS * np.cos(_TURNS)[None]
    ring_y = things.y[:, None] + RADIUS * np.sin(_TURNS)[None]
    x = jnp.append(ring_x, 0.5 * (things.x[first] + things.x[second]))
    y = jnp.append(ring_y, 0.5 * (things.y[first] + things.y[second]))
    is_thing = things.price > 0.0
    is_corner = jnp.append(jnp.repeat(is_thing, NUM_TURNS), is_thing[first] & is_thing[second])
    area = situation.belief.coverage.area
    is_corner &= (x >= area[0]) & (x <= area[1]) & (y >= area[2]) & (y <= area[3])
    squared = (x - situation.robot_x) ** 2 + (y - situation.robot_y) ** 2
    is_corner &= squared > _UNDERFOOT**2
    nodes = Nodes(x=x, y=y, is_node=is_corner, kind=jnp.full(x.shape, VISITED))
    return open_nodes(nodes, situation.way)


def _cheapest(x: Array, y: Array, spare: Array, things: Forbidden, situation: Situation) -> Array:
    """Compute shortest paths (Bellman and Ford), f32[3, A]: longer by, first corner's x, y."""
    corners, terrain = _corners(things, situation), situation.belief.terrain
    number = corners.x.shape[0]
    from_x = jnp.append(situation.robot_x, corners.x)[:, None]
    from_y = jnp.append(situation.robot_y, corners.y)[:, None]
    to_x, to_y = jnp.append(corners.x, x)[None], jnp.append(corners.y, y)[None]
    # A thing is gone up to, not into.
    away = jnp.sqrt((to_x - from_x) ** 2 + (to_y - from_y) ** 2 + 1e-12)
    length = jnp.maximum(away - jnp.append(jnp.zeros(number), spare)[None], 0.0)
    part = length / away
    end_x, end_y = from_x + part * (to_x - from_x), from_y + part * (to_y - from_y)
    # Out of a berth that it stops in it must come again: a goal in one is reached from outside.
    stop = price_of_stop(end_x[:, number:], end_y[:, number:], things)
    price = price_along(from_x, from_y, end_x, end_y, things).at[:, number:].add(stop)
    is_shut = ~terrain.view.sees(Eye(from_x, from_y, jnp.float32(NEVER)), to_x, to_y)
    is_shut |= ~jnp.append(corners.is_node, jnp.ones(x.shape, bool))[None]
    edge = jnp.where(is_shut, NEVER, length + price)

    def relax(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        """Come to each corner by the best of all others."""
        cost, first = carry
        ways = cost[:, None] + edge[1:, :number]
        best = jnp.argmin(ways, axis=0)
        least = jnp.min(ways, axis=0)
        return jnp.minimum(cost, least), jnp.where(least < cost, first[best], first)

    start = edge[0, :number], jnp.arange(number)
    cost, first = jax.lax.fori_loop(0, _MOST_CORNERS, relax, start)
    ways = cost[:, None] + edge[1:, number:]
    least, corner = jnp.min(ways, axis=0), first[jnp.argmin(ways, axis=0)]
    # Straight on, walls are gone round as the terrain has it.
    direct, straight = price[0, number:] + length[0, number:], length[0, number:]
    is_round, longer = least < direct, jnp.minimum(direct, least) - straight
    first_x = jnp.where(is_round, corners.x[corner], x)
    return jnp.stack([longer, first_x, jnp.where(is_round, corners.y[corner], y)])


def detours(situation: Situation, x: Array, y: Array, spare: Array) -> tuple[Array, Array, Array]:
    """Find the cheapest ways to places round what is forbidden.

    Places are f32[A] metres, map frame; to be ``spare`` metres short of each is enough. f32[A]
    each: metres by which the ways cost more than the straight line, and x and y of their first
    corner, or of the place itself. Limits:
    with nothing forbidden they are straight, and nothing is computed; a place within the berth has
    a finite price. Corners behind walls are not made use of.
    """
    things = situation.forbidden
    is_meant = jnp.broadcast_to(jnp.any(things.price > 0.0), x.shape)
    places = jnp.stack([x, y, spare])

    def weigh(records: tuple[Array, Forbidden]) -> Array:
        (x, y, spare), things = records
        return _cheapest(x, y, spare, things, situation)

    longer, first_x, first_y = skip_unless_any(is_meant, weigh, (places, things))
    return longer, jnp.where(is_meant, first_x, x), jnp.where(is_meant, first_y, y)
