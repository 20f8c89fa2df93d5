"""Does an observation contradict the map? A filter that is asked says so instead of dying silently.

No particle need die of it: an impossible detection becomes a new object, and an object that has
vanished stays where it was. What is left of the contradiction is its improbability.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.numerics import categorical
from jaxlangnav.semantic_map.association import Association

LOG_CONTRADICTION = 15.0
"""Nats; an observation e¹⁵ times less probable than those the map leads one to expect contradicts
it. Of 78 000 looks in Table 2's worlds one is beyond; two false things in view four looks long are
18 to 41 nats at the worst of them."""


def surprise(
    log_weight: Array, grounded: Association, log_map: Array, log_new: Array, noise_variance: Array
) -> Array:
    """Measure how much less probable an observation is than one that fits.

        −log Σ_i w_i p_i(z) / p*_i(z),   log p* = n_new log λ − n_known (log 2πR + 1)

    p* is what the same grounding would weigh if every new object stood where nobody has looked,
    every known one as far from its place as the noise takes it on average, and none were missed.
    So many objects that come into view at once surprise nobody, and objects that are seen where
    nothing can be, are away from where they were, or vanish in plain view, do.

    Args:
        log_weight: f32[P], before the observation, normalised.
        grounded: how the particles grounded the detections, leaves [..., P].
        log_map: f32[P], log probability of detections and absences of seen objects.
        log_new: f32[], log λ, density of objects not yet seen, 1/m².
        noise_variance: f32[], R, square metres per axis.

    Returns:
        f32[], nats; about 0 or less for what was to be expected, and 0 where detections found no
        free slot (the map cannot know those, which is counted by itself) or all weights had died.
    """
    num_new = jnp.sum(grounded.is_new, axis=0)
    num_known = jnp.sum(grounded.is_hit, axis=0) - num_new
    log_fitting = num_new * log_new - num_known * (jnp.log(2.0 * jnp.pi * noise_variance) + 1.0)
    _, log_share, is_dead = categorical.log_normalize(log_weight + log_map - log_fitting)
    return jnp.where(is_dead | (jnp.max(grounded.overflow) > 0), 0.0, -log_share)
