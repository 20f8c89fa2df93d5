"""What is to be kept away from: nodes whose way leads past it are charged (section 3.4; ours)."""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner.graph import Nodes
from jaxlangnav.semantic_map.belief import ParticleBelief

BERTH = 2.0
"""Metres around an object that a constraint forbids."""


def squared_distance_to_segment(
    x: Array, y: Array, from_x: Array, from_y: Array, to_x: Array, to_y: Array
) -> Array:
    """Compute squared distances of points to segments.

    Limits: a segment of no length is a point.

    Args:
        x: f32[...], points, metres.
        y: f32[...].
        from_x: f32[...], segment ends, broadcastable to the points.
        from_y: f32[...].
        to_x: f32[...].
        to_y: f32[...].

    Returns:
        f32[...], square metres.
    """
    span_x, span_y = to_x - from_x, to_y - from_y
    length = span_x * span_x + span_y * span_y + 1e-9
    along = jnp.clip(((x - from_x) * span_x + (y - from_y) * span_y) / length, 0.0, 1.0)
    return (x - from_x - along * span_x) ** 2 + (y - from_y - along * span_y) ** 2


def constraint_cost(
    belief: ParticleBelief,
    constraint: Array,
    nodes: Nodes,
    robot_x: Array,
    robot_y: Array,
    cost: Array,
) -> Array:
    """Charge each node for the probability that the straight way to it passes a forbidden object.

    Of several objects on the way the likeliest counts; hypotheses do not.

    Args:
        belief: weighted particles.
        constraint: f32[R, N + 1, P], probability that a region of a slot is forbidden.
        nodes: candidate waypoints.
        robot_x: f32[], metres, map frame.
        robot_y: f32[], metres.
        cost: f32[], value lost on a way that is surely forbidden.

    Returns:
        f32[A].
    """
    particles = belief.particles
    weight = jnp.exp(belief.log_weight)
    num_objects = particles.object_type.shape[0]
    forbidden = jnp.max(constraint, axis=0)[:num_objects]  # [O, P]
    share = jnp.sum(forbidden * weight[None, :], axis=1)  # [O]
    x = jnp.sum(particles.mean_x[:num_objects] * weight[None, :], axis=1)
    y = jnp.sum(particles.mean_y[:num_objects] * weight[None, :], axis=1)
    squared = squared_distance_to_segment(
        x[None, :], y[None, :], robot_x, robot_y, nodes.x[:, None], nodes.y[:, None]
    )
    near = squared <= jnp.square(BERTH)
    return cost * jnp.max(jnp.where(near, share[None, :], 0.0), axis=1)
