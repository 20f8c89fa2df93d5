"""The density of the goal's place, and its regions of highest density (for calibration).

An object that has been seen is a Gaussian, a hypothesis of a particle one draw of a wider law. Both
make up one density, and a region of highest density that holds a share q of it must hold the true
place in a share q of all cases. The rank of the truth says it for every q at once.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.numerics import gaussian
from jaxlangnav.pytree import pytree
from jaxlangnav.semantic_map.particle import SemanticMap

BANDWIDTH = 1.0
"""Metres, of the kernel that turns the particles' hypotheses into a density."""
_MIN_VARIANCE = 1e-4
"""Square metres; a place that is known better than this counts as known this well."""
_LOG_FLOOR = 1e-12  # per square metre


@pytree
class GoalDensity:
    """Where the goal is believed to be: a Gaussian per seen object, and the hypotheses."""

    object_x: Array  # f32[O] metres, map frame
    object_y: Array  # f32[O]
    object_mass: Array  # f32[O] probability that it is the goal
    object_variance: Array  # f32[O] square metres per axis, of its place relative to the robot
    hypothesis_x: Array  # f32[H] metres
    hypothesis_y: Array  # f32[H]
    hypothesis_mass: Array  # f32[H]


def _normal(x: Array, y: Array, variance: Array | float) -> Array:
    """Evaluate an isotropic Gaussian density in the plane."""
    return jnp.exp(gaussian.log_normal_isotropic(x, y, jnp.asarray(variance, jnp.float32)))


def goal_region(density: GoalDensity, true_x: Array, true_y: Array) -> tuple[Array, Array]:
    """Find the probability of all places that are likelier than the true one.

        below = Σ_h m_h [f₋ₕ(x_h) > t] + Σ_o m_o (1 − (t − b_o) / p_o),    t = f(truth)

    with f the mixture of Gaussians about seen objects (peak m_o / 2π s_o = p_o over the background
    b_o) and of kernels about hypotheses. A hypothesis is one draw, and does not count in the
    density at its own place (f₋ₕ), nor do its copies: so if the truth is one more draw of the same
    law, ``below`` is uniform between 0 and 1.

    Args:
        density: the belief.
        true_x: f32[], metres, map frame.
        true_y: f32[], metres.

    Returns:
        f32[] in [0, 1]: the truth lies in the region of highest density that holds a share q if
        this is at most q. And f32[], the log-density at the truth, per square metre.
    """
    total = jnp.sum(density.object_mass) + jnp.sum(density.hypothesis_mass)
    scale = 1.0 / jnp.maximum(total, 1e-9)
    seen, open_mass = density.object_mass * scale, density.hypothesis_mass * scale
    variance = jnp.maximum(density.object_variance, _MIN_VARIANCE)

    def hypotheses(x: Array, y: Array) -> Array:
        return _normal(
            x[:, None] - density.hypothesis_x[None],
            y[:, None] - density.hypothesis_y[None],
            BANDWIDTH**2,
        )

    def objects(x: Array, y: Array) -> Array:
        return _normal(
            x[:, None] - density.object_x[None],
            y[:, None] - density.object_y[None],
            variance[None],
        )

    at_truth = (
        hypotheses(true_x[None], true_y[None]) @ open_mass
        + objects(true_x[None], true_y[None]) @ seen
    )[0]
    own = hypotheses(density.hypothesis_x, density.hypothesis_y)
    is_copy = own > (1.0 - 1e-6) / (2.0 * jnp.pi * BANDWIDTH**2)
    at_hypotheses = jnp.where(is_copy, 0.0, own) @ open_mass
    at_hypotheses += objects(density.hypothesis_x, density.hypothesis_y) @ seen
    among = objects(density.object_x, density.object_y)
    is_self = jnp.eye(seen.shape[0], dtype=bool)
    background = hypotheses(density.object_x, density.object_y) @ open_mass
    background += jnp.where(is_self, 0.0, among) @ seen
    peak = seen / (2.0 * jnp.pi * variance)
    share = 1.0 - jnp.clip((at_truth - background) / jnp.maximum(peak, 1e-20), 0.0, 1.0)
    below = jnp.sum(jnp.where(at_hypotheses > at_truth, open_mass, 0.0)) + jnp.sum(seen * share)
    return below, jnp.log(jnp.maximum(at_truth, _LOG_FLOOR))


def relative_variance(particles: SemanticMap, weight: Array) -> Array:
    """Compute how well objects are known relative to the robot: Σ_oo + Σ_rr − 2 Σ_or.

    Args:
        particles: leaves [..., P].
        weight: f32[P], normalised.

    Returns:
        f32[O] square metres per axis, the mean over the particles.
    """
    num_objects = particles.object_type.shape[0]
    covariance = particles.covariance
    own = jnp.diagonal(covariance).T  # [O + 1, P]
    robot, shared = own[num_objects:], covariance[num_objects, :num_objects]
    relative = own[:num_objects] + robot - 2.0 * shared
    return jnp.sum(relative * weight[None, :], axis=1)
