"""Progress monitoring: abandons waypoints that are unreachable (ours).

If the robot does not move towards a waypoint for a while, the waypoint is abandoned: nodes near it
are closed for some time, so that another path is tried. If several in a row are abandoned, the
robot is blocked.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner.graph import Nodes
from jaxlangnav.pytree import pytree, replace

NUM_CLOSED = 4
"""Number of abandoned waypoints that are stored; the oldest is dropped first."""
_MIN_MOVED = 0.1  # metres of motion that count as progress
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
    num_closed: Array  # i32[] number of waypoints abandoned for this task

    @property
    def is_news(self) -> Array:
        """Whether a waypoint was abandoned in the last cycle, bool[]."""
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


def open_nodes(nodes: Nodes, monitor: ProgressMonitor) -> Nodes:
    """Close the nodes near abandoned waypoints."""
    offset_x = nodes.x[:, None] - monitor.closed_x[None]
    offset_y = nodes.y[:, None] - monitor.closed_y[None]
    is_near = offset_x * offset_x + offset_y * offset_y < _CLOSE_RADIUS**2
    is_closed = jnp.any(is_near & (monitor.closed_for > 0)[None], axis=1)
    return replace(nodes, is_node=nodes.is_node & ~is_closed)


def update_progress(
    monitor: ProgressMonitor,
    waypoint: tuple[Array, Array],
    robot: tuple[Array, Array],
    is_driving: Array,
    *,
    patience: int,
) -> ProgressMonitor:
    """Update progress monitoring; abandon the waypoint if the robot has not moved for a while.

    Limits: a robot that is not driving never abandons a waypoint.

    Args:
        monitor: before this cycle.
        waypoint: f32[] x and y, current waypoint, metres, map frame.
        robot: f32[] x and y, believed position.
        is_driving: bool[], it drives to a waypoint.
        patience: cycles without progress after which a waypoint is abandoned.
    """
    robot_x, robot_y = robot
    has_moved = jnp.hypot(robot_x - monitor.x, robot_y - monitor.y) > _MIN_MOVED
    waited = jnp.where(is_driving & ~has_moved, monitor.waited + 1, 0)
    is_abandoned = waited > patience
    is_new = is_abandoned & (jnp.arange(NUM_CLOSED) == 0)

    def push(old: Array, new: Array) -> Array:
        shifted = jnp.where(is_abandoned, jnp.roll(old, 1), old)
        return jnp.where(is_new, new, shifted)

    remaining = jnp.maximum(monitor.closed_for - 1, 0)
    return ProgressMonitor(
        x=jnp.where(has_moved | ~is_driving, robot_x, monitor.x),
        y=jnp.where(has_moved | ~is_driving, robot_y, monitor.y),
        waited=jnp.where(is_abandoned, 0, waited).astype(jnp.int32),
        closed_x=push(monitor.closed_x, waypoint[0]),
        closed_y=push(monitor.closed_y, waypoint[1]),
        closed_for=push(remaining, jnp.int32(_CLOSED_CYCLES)),
        num_closed=monitor.num_closed + is_abandoned.astype(jnp.int32),
    )
