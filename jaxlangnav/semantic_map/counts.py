"""How many things of a type there are: itself inferred from those seen (section 3.2; ours).

Before any look the number of things of a type in the area, apart from those that the sentence
speaks of, is Poisson with a rate Λ that is not known: Gamma with mean α (``concentration``) and
variance α κ (``clumping``). It is conjugate: after n of them have been seen, and a share s of the
area, a further one anywhere in it is expected as often as

    (α + κ n) / (1 + κ s)

The joint probability of what has been seen is the product of these, one for each thing in any
order, and of ((1 + κ s) / (1 + κ s'))ⁿ for each look that takes s to s' (what all particles have in
common is left out).

Types may have a rate each, or one in common (``MapConfig.pools_counts``). Of T types that have one,
n counts the things of all of them, seen in T times the area: s is T s.

What was detected may not exist (``association.ClutterOdds``): of things that exist with
probabilities r, n is their sum, and what tells of their number tells of each of them
(``raise_existence``, ``lower_existence``). That the r of two things hang together is not kept.

Limits: κ → 0 leaves the fixed expectation α; r = 1 for all is as without doubt.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.semantic_map.coverage import Coverage
from jaxlangnav.semantic_map.params import MapParams


def unseen_frac(coverage: Coverage) -> Array:
    """Compute the share u = 1 − s of the area that no look has shown, f32[]."""
    return jnp.mean(jnp.exp(coverage.log_miss))


def log_expected(
    number: Array, unseen: Array, *, params: MapParams, num_pooled: Array | None = None
) -> Array:
    """Compute how many more things of a type are expected in the whole area.

        log (α + κ n) / (1 + T κ (1 − u))

    Args:
        number: f32[...] or i32[...], n ≥ 0, things of the type, or of all that are pooled, seen
            that are not spoken of.
        unseen: broadcastable to it, u, share of the area that no look has shown.
        params: concentration α and clumping κ.
        num_pooled: broadcastable to it, T, types that have one rate; None: each has its own.
    """
    return jnp.log(params.concentration + params.clumping * number) - log_exposure(
        unseen, params=params, num_pooled=num_pooled
    )


def log_exposure(unseen: Array, *, params: MapParams, num_pooled: Array | None = None) -> Array:
    """Compute log (1 + T κ s) of the share s = 1 − u that has been looked at, f32[...]."""
    clumping = params.clumping if num_pooled is None else params.clumping * num_pooled
    return jnp.log1p(clumping * (1.0 - unseen))


def raise_existence(existence: Array, growth: Array | float, is_real: Array | float) -> Array:
    """Raise the probabilities of things of a type to exist by one more of them that is detected.

        r_i' = r_i (1 + ρ g (1 − r_i) / (1 + g Σ_j r_j)),   g = κ / α

    with r, f32[O, ...], 0 of types with another rate and in empty slots, and ρ, f32[...], the
    probability that the new one is itself real. Limits: no growth, nothing real (ρ = 0) and what is
    sure (r = 1) stay as they are.
    """
    gain = is_real * growth / (1.0 + growth * jnp.sum(existence, axis=0))
    return existence * (1.0 + jnp.asarray(gain)[None] * (1.0 - existence))


def lower_existence(existence: Array, log_exposure: Array) -> tuple[Array, Array]:
    """Hold against things that may not exist that more of the area shows no more of them.

        log Π_i (1 − r_i + r_i q),   r_i' = r_i q / (1 − r_i + r_i q),   q = (1 + κ s) / (1 + κ s')

    Log-likelihood, f32[...], and r', f32[O, ...]; of r, 0 in empty slots, and −log q ≥ 0, f32[].
    """
    # Over q, so that what is sure stays so to the last bit.
    lost = jnp.log1p((1.0 - existence) * jnp.expm1(log_exposure))
    log_likelihood = jnp.where(existence > 0.0, lost - log_exposure, 0.0)
    return jnp.sum(log_likelihood, axis=0), existence * jnp.exp(-lost)
