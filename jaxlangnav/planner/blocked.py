"""Whether the robot gets on, and waypoints that it has given up as out of reach (ours).

A robot that is sent on and stays where it is for a while gives its waypoint up: nodes about it are
closed for some time, so that another way is tried. Where one after the other is given up, the way
is blocked.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner.graph import Nodes
from jaxlangnav.pytree import pytree, replace

NUM_CLOSED = 4
"""Waypoints given up that are remembered; the oldest is forgotten first."""
_LEAST_WAY = 0.1  # metres by which a robot that gets on has moved within its patience
_AROUND = 0.75  # metres about a waypoint given up in which nodes are closed
_CYCLES = 25  # cycles for which they are


@pytree
class ProgressMonitor:
    """Whether the robot gets on."""

    x: Array  # f32[] metres, map frame: where it last was when it had got on
    y: Array  # f32[]
    waited: Array  # i32[] cycles since
    closed_x: Array  # f32[NUM_CLOSED] metres, map frame: waypoints given up, the last one first
    closed_y: Array  # f32[NUM_CLOSED]
    closed_for: Array  # i32[NUM_CLOSED] cycles for which they still are
    num_closed: Array  # i32[] waypoints given up for this task

    @property
    def is_news(self) -> Array:
        """Whether a waypoint was given up in the last cycle, bool[]."""
        return self.closed_for[0] == _CYCLES


def start_progress(pose: Array) -> ProgressMonitor:
    """Build the record of a robot that sets out from a pose f32[3]."""
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
    """Close the nodes about waypoints that have been given up."""
    offset_x = nodes.x[:, None] - way.closed_x[None]
    offset_y = nodes.y[:, None] - way.closed_y[None]
    is_near = offset_x * offset_x + offset_y * offset_y < _AROUND**2
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
    """Tell whether the robot gets on, and give its waypoint up where it does not.

    Limits: a robot that stands because it is to stand never gives anything up.

    Args:
        way: before this cycle.
        waypoint: f32[] x and y, where it is sent now, metres, map frame.
        robot: f32[] x and y, believed position.
        is_under_way: bool[], it is sent somewhere.
        patience: cycles without any way made after which a waypoint is given up.
    """
    robot_x, robot_y = robot
    moved = jnp.hypot(robot_x - way.x, robot_y - way.y) > _LEAST_WAY
    waited = jnp.where(is_under_way & ~moved, way.waited + 1, 0)
    gives_up = waited > patience
    is_new = gives_up & (jnp.arange(NUM_CLOSED) == 0)

    def push(old: Array, new: Array) -> Array:
        rest = jnp.where(gives_up, jnp.roll(old, 1), old)
        return jnp.where(is_new, new, rest)

    left = jnp.maximum(way.closed_for - 1, 0)
    return ProgressMonitor(
        x=jnp.where(moved | ~is_under_way, robot_x, way.x),
        y=jnp.where(moved | ~is_under_way, robot_y, way.y),
        waited=jnp.where(gives_up, 0, waited).astype(jnp.int32),
        closed_x=push(way.closed_x, waypoint[0]),
        closed_y=push(way.closed_y, waypoint[1]),
        closed_for=push(left, jnp.int32(_CYCLES)),
        num_closed=way.num_closed + gives_up.astype(jnp.int32),
    )
