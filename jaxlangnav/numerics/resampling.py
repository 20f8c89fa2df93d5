"""Resampling and the effective sample size (section 3.2, last paragraph)."""

import jax.numpy as jnp
from jax import Array


def effective_sample_size(weight: Array) -> Array:
    """Compute the effective sample size of normalised weights f32[P]: 1 / Σ wᵢ².

    Limits: P for equal weights, 1 for a single survivor.
    """
    return 1.0 / jnp.sum(weight * weight)


def systematic(weight: Array, uniform: Array) -> Array:
    """Systematic resampling: ancestors i32[P], ascending; particle i has P wᵢ ± 1 offspring.

    By weights f32[P], normalised, and one draw f32[] in [0, 1).
    """
    size = weight.shape[0]
    cumulative = jnp.cumsum(weight)
    cumulative = cumulative / cumulative[-1]
    # Number of comb teeth at or below each cumulative weight. Tooth j belongs to the particle
    # after all those that end at or before it: a histogram and its running sum, linear in P.
    teeth = jnp.clip(jnp.ceil(cumulative * size - uniform), 0, size).astype(jnp.int32)
    ending = jnp.zeros(size + 1, jnp.int32).at[teeth].add(1)
    return jnp.minimum(jnp.cumsum(ending[:size]), size - 1)


def independent(weight: Array, uniform: Array) -> Array:
    """Multinomial resampling: an independent ancestor i32[P] for each uniform draw f32[P].

    ``weight`` is f32[P], in proportion to the probabilities.
    """
    cumulative = jnp.cumsum(weight)
    # A binary search: comparing all with all is quadratic in P.
    ancestors = jnp.searchsorted(cumulative, uniform * cumulative[-1], side="right")
    return jnp.minimum(ancestors, weight.shape[0] - 1).astype(jnp.int32)
