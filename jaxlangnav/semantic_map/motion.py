"""The robot's motion: a node and an edge, the old pose marginalised out (section 3.2, eq. 6).

Without a compass the heading is dead-reckoned, too, and drifts. The drift rotates all later motion
and observations, which is not Gaussian: every particle samples its own drift, and is weighted by
objects observed again (FastSLAM; Montemerlo et al. 2002). Observations are given in the mean
heading; ``particle_headings`` has the heading of each particle.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import MotionParams, Observation
from jaxlangnav.numerics.batching import append_axes
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief, mean_drift
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.terrain.view import rotate, wrapped

_DRIFT_KEY = 1  # folded into the key of the detections for the drift of the heading


def predict(
    belief: ParticleBelief,
    pose: Array,
    is_jump: Array | bool,
    noise: Array | None = None,
    *,
    params: MapParams,
) -> ParticleBelief:
    """Predict the robot's position in every particle from odometry since the last step.

    The dead-reckoned pose is f32[3]; if it is a jump, bool[], the robot may be there or at its last
    position. Particles with a ``drift`` need ``noise``, f32[P], standard normal.
    """
    step_x, step_y = pose[0] - belief.last_pose[0], pose[1] - belief.last_pose[1]
    noise_ratio = jnp.where(is_jump, 1.0, params.motion.odometry_noise)
    squared = step_x * step_x + step_y * step_y
    variance, particles = (noise_ratio**2) * squared, belief.particles
    if noise is not None:
        distance, turn = jnp.sqrt(squared), wrapped(pose[2] - belief.last_pose[2])
        drift = add_drift(particles.drift, distance, turn, noise, motion=params.motion)
        # The mean drift over the step.
        step_x, step_y = rotate(step_x, step_y, 0.5 * (particles.drift[:1] + drift[:1]))
        particles = replace(particles, drift=drift)
    particles = move(particles, step_x, step_y, variance)
    return replace(belief, particles=particles, last_pose=pose)


def drift_noise(key: Array, belief: ParticleBelief) -> Array | None:
    """Sample standard normals for the headings' drift, f32[P]; None with a compass."""
    if belief.particles.drift.shape[0] == 0:
        return None
    return jax.random.normal(jax.random.fold_in(key, _DRIFT_KEY), belief.log_weight.shape)


def correct_heading(belief: ParticleBelief, observation: Observation) -> Observation:
    """Correct the heading of an observation by the mean drift."""
    drift, pose = mean_drift(belief), observation.pose
    return observation if drift is None else replace(observation, pose=pose.at[2].add(drift))


def particle_headings(belief: ParticleBelief, heading: Array) -> Array:
    """Compute the robot's heading in each particle, f32[] or f32[1, P], given the mean."""
    drift = mean_drift(belief)
    return heading if drift is None else heading + belief.particles.drift[:1] - drift


def add_drift(drift: Array, s: Array, phi: Array, noise: Array, *, motion: MotionParams) -> Array:
    """Sample the heading error of odometry after a motion.

        e' = e + b ζ s + √(σ² s + τ² |φ|) ε

    with e the true heading minus that of odometry, s the distance, φ the turn, ε standard normal,
    and b ζ the constant bias, of which only the magnitude b is known: ζ is 1 or −1, constant.
    Limits: b = σ = τ = 0 leaves e as it is; where b = 0, so is ζ.

    Args:
        drift: f32[2, ...], e and ζ.
        s: f32[], s, metres.
        phi: f32[], φ, radians.
        noise: f32[...], ε.
        motion: heading_bias b, heading_noise σ, turn_noise τ.
    """
    variance = motion.heading_noise**2 * s + motion.turn_noise**2 * jnp.abs(phi)
    error = drift[0] + motion.heading_bias * drift[1] * s + jnp.sqrt(variance) * noise
    return jnp.stack([error, jnp.where(motion.heading_bias > 0.0, drift[1], 0.0)])


def move(particle: SemanticMap, step_x: Array, step_y: Array, variance: Array) -> SemanticMap:
    """Translate the robot by a measured step with independent noise in each axis.

        Σ' = Σ + q e eᵀ,   μ' = μ + e u

    with e the robot's unit vector: its old pose is marginalised out. The step, odometry u, is f32[]
    or f32[1, ...] metres, map axes; its variance q ≥ 0, f32[] m² per axis.
    Limits: no noise translates the robot rigidly; objects never move.
    """
    robot = particle.object_type.shape[0]
    is_robot = jnp.arange(robot + 1) == robot
    is_robot_entry = append_axes(is_robot[:, None] & is_robot[None], particle.covariance.ndim)
    unit = append_axes(is_robot.astype(jnp.float32), particle.mean_x.ndim)
    return replace(
        particle,
        covariance=particle.covariance + jnp.where(is_robot_entry, variance, 0.0),
        mean_x=particle.mean_x + unit * step_x,
        mean_y=particle.mean_y + unit * step_y,
    )
