"""The first half of a step: move the robot in every particle (section 3.2, eq. 6).

Particles of a robot without a compass differ in how far its heading has drifted. What is seen is
told in the mean of them; ``headings`` says where each particle takes the robot to look.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import Observation
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import motion
from jaxlangnav.semantic_map.belief import ParticleBelief, mean_drift
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.terrain.view import wrapped

_DRIFT = 1  # folded into the key of the detections for the drift of the heading


def predict(
    belief: ParticleBelief,
    pose: Array,
    is_jump: Array,
    noise: Array | None = None,
    *,
    params: MapParams,
) -> ParticleBelief:
    """Move the robot in every particle by what odometry has measured since the last step.

    The dead-reckoned pose is f32[3]; where it is a jump, bool[], the robot may be there or where it
    was. Particles that hold a ``drift`` need ``noise``, f32[P], standard normal.
    """
    step_x, step_y = pose[0] - belief.last_pose[0], pose[1] - belief.last_pose[1]
    share = jnp.where(is_jump, 1.0, params.motion.odometry_noise)
    squared = step_x * step_x + step_y * step_y
    variance, particles = (share**2) * squared, belief.particles
    if noise is not None:
        way, turn = jnp.sqrt(squared), wrapped(pose[2] - belief.last_pose[2])
        drift = motion.drifted(particles.drift, way, turn, noise, motion=params.motion)
        # Over the step it is half of what has come in.
        halfway = 0.5 * (particles.drift[:1] + drift[:1])
        step_x, step_y = motion.rotated(step_x, step_y, halfway)
        particles = replace(particles, drift=drift)
    moved = motion.move(particles, step_x, step_y, variance)
    return replace(belief, particles=moved, last_pose=pose)


def drift_noise(key: Array, belief: ParticleBelief) -> Array | None:
    """Draw by what the headings drift, f32[P]; None where a compass gives them."""
    if belief.particles.drift.shape[0] == 0:
        return None
    return jax.random.normal(jax.random.fold_in(key, _DRIFT), belief.log_weight.shape)


def with_drift(belief: ParticleBelief, observation: Observation) -> Observation:
    """Correct the heading of a look by how far the robot is believed to have drifted."""
    drift, pose = mean_drift(belief), observation.pose
    return observation if drift is None else replace(observation, pose=pose.at[2].add(drift))


def headings(belief: ParticleBelief, heading: Array) -> Array:
    """Tell where each particle takes the robot to look, f32[] or f32[1, P], given the mean."""
    drift = mean_drift(belief)
    return heading if drift is None else heading + belief.particles.drift[:1] - drift
