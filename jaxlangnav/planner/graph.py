"""The graph a robot plans on: visited places, frontiers, objects it has seen (eq. 9).

    A_t = F ∪ V ∪ {a_stop}

Frontiers lie where explored and unexplored cells of the operating area meet. "Unexplored" is
relative to the least explored cell, so that once everything has been looked at, what has been
looked at least becomes the frontier and nothing is written off for good.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.pytree import pytree
from jaxlangnav.semantic_map.coverage import Coverage, cell_centres

FRONTIER, VISITED, OBJECT_NODE = range(3)
"""Kinds of nodes; the first is that of any place that a policy has thought of."""


@pytree
class Nodes:
    """Candidate waypoints; A = blocks² (or a policy's own) + visited + objects seen, in order."""

    x: Array  # f32[A] metres, map frame
    y: Array  # f32[A]
    is_node: Array  # bool[A]
    kind: Array  # i32[A] FRONTIER, VISITED or OBJECT


@pytree
class Visited:
    """Places the robot has been, oldest overwritten first."""

    x: Array  # f32[V] metres, map frame
    y: Array  # f32[V]
    is_node: Array  # bool[V]
    count: Array  # i32[] nodes ever entered


def nowhere(num_visited: int) -> Visited:
    """Build the empty list of visited nodes."""
    zero = jnp.zeros(num_visited, jnp.float32)
    return Visited(x=zero, y=zero, is_node=jnp.zeros(num_visited, bool), count=jnp.int32(0))


def visit(visited: Visited, x: Array, y: Array, spacing: Array) -> Visited:
    """Enter the robot's place f32[] as a node unless one is nearer than ``spacing`` metres.

    A full list overwrites its oldest.
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
    """Tell which cells count as unexplored, bool[G, G]."""
    worst = jnp.max(coverage.log_miss)
    return coverage.log_miss > worst + jnp.log(frontier_miss)


def frontiers(
    coverage: Coverage, num_blocks: int, frontier_miss: Array
) -> tuple[Array, Array, Array]:
    """Gather frontier cells into one node per block of the area.

    Args:
        coverage: where the robot has looked.
        num_blocks: blocks a side; must divide the cells a side.
        frontier_miss: f32[], share of the worst miss probability that counts as unexplored.

    Returns:
        x, y f32[blocks²] metres, map frame: mean of the block's frontier cells; bool[blocks²].
    """
    unexplored = unexplored_cells(coverage, frontier_miss)
    explored = ~unexplored
    # Edges of the operating area are no frontier: neighbours outside count as unexplored.
    padded = jnp.pad(explored, 1)
    beside = padded[2:, 1:-1] | padded[:-2, 1:-1] | padded[1:-1, 2:] | padded[1:-1, :-2]
    frontier = (unexplored & beside).astype(jnp.float32)
    centre_x, centre_y = cell_centres(coverage)

    def by_block(values: Array) -> Array:
        size = values.shape[0] // num_blocks
        return values.reshape(num_blocks, size, num_blocks, size).sum(axis=(1, 3)).reshape(-1)

    count = by_block(frontier)
    share = 1.0 / jnp.maximum(count, 1.0)
    x = by_block(frontier * centre_x[None, :]) * share
    return x, by_block(frontier * centre_y[:, None]) * share, count > 0


def known_nodes(visited: Visited, x: Array, y: Array, is_object: Array) -> Nodes:
    """Collect the waypoints that every policy is shown: places visited and goal places [O]."""
    sizes = visited.x.shape[0], x.shape[0]
    return Nodes(
        x=jnp.concatenate([visited.x, x]),
        y=jnp.concatenate([visited.y, y]),
        is_node=jnp.concatenate([visited.is_node, is_object]),
        kind=jnp.asarray(np.repeat(np.array([VISITED, OBJECT_NODE], np.int32), sizes)),
    )


def put_first(x: Array, y: Array, is_node: Array, nodes: Nodes) -> Nodes:
    """Put frontiers [K], or what a policy has in their place, before other nodes [A] (eq. 9)."""
    kind = jnp.full(x.shape, FRONTIER, jnp.int32)
    first = Nodes(x=x, y=y, is_node=is_node, kind=kind)
    return jax.tree.map(lambda *both: jnp.concatenate(both), first, nodes)
