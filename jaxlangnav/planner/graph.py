"""The planning graph: visited positions, frontiers, observed objects (eq. 9).

    A_t = F ∪ V ∪ {a_stop}

Frontiers lie where explored and unexplored cells of the operating area meet. "Unexplored" is
relative to the least explored cell, so that once the whole area has been observed, the least
observed cells become the frontier and no cell is excluded forever.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.pytree import pytree
from jaxlangnav.semantic_map.coverage import Coverage, cell_centres

FRONTIER, VISITED, OBJECT_NODE = range(3)
"""Types of nodes; the first is also the type of a policy's custom waypoints."""


@pytree
class Nodes:
    """Candidate waypoints; A = blocks² (or custom ones) + visited + objects, in this order."""

    x: Array  # f32[A] metres, map frame
    y: Array  # f32[A]
    is_node: Array  # bool[A] valid entry
    kind: Array  # i32[A] FRONTIER, VISITED or OBJECT_NODE


@pytree
class Visited:
    """Ring buffer of positions that the robot has visited."""

    x: Array  # f32[V] metres, map frame
    y: Array  # f32[V]
    is_node: Array  # bool[V] valid entry
    count: Array  # i32[] number of positions added so far


def empty_visited(num_visited: int) -> Visited:
    """Build the empty ring buffer of visited positions."""
    zero = jnp.zeros(num_visited, jnp.float32)
    return Visited(x=zero, y=zero, is_node=jnp.zeros(num_visited, bool), count=jnp.int32(0))


def add_visited(visited: Visited, x: Array, y: Array, spacing: Array) -> Visited:
    """Add the robot's position f32[] as a node unless one is nearer than ``spacing`` metres.

    A full buffer overwrites its oldest node.
    """
    squared = (visited.x - x) ** 2 + (visited.y - y) ** 2
    is_known = jnp.any(visited.is_node & (squared < spacing * spacing))
    size = visited.x.shape[0]
    entry = (jnp.arange(size) == visited.count % size) & ~is_known
    return Visited(
        x=jnp.where(entry, x, visited.x),
        y=jnp.where(entry, y, visited.y),
        is_node=visited.is_node | entry,
        count=visited.count + (~is_known).astype(jnp.int32),
    )


def unexplored_cells(coverage: Coverage, frontier_miss: Array) -> Array:
    """Mark the cells that count as unexplored, bool[G, G]."""
    return coverage.log_miss > jnp.max(coverage.log_miss) + jnp.log(frontier_miss)


def frontiers(
    coverage: Coverage, num_blocks: int, frontier_miss: Array
) -> tuple[Array, Array, Array]:
    """Cluster frontier cells into one node per block of the area.

    Args:
        coverage: coverage map.
        num_blocks: blocks per side; must divide the cells per side.
        frontier_miss: f32[], fraction of the largest miss probability that counts as unexplored.

    Returns:
        x, y f32[blocks²] metres, map frame: mean of the block's frontier cells; bool[blocks²].
    """
    unexplored = unexplored_cells(coverage, frontier_miss)
    # Edges of the operating area are no frontier: neighbours outside count as unexplored.
    padded = jnp.pad(~unexplored, 1)
    is_adjacent = padded[2:, 1:-1] | padded[:-2, 1:-1] | padded[1:-1, 2:] | padded[1:-1, :-2]
    frontier = (unexplored & is_adjacent).astype(jnp.float32)
    centre_x, centre_y = cell_centres(coverage)

    def by_block(values: Array) -> Array:
        size = values.shape[0] // num_blocks
        return values.reshape(num_blocks, size, num_blocks, size).sum(axis=(1, 3)).reshape(-1)

    count = by_block(frontier)
    inverse_count = 1.0 / jnp.maximum(count, 1.0)
    x = by_block(frontier * centre_x[None, :]) * inverse_count
    return x, by_block(frontier * centre_y[:, None]) * inverse_count, count > 0


def known_nodes(visited: Visited, x: Array, y: Array, is_object: Array) -> Nodes:
    """Collect the waypoints common to all policies: visited positions and goal positions [O]."""
    sizes = visited.x.shape[0], x.shape[0]
    return Nodes(
        x=jnp.concatenate([visited.x, x]),
        y=jnp.concatenate([visited.y, y]),
        is_node=jnp.concatenate([visited.is_node, is_object]),
        kind=jnp.asarray(np.repeat(np.array([VISITED, OBJECT_NODE], np.int32), sizes)),
    )


def prepend_nodes(x: Array, y: Array, is_node: Array, nodes: Nodes) -> Nodes:
    """Prepend frontiers [K], or a policy's custom waypoints, to other nodes [A] (eq. 9)."""
    leading = Nodes(x=x, y=y, is_node=is_node, kind=jnp.full(x.shape, FRONTIER, jnp.int32))
    return jax.tree.map(lambda *both: jnp.concatenate(both), leading, nodes)
