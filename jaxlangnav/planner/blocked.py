"""Progress monitoring: waypoints given up as unreachable (ours).

A robot with a waypoint that does not move for a while gives the waypoint up: nodes near it are
closed for some time, so that another path is tried. If several in a row are given up, the robot is
blocked.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner.graph import Nodes
from jaxlangnav.pytree import pytree, replace

NUM_CLOSED = 4
"""Number of abandoned waypoints that are stored; the oldest is dropped first."""
_MIN_MOVED = 0.1  # metres that a robot has to move within its patience
_CLOSE_RADIUS = 0.75  # metres around an abandoned waypoint within which nodes are closed
_CLOSED_CYCLES = 25  # cycles for which nodes stay closed


@pytree
class ProgressMonitor:
    """State of progress monitoring."""

    x: Array  # f32[] metres, map frame: position at the last progress
    y: Array  # f32[]
    waited: Array  # i32[] cycles since then
    closed_x: Array  # f32[NUM_CLOSED] metres, map frame: abandoned waypoints, latest first
    closed_y: Array  # f32[NUM_CLOSED]
    closed_for: Array  # i32[NUM_CLOSED] remaining cycles of their closure
    num_closed: Array  # i32[] waypoints given up for this task

    @property
    def is_news(self) -> Array:
        """Whether a waypoint was given up in the last cycle, bool[]."""
        return self.closed_for[0] == _CLOSED_CYCLES


def init_progress(pose: Array) -> ProgressMonitor:
    """Build the initial state of progress monitoring at a pose f32[3]."""
    zero = jnp.zeros(NUM_CLOSED, jnp.float32)
    return ProgressMonitor(
        x=pose[0],
        y=pose[1],
        waited=jnp.int32(0),
        closed_x=zero,
        closed_y=zero,
        closed_for=jnp.zeros(NUM_CLOSED, jnp.int32),
        num_closed=jnp.int32(0),
    )


def open_nodes(nodes: Nodes, way: ProgressMonitor) -> Nodes:
    """Close the nodes near waypoints that have been given up."""
    offset_x = nodes.x[:, None] - way.closed_x[None]
    offset_y = nodes.y[:, None] - way.closed_y[None]
    is_near = offset_x * offset_x + offset_y * offset_y < _CLOSE_RADIUS**2
    is_closed = jnp.any(is_near & (way.closed_for > 0)[None], axis=1)
    return replace(nodes, is_node=nodes.is_node & ~is_closed)


def update_progress(
    way: ProgressMonitor,
    waypoint: tuple[Array, Array],
    robot: tuple[Array, Array],
    is_under_way: Array,
    *,
    patience: int,
) -> ProgressMonitor:
    """Update progress monitoring; give the waypoint up if the robot has not moved for a while.

    Limits: a robot that is not under way never gives a waypoint up.

    Args:
        way: before this cycle.
        waypoint: f32[] x and y, current waypoint, metres, map frame.
        robot: f32[] x and y, believed position.
        is_under_way: bool[], it has a waypoint.
        patience: cycles without progress after which a waypoint is given up.
    """
    robot_x, robot_y = robot
    has_moved = jnp.hypot(robot_x - way.x, robot_y - way.y) > _MIN_MOVED
    waited = jnp.where(is_under_way & ~has_moved, way.waited + 1, 0)
    gives_up = waited > patience
    is_new = gives_up & (jnp.arange(NUM_CLOSED) == 0)

    def push(old: Array, new: Array) -> Array:
        shifted = jnp.where(gives_up, jnp.roll(old, 1), old)
        return jnp.where(is_new, new, shifted)

    remaining = jnp.maximum(way.closed_for - 1, 0)
    return ProgressMonitor(
        x=jnp.where(has_moved | ~is_under_way, robot_x, way.x),
        y=jnp.where(has_moved | ~is_under_way, robot_y, way.y),
        waited=jnp.where(gives_up, 0, waited).astype(jnp.int32),
        closed_x=push(way.closed_x, waypoint[0]),
        closed_y=push(way.closed_y, waypoint[1]),
        closed_for=push(remaining, jnp.int32(_CLOSED_CYCLES)),
        num_closed=way.num_closed + gives_up.astype(jnp.int32),
    )
