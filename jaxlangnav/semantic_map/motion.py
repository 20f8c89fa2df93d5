"""Proposal for the robot's motion: a node and an edge, the old pose marginalised out (eq. 6)."""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.numerics import gaussian
from jaxlangnav.numerics.batching import column
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.particle import SemanticMap


def move(particle: SemanticMap, step_x: Array, step_y: Array, variance: Array) -> SemanticMap:
    """Move the robot by a measured step with independent noise in each axis.

    Limits: no noise translates the robot rigidly; objects never move.

    Args:
        particle: one particle, or all of them with their axis last.
        step_x: f32[], odometry u, metres, map axes.
        step_y: f32[], metres.
        variance: f32[], square metres per axis.

    Returns:
        The particle with the old pose marginalised out.
    """
    robot = particle.object_type.shape[0]
    unit = column((jnp.arange(robot + 1) == robot).astype(jnp.float32), particle.mean_x.ndim)
    return replace(
        particle,
        covariance=gaussian.add_noise(particle.covariance, robot, variance),
        mean_x=particle.mean_x + unit * step_x,
        mean_y=particle.mean_y + unit * step_y,
    )
