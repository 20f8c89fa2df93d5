"""Poisson-Gamma model of the number of objects of a type (section 3.2; ours).

A priori the number of objects of a type in the area, apart from those that the sentence mentions,
is Poisson with an unknown rate Λ: Gamma with mean α (``concentration``) and variance α κ
(``clumping``). It is conjugate: after n of them, and a fraction s of the area, have been observed,
the expected number of further ones in the whole area is

    (α + κ n) / (1 + κ s)

The joint probability of the observed objects is the product of these, one per object in any order,
and of ((1 + κ s) / (1 + κ s'))ⁿ for each observation that takes s to s' (factors common to all
particles are left out).

Types may have a rate each, or share one (``MapConfig.pools_counts``). For T types that share one,
n counts the objects of all of them, observed in T times the area: s is T s.

Detected objects may not exist (``association.ClutterOdds``): for objects that exist with
probabilities r, n is their sum, and evidence on the number of objects updates each r
(``raise_existence``, ``lower_existence``). Correlations between the r are neglected.

Limits: κ → 0 leaves the fixed expectation α; r = 1 for all is the model without clutter.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.semantic_map.coverage import Coverage
from jaxlangnav.semantic_map.params import MapParams


def unseen_frac(coverage: Coverage) -> Array:
    """Compute the unobserved fraction u = 1 − s of the area, f32[]."""
    return jnp.mean(jnp.exp(coverage.log_miss))


def log_expected(
    count: Array, unseen: Array, *, params: MapParams, num_pooled: Array | None = None
) -> Array:
    """Compute the log expected number of further objects of a type in the whole area.

        log (α + κ n) / (1 + T κ (1 − u))

    n ≥ 0, [...], counts observed objects of the type, or of all T pooled ones, that are not
    mentioned; u and T are broadcastable to it. Without T each type has its own rate.
    """
    return jnp.log(params.concentration + params.clumping * count) - log_exposure(
        unseen, params=params, num_pooled=num_pooled
    )


def log_exposure(unseen: Array, *, params: MapParams, num_pooled: Array | None = None) -> Array:
    """Compute log (1 + T κ s) for the observed fraction s = 1 − u, f32[...]."""
    clumping = params.clumping if num_pooled is None else params.clumping * num_pooled
    return jnp.log1p(clumping * (1.0 - unseen))


def log_prob_none(
    count: Array, frac: Array, unseen: Array, *, params: MapParams, num_pooled: Array | None = None
) -> Array:
    """Compute the log-probability that a fraction q, f32[...], of the unseen area has no object.

        −(α / κ + n) log[1 + κ q u / (1 + T κ (1 − u))]    (negative binomial; κ → 0: −α q u)

    n, u and T are those of ``log_expected``.
    """
    clumping = jnp.maximum(params.clumping, 1e-6)
    exposure = jnp.exp(log_exposure(unseen, params=params, num_pooled=num_pooled))
    return -(params.concentration / clumping + count) * jnp.log1p(
        clumping * frac * unseen / exposure
    )


def raise_existence(existence: Array, growth: Array | float, prob_real: Array | float) -> Array:
    """Raise existence probabilities of objects of a type after one more of them is detected.

        r_i' = r_i (1 + ρ g (1 − r_i) / (1 + g Σ_j r_j)),   g = κ / α

    with r, f32[O, ...], 0 for types with another rate and in empty slots, and ρ, f32[...], the
    probability that the new one is itself real. Limits: unchanged for g = 0, ρ = 0 or r = 1.
    """
    gain = prob_real * growth / (1.0 + growth * jnp.sum(existence, axis=0))
    return existence * (1.0 + jnp.asarray(gain)[None] * (1.0 - existence))


def lower_existence(existence: Array, log_rise: Array) -> tuple[Array, Array]:
    """Lower existence probabilities after more of the area is observed without further objects.

        log Π_i (1 − r_i + r_i q),   r_i' = r_i q / (1 − r_i + r_i q),   q = (1 + κ s) / (1 + κ s')

    Log-likelihood, f32[...], and r', f32[O, ...]; of r, 0 in empty slots, and −log q ≥ 0, f32[].
    """
    # Divided by q, so that r = 1 stays 1 exactly.
    log_norm = jnp.log1p((1.0 - existence) * jnp.expm1(log_rise))
    log_likelihood = jnp.where(existence > 0.0, log_norm - log_rise, 0.0)
    return jnp.sum(log_likelihood, axis=0), existence * jnp.exp(-log_norm)
