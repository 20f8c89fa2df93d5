"""Proposal for the robot's motion: a node and an edge, the old pose marginalised out (eq. 6).

Without a compass the heading is dead-reckoned, too, and drifts. How far it has drifted acts on all
that is seen and driven from then on by a rotation, which no Gaussian holds: every particle has a
drift of its own, and what it sees again weighs it (FastSLAM; Montemerlo et al. 2002).
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import MotionParams
from jaxlangnav.numerics.batching import append_axes
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.particle import SemanticMap


def rotated(x: Array, y: Array, angle: Array) -> tuple[Array, Array]:
    """Turn offsets counter-clockwise, radians; exact where the angle is zero."""
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    return cosine * x - sine * y, sine * x + cosine * y


def drifted(drift: Array, way: Array, turn: Array, noise: Array, *, motion: MotionParams) -> Array:
    """Let the heading drift as the robot turns and drives.

        e' = e + b ζ s + √(σ² s + τ² |φ|) ε

    with e by how much the true heading exceeds that of odometry, s the way, φ the turn, ε standard
    normal, and b ζ the steady drift, of which only the magnitude b is known: ζ is 1 or −1, the same
    all the way.
    Limits: b = σ = τ = 0 leaves e as it is; where b = 0, so is ζ.

    Args:
        drift: f32[2, ...], e and ζ.
        way: f32[], s, metres.
        turn: f32[], φ, radians.
        noise: f32[...], ε.
        motion: heading_bias b, heading_noise σ, turn_noise τ.
    """
    variance = motion.heading_noise**2 * way + motion.turn_noise**2 * jnp.abs(turn)
    error = drift[0] + motion.heading_bias * drift[1] * way + jnp.sqrt(variance) * noise
    return jnp.stack([error, jnp.where(motion.heading_bias > 0.0, drift[1], 0.0)])


def move(particle: SemanticMap, step_x: Array, step_y: Array, variance: Array) -> SemanticMap:
    """Move the robot by a measured step with independent noise in each axis.

        Σ' = Σ + q e eᵀ,   μ' = μ + e u

    with e the robot's unit vector: its old pose is marginalised out. The step, odometry u, is f32[]
    or f32[1, ...] metres, map axes; its variance q ≥ 0, f32[] m² per axis.
    Limits: no noise translates the robot rigidly; objects never move.
    """
    robot = particle.object_type.shape[0]
    is_robot = jnp.arange(robot + 1) == robot
    own = append_axes(is_robot[:, None] & is_robot[None], particle.covariance.ndim)
    unit = append_axes(is_robot.astype(jnp.float32), particle.mean_x.ndim)
    return replace(
        particle,
        covariance=particle.covariance + jnp.where(own, variance, 0.0),
        mean_x=particle.mean_x + unit * step_x,
        mean_y=particle.mean_y + unit * step_y,
    )
