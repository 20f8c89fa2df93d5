"""Cheapest detours around keep-out zones: shortest paths on a visibility graph (ours).

Vertices are the robot, the nodes, corners around each forbidden object, just outside its keep-out
zone, and the midpoint of any two objects. An edge costs its length plus the cost of ``constraints``
along it, an edge to a node also the cost of stopping there (``cost_at``).
"""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.numerics.batching import skip_unless_any
from jaxlangnav.planner.blocked import open_nodes
from jaxlangnav.planner.constraints import (
    CORNER_RADIUS,
    MAX_ZONES,
    NUM_CORNERS,
    Zones,
    cost_along,
    cost_at,
)
from jaxlangnav.planner.graph import VISITED, Nodes
from jaxlangnav.planner.situation import Situation
from jaxlangnav.terrain import Eye
from jaxlangnav.terrain.view import LARGE

_MAX_CORNERS = 12  # maximum number of corners of a path
_ARRIVAL = 0.1  # metres from a corner within which it counts as reached
_ANGLES = np.linspace(0.0, 2.0 * np.pi, NUM_CORNERS, endpoint=False, dtype=np.float32)
_PAIRS = np.array(list(itertools.combinations(range(MAX_ZONES), 2))).T


def _corners(zones: Zones, situation: Situation) -> Nodes:
    """Build the corners around objects and between them that are in the area and not reached."""
    first, second = _PAIRS
    ring_x = zones.x[:, None] + CORNER_RADIUS * np.cos(_ANGLES)[None]
    ring_y = zones.y[:, None] + CORNER_RADIUS * np.sin(_ANGLES)[None]
    x = jnp.append(ring_x, 0.5 * (zones.x[first] + zones.x[second]))
    y = jnp.append(ring_y, 0.5 * (zones.y[first] + zones.y[second]))
    is_active = zones.cost > 0.0
    is_corner = jnp.append(jnp.repeat(is_active, NUM_CORNERS), is_active[first] & is_active[second])
    area = situation.belief.coverage.area
    is_corner &= (x >= area[0]) & (x <= area[1]) & (y >= area[2]) & (y <= area[3])
    is_corner &= (x - situation.robot_x) ** 2 + (y - situation.robot_y) ** 2 > _ARRIVAL**2
    nodes = Nodes(x=x, y=y, is_node=is_corner, kind=jnp.full(x.shape, VISITED))
    return open_nodes(nodes, situation.progress)


def _shortest(x: Array, y: Array, spare: Array, zones: Zones, situation: Situation) -> Array:
    """Compute shortest paths (Bellman-Ford), f32[3, A]: extra cost, first corner's x and y."""
    corners, terrain = _corners(zones, situation), situation.belief.terrain
    num_corners = corners.x.shape[0]
    from_x = jnp.append(situation.robot_x, corners.x)[:, None]
    from_y = jnp.append(situation.robot_y, corners.y)[:, None]
    to_x, to_y = jnp.append(corners.x, x)[None], jnp.append(corners.y, y)[None]
    # The path ends in front of an object, not inside it.
    distance = jnp.sqrt((to_x - from_x) ** 2 + (to_y - from_y) ** 2 + 1e-12)
    length = jnp.maximum(distance - jnp.append(jnp.zeros(num_corners), spare)[None], 0.0)
    fraction = length / distance
    end_x, end_y = from_x + fraction * (to_x - from_x), from_y + fraction * (to_y - from_y)
    # A robot that stops in a keep-out zone has to leave it again.
    exit_cost = cost_at(end_x[:, num_corners:], end_y[:, num_corners:], zones)
    zone_cost = cost_along(from_x, from_y, end_x, end_y, zones).at[:, num_corners:].add(exit_cost)
    is_blocked = ~terrain.view.sees(Eye(from_x, from_y, jnp.float32(LARGE)), to_x, to_y)
    is_blocked |= ~jnp.append(corners.is_node, jnp.ones(x.shape, bool))[None]
    edge = jnp.where(is_blocked, LARGE, length + zone_cost)

    def relax(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        """Relax the edges between corners."""
        cost, first = carry
        path_cost = cost[:, None] + edge[1:, :num_corners]
        best = jnp.argmin(path_cost, axis=0)
        min_cost = jnp.min(path_cost, axis=0)
        return jnp.minimum(cost, min_cost), jnp.where(min_cost < cost, first[best], first)

    start = edge[0, :num_corners], jnp.arange(num_corners)
    cost, first = jax.lax.fori_loop(0, _MAX_CORNERS, relax, start)
    path_cost = cost[:, None] + edge[1:, num_corners:]
    min_cost, corner = jnp.min(path_cost, axis=0), first[jnp.argmin(path_cost, axis=0)]
    # The direct path follows the terrain's geodesic around walls.
    direct, straight = zone_cost[0, num_corners:] + length[0, num_corners:], length[0, num_corners:]
    is_detour, extra = min_cost < direct, jnp.minimum(direct, min_cost) - straight
    first_x = jnp.where(is_detour, corners.x[corner], x)
    return jnp.stack([extra, first_x, jnp.where(is_detour, corners.y[corner], y)])


def detours(situation: Situation, x: Array, y: Array, spare: Array) -> tuple[Array, Array, Array]:
    """Find the cheapest paths to positions around keep-out zones.

    Positions are f32[A] metres, map frame; paths may end ``spare`` metres short of them. f32[A]
    each: cost in excess of the straight line, metres, and x and y of the first corner, or of the
    position itself. Corners behind walls are not used. Limits: without forbidden objects paths are
    straight, and nothing is computed; a position within a zone has a finite cost.
    """
    zones = situation.forbidden
    is_active = jnp.broadcast_to(jnp.any(zones.cost > 0.0), x.shape)

    def solve(records: tuple[Array, Array, Array, Zones]) -> Array:
        return _shortest(*records, situation)

    straight = jnp.stack([jnp.zeros_like(x), x, y])
    extra, first_x, first_y = skip_unless_any(is_active, solve, (x, y, spare, zones), straight)
    return extra, first_x, first_y
