"""Draws from unnormalised log-weights."""

import jax.numpy as jnp
from jax import Array

_LOG_MIN, _LOG_MAX = -80.0, 80.0  # inside the range of exp in float32


def draw(log_weight: Array, uniform: Array) -> tuple[Array, Array]:
    """Draw one index in proportion to exp(log_weight), by inverting the cumulative sum.

    Limits: one finite weight is always drawn; all −∞ gives index 0 and a total of −∞.

    Args:
        log_weight: f32[n], unnormalised; −∞ excludes.
        uniform: f32[], in [0, 1).

    Returns:
        i32[], the index, and f32[], the log of the total weight.
    """
    top = jnp.max(log_weight)
    safe_top = jnp.where(jnp.isfinite(top), top, 0.0)
    weight = jnp.exp(jnp.clip(log_weight - safe_top, _LOG_MIN, _LOG_MAX))
    weight = jnp.where(log_weight == -jnp.inf, 0.0, weight)
    cumulative = jnp.cumsum(weight)
    total = cumulative[-1]
    index = jnp.sum(cumulative <= uniform * total)
    # Rounding may step past the last positive weight: fall back on the last index that has any.
    last = jnp.max(jnp.where(weight > 0, jnp.arange(weight.shape[0]), 0))
    return jnp.minimum(index, last).astype(jnp.int32), jnp.log(total) + safe_top


def log_normalize(log_weight: Array) -> tuple[Array, Array, Array]:
    """Normalise log-weights along the last axis.

    Args:
        log_weight: f32[..., n], unnormalised; −∞ and NaN count as no weight.

    Returns:
        Weights f32[..., n] that sum to one (uniform where nothing has weight), the log of the
        total f32[...], and bool[...]: whether the weights had died and were made uniform.
    """
    clean = jnp.where(jnp.isnan(log_weight), -jnp.inf, log_weight)
    top = jnp.max(clean, axis=-1, keepdims=True)
    is_dead = ~jnp.isfinite(top)
    weight = jnp.where(is_dead, 1.0, jnp.exp(clean - jnp.where(is_dead, 0.0, top)))
    total = jnp.sum(weight, axis=-1, keepdims=True)
    log_total = jnp.where(is_dead, -jnp.inf, jnp.log(total) + top)
    return weight / total, log_total[..., 0], is_dead[..., 0]
