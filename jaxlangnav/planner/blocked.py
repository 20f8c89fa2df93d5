"""Progress monitoring: follows walls not on the map, abandons unreachable waypoints (ours).

If the robot does not move towards a waypoint for a while, it follows the wall that must be there:
it steps aside, then past it, and tries again (a Bug algorithm without touch, after Lumelsky and
Stepanov, 1987), to the other side where it cannot step aside either. After several such stalls the
waypoint is abandoned too: nodes near it are closed for some time, so that another path is tried.
After many of them the robot is blocked.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner.graph import Nodes
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.terrain.view import Position, rotate

NUM_CLOSED = 4
"""Number of abandoned waypoints that are stored; the oldest is dropped first."""
_MIN_MOVED = 0.1  # metres of motion that count as progress
_CLOSE_RADIUS = 0.75  # metres around an abandoned waypoint within which nodes are closed
_CLOSED_CYCLES = 25  # cycles for which nodes stay closed
_NUM_TRIES = 4  # stalls before a waypoint is abandoned
_ASIDE = 1.5  # metres of a sidestep, across the way to the waypoint
_BACK = 0.9  # metres back from the stall at its end, as a wall may stand askew
_BEYOND = 1.5  # metres beyond the stall, from where the robot makes for its waypoint again
_REACHED = 0.3  # metres from the end of a leg at which it has been made
_MIN_ASIDE = 0.6  # metres between two stalls, below which the other side is tried
_PASSED = 5.0  # metres from the last stall beyond which an obstacle has been passed


@pytree
class ProgressMonitor:
    """State of progress monitoring."""

    x: Array  # f32[] metres, map frame: position at the last progress
    y: Array  # f32[]
    waited: Array  # i32[] cycles since then
    closed_x: Array  # f32[NUM_CLOSED] metres, map frame: abandoned waypoints, latest first
    closed_y: Array  # f32[NUM_CLOSED]
    closed_for: Array  # i32[NUM_CLOSED] remaining cycles of their closure
    num_stalls: Array  # i32[] number of stalls on the way past one obstacle, in this task
    stall_x: Array  # f32[] metres, map frame: the last of them
    stall_y: Array  # f32[]
    stall_heading: Array  # f32[] radians, map frame: towards the waypoint then
    side: Array  # f32[] of a sidestep: 1 to the left, −1 to the right
    leg: Array  # i32[] of a sidestep: 1 aside, 2 past the place of the stall, 0 none

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
        num_stalls=jnp.int32(0),
        stall_x=pose[0],
        stall_y=pose[1],
        stall_heading=pose[2],
        side=jnp.float32(-1.0),
        leg=jnp.int32(0),
    )


def sidestep(monitor: ProgressMonitor) -> Position:
    """Compute the end of the current leg of a sidestep, f32[] x and y, metres, map frame."""
    left, ahead = _ASIDE * monitor.side, jnp.where(monitor.leg == 1, -_BACK, _BEYOND)
    x, y = rotate(ahead, left, monitor.stall_heading)
    return monitor.stall_x + x, monitor.stall_y + y


def open_nodes(nodes: Nodes, monitor: ProgressMonitor) -> Nodes:
    """Close the nodes near abandoned waypoints."""
    offset_x = nodes.x[:, None] - monitor.closed_x[None]
    offset_y = nodes.y[:, None] - monitor.closed_y[None]
    is_near = offset_x * offset_x + offset_y * offset_y < _CLOSE_RADIUS**2
    is_closed = jnp.any(is_near & (monitor.closed_for > 0)[None], axis=1)
    return replace(nodes, is_node=nodes.is_node & ~is_closed)


def update_progress(
    monitor: ProgressMonitor,
    waypoint: Position,
    robot: Position,
    is_driving: Array,
    *,
    may_sidestep: Array,
    patience: int,
) -> ProgressMonitor:
    """Update progress monitoring; step aside if the robot has not moved for a while.

    Limits: a robot that is not driving never steps aside and never abandons a waypoint.

    Args:
        monitor: before this cycle.
        waypoint: f32[] x and y, current waypoint, metres, map frame.
        robot: f32[] x and y, believed position.
        is_driving: bool[], it drives to a waypoint.
        may_sidestep: bool[], nothing is to be kept away from.
        patience: cycles without progress that are a stall.
    """
    robot_x, robot_y = robot
    has_moved = jnp.hypot(robot_x - monitor.x, robot_y - monitor.y) > _MIN_MOVED
    waited = jnp.where(is_driving & ~has_moved, monitor.waited + 1, 0)
    is_stalled = waited > patience
    gone = jnp.hypot(robot_x - monitor.stall_x, robot_y - monitor.stall_y)
    num_before = jnp.where(gone > _PASSED, 0, monitor.num_stalls)
    is_stuck = (num_before == 0) | (gone < _MIN_ASIDE)
    heading = jnp.arctan2(waypoint[1] - robot_y, waypoint[0] - robot_x)
    side_x, side_y = sidestep(monitor)
    is_there = jnp.hypot(robot_x - side_x, robot_y - side_y) < _REACHED
    leg = jnp.where(is_there, jnp.where(monitor.leg == 1, 2, 0), monitor.leg)
    is_abandoned = is_stalled & (num_before >= _NUM_TRIES)
    is_new = is_abandoned & (jnp.arange(NUM_CLOSED) == 0)

    def push(old: Array, new: Array) -> Array:
        return jnp.where(is_new, new, jnp.where(is_abandoned, jnp.roll(old, 1), old))

    return ProgressMonitor(
        x=jnp.where(has_moved | ~is_driving, robot_x, monitor.x),
        y=jnp.where(has_moved | ~is_driving, robot_y, monitor.y),
        waited=jnp.where(is_stalled, 0, waited).astype(jnp.int32),
        closed_x=push(monitor.closed_x, waypoint[0]),
        closed_y=push(monitor.closed_y, waypoint[1]),
        closed_for=push(jnp.maximum(monitor.closed_for - 1, 0), jnp.int32(_CLOSED_CYCLES)),
        num_stalls=num_before + is_stalled.astype(jnp.int32),
        stall_x=jnp.where(is_stalled, robot_x, monitor.stall_x),
        stall_y=jnp.where(is_stalled, robot_y, monitor.stall_y),
        stall_heading=jnp.where(is_stalled, heading, monitor.stall_heading),
        side=jnp.where(is_stalled & is_stuck, -monitor.side, monitor.side),
        leg=jnp.where(is_stalled, 1, leg) * (is_driving & may_sidestep),
    )
