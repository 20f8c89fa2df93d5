"""Systematic resampling and the effective sample size (section 3.2, last paragraph)."""

import jax.numpy as jnp
from jax import Array


def effective_sample_size(weight: Array) -> Array:
    """Count how many equal particles the weights are worth: 1 / Σ wᵢ².

    Limits: P for equal weights, 1 for a single survivor.

    Args:
        weight: f32[P], normalised.

    Returns:
        f32[].
    """
    return 1.0 / jnp.sum(weight * weight)


def systematic(weight: Array, uniform: Array) -> Array:
    """Choose ancestors so that particle i has P wᵢ offspring to within one.

    Args:
        weight: f32[P], normalised.
        uniform: f32[], in [0, 1).

    Returns:
        i32[P], ancestor of each slot, in ascending order.
    """
    size = weight.shape[0]
    cumulative = jnp.cumsum(weight)
    cumulative = cumulative / cumulative[-1]
    # Number of comb teeth at or below each cumulative weight, then invert by counting: the
    # comparison matrix is small, and unlike a binary search it vectorises.
    teeth = jnp.ceil(cumulative * size - uniform)
    ancestors = jnp.sum(teeth[:, None] <= jnp.arange(size)[None, :], axis=0)
    return jnp.minimum(ancestors, size - 1).astype(jnp.int32)
