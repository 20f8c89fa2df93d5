"""How many things of a type there are: itself inferred from those seen (section 3.2; ours).

Before any look the number of things of a type in the area, apart from those that the sentence
speaks of, is Poisson with a rate Λ that is not known: Gamma with mean α (``concentration``) and
variance α κ (``clumping``). It is conjugate: after n of them have been seen, and a share s of the
area, a further one anywhere in it is expected as often as

    (α + κ n) / (1 + κ s)

Where things of a type stand in numbers one more is likelier than a lie; where one stands alone,
and all has been looked at, it is the one that is meant. The joint probability of what has been seen
is the product of these, one for each thing in any order, and of ((1 + κ s) / (1 + κ s'))ⁿ for each
look that takes s to s' (what all particles have in common is left out).

Limits: κ → 0 leaves the fixed expectation α.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.semantic_map.coverage import Coverage
from jaxlangnav.semantic_map.params import MapParams


def share_unseen(coverage: Coverage) -> Array:
    """Compute the share u = 1 − s of the area that no look has shown, f32[]."""
    return jnp.mean(jnp.exp(coverage.log_miss))


def log_expected(number: Array, unseen: Array, *, params: MapParams) -> Array:
    """Compute how many more things of a type are expected in the whole area.

        log (α + κ n) / (1 + κ (1 − u))

    Args:
        number: f32[...] or i32[...], n ≥ 0, things of the type seen that are not spoken of.
        unseen: broadcastable to it, u, share of the area that no look has shown.
        params: concentration α and clumping κ.

    Returns:
        f32[...].
    """
    return jnp.log(params.concentration + params.clumping * number) - log_exposure(
        unseen, params=params
    )


def log_exposure(unseen: Array, *, params: MapParams) -> Array:
    """Compute log (1 + κ s) of the share s = 1 − u that has been looked at, f32[...]."""
    return jnp.log1p(params.clumping * (1.0 - unseen))
