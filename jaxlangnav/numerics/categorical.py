"""Log-weights: categorical sampling, normalisation, and resampling of particles (section 3.2)."""

import itertools
import math

import jax.numpy as jnp
from jax import Array

from jaxlangnav.numerics.batching import append_axes

_LOG_MIN, _LOG_MAX = -80.0, 80.0  # inside the range of exp in float32


def draw(log_weight: Array, uniform: Array) -> tuple[Array, Array]:
    """Draw one index in proportion to exp(log_weight), by inverting the cumulative sum.

    Two levels of about √n: the group first, then the offset in it. XLA's own cumulative sum takes
    log n passes over memory, which for all particles costs more than all the weights before it.
    Limits: one finite weight is always drawn; all −∞ gives any index and a total of −∞.

    Args:
        log_weight: f32[n, ...], unnormalised; −∞ excludes.
        uniform: f32[...], in [0, 1).

    Returns:
        i32[...], the index, and f32[...], the log of the total weight.
    """
    top = jnp.max(log_weight, axis=0)
    safe_top = jnp.where(jnp.isfinite(top), top, 0.0)
    weight = jnp.exp(jnp.clip(log_weight - safe_top[None], _LOG_MIN, _LOG_MAX))
    weight = jnp.where(log_weight == -jnp.inf, 0.0, weight)
    count, batch = weight.shape[0], weight.shape[1:]
    size = math.isqrt(count - 1) + 1
    weight = jnp.pad(weight, [(0, -count % size)] + [(0, 0)] * len(batch))
    groups = weight.reshape(-1, size, *batch)
    ends = _running_sum(jnp.sum(groups, axis=1))
    total = ends[-1]
    target = (uniform * total)[None]
    group = jnp.minimum(jnp.sum(ends <= target, axis=0), ends.shape[0] - 1)
    below = jnp.max(jnp.where(ends <= target, ends, 0.0), axis=0)
    is_group = append_axes(jnp.arange(ends.shape[0]), ends.ndim) == group[None]
    chosen = jnp.sum(jnp.where(is_group[:, None], groups, 0.0), axis=0)
    offset = jnp.sum(below[None] + _running_sum(chosen) <= target, axis=0)
    # Rounding may step past the last positive weight of the group: fall back on it.
    last = jnp.max(jnp.where(chosen > 0, append_axes(jnp.arange(size), chosen.ndim), 0), axis=0)
    index = group * size + jnp.minimum(offset, last)
    return index.astype(jnp.int32), jnp.log(total) + safe_top


def _running_sum(values: Array) -> Array:
    """Sum up a few values along the first axis one by one: fuses into one loop over a batch."""
    return jnp.stack(list(itertools.accumulate(jnp.unstack(values))))


def log_normalize(log_weight: Array) -> tuple[Array, Array, Array]:
    """Normalise log-weights f32[..., n] along the last axis; −∞ and NaN count as no weight.

    Returns:
        Weights f32[..., n] that sum to one (uniform where nothing has weight), the log of the
        total f32[...], and bool[...]: whether all weights were zero and became uniform.
    """
    clean = jnp.where(jnp.isnan(log_weight), -jnp.inf, log_weight)
    top = jnp.max(clean, axis=-1, keepdims=True)
    is_dead = ~jnp.isfinite(top)
    weight = jnp.where(is_dead, 1.0, jnp.exp(clean - jnp.where(is_dead, 0.0, top)))
    total = jnp.sum(weight, axis=-1, keepdims=True)
    log_total = jnp.where(is_dead, -jnp.inf, jnp.log(total) + top)
    return weight / total, log_total[..., 0], is_dead[..., 0]


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
