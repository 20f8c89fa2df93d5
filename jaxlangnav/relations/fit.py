"""Relations learned from examples: where people say things are (section 3.2, eq. 7a).

A labelled pair is a figure, a landmark, the word between them, where the speaker stood at the
utterance and where the robot stands now. The frame that was meant is not labelled, so each pair is
a mixture over three of them,

    p(o | word) = Σ_k π_k f(o; θ, frame_k),   k: viewer's frame at the utterance,
                                                 robot's present frame, undirected (κ = 0)

with the density f of ``relations`` and shares π of each word. Parameters and shares maximise the
posterior by L-BFGS on exact gradients, and the curvature there gives standard errors. What frame
each pair was meant in is reported as a posterior.

The filter understands relations in the viewer's frame alone. Words are "front" to "far", as
everywhere.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree

from jaxlangnav.numerics.descent import descend
from jaxlangnav.pytree import field, pytree, replace
from jaxlangnav.relations import REGISTRY, SIDES, RelationParams, default_params
from jaxlangnav.relations.pairs import FRAMES, RelationPairs, log_frame_densities
from jaxlangnav.relations.table import MODELLED

_RINGS = [row for row, index in enumerate(MODELLED) if index not in SIDES]
"""Relations without a direction: κ stays 0, and no frame can be told from another."""
_MIN_CONCENTRATION = 1e-3
_FLAT, _CONVERGED = 1e-4, 1e-3
"""Length of the mean gradient that ends the search, and each number's that counts as vanished:
float32 leaves a rounding error of about 1e-4."""


@pytree
class RelationPrior:
    """How far parameters are believed to lie from where the fit starts; standard deviations.

    The default is worth about one pair: it decides where there are no data, and only there.
    """

    log_distance: Array = field("log metres", default=1.0)
    log_distance_sd: Array = field("of its logarithm", default=1.0)
    axis: Array = field("radians", default=1.5)
    log_concentration: Array = field("nats", default=1.5)
    frame_pairs: Array = field("pairs that the uniform prior on frames is worth", default=1.0)


@pytree
class RelationFit:
    """Fitted relations, and how well they are known."""

    params: RelationParams
    standard_error: RelationParams  # of each parameter; 0 where it was not fitted
    frame_share: Array  # f32[R, F] π of each word, sums to one
    frame_share_error: Array  # f32[R, F]
    frame_posterior: Array  # f32[N, F] in which frame each pair was meant
    log_likelihood: Array  # f32[] mean over the pairs, log of a density per square metre
    log_likelihood_before: Array  # f32[] at the start: initial parameters, all frames alike
    num_pairs: Array  # i32[R] pairs of each word
    is_converged: Array  # bool[] the gradient has vanished


_Free = tuple[RelationParams, Array]
"""What is optimised, unconstrained: relations with log σ and log κ in place of σ and κ, and logits
of the frames f32[R, F]."""


def _decode(free: _Free) -> tuple[RelationParams, Array]:
    """Turn unconstrained numbers into relations and log-shares of the frames f32[R, F]."""
    params, logit = free
    is_ring = jnp.isin(jnp.arange(len(MODELLED)), jnp.asarray(_RINGS))
    concentration = jnp.where(is_ring, 0.0, jnp.exp(params.concentration))
    spread = jnp.exp(params.log_distance_sd)
    params = replace(params, log_distance_sd=spread, concentration=concentration)
    return params, jax.nn.log_softmax(logit, axis=1)


def _encode(params: RelationParams) -> _Free:
    """Start from relations, with all frames alike."""
    log_spread = jnp.log(params.log_distance_sd)
    log_concentration = jnp.log(jnp.maximum(params.concentration, _MIN_CONCENTRATION))
    params = replace(params, log_distance_sd=log_spread, concentration=log_concentration)
    return params, jnp.zeros((len(MODELLED), len(FRAMES)), jnp.float32)


def _log_joint(free: _Free, pairs: RelationPairs) -> Array:
    """Log of share times density of every pair in every frame, f32[N, F]."""
    params, log_share = _decode(free)
    return log_frame_densities(pairs, params=params) + log_share[pairs.relation]


def _log_prior(free: _Free, start: _Free, prior: RelationPrior) -> Array:
    """Log-prior of the unconstrained numbers, up to a constant."""
    deviations = RelationParams(
        log_distance=prior.log_distance,
        log_distance_sd=prior.log_distance_sd,
        axis=prior.axis,
        concentration=prior.log_concentration,
    )
    far = jax.tree.map(
        lambda value, centre, deviation: -0.5 * jnp.sum(((value - centre) / deviation) ** 2),
        free[0],
        start[0],
        deviations,
    )
    shares = jax.nn.log_softmax(free[1], axis=1)
    # Shares do not change with the sum of the logits: hold that at zero.
    anchor = -0.5 * jnp.sum(jnp.sum(free[1], axis=1) ** 2)
    return sum(jax.tree.leaves(far)) + prior.frame_pairs / len(FRAMES) * jnp.sum(shares) + anchor


@jax.jit
def _maximise(
    pairs: RelationPairs, start: _Free, prior: RelationPrior, max_steps: Array
) -> tuple[_Free, Array, Array]:
    """Run L-BFGS from where the prior has its centre, on the mean over pairs.

    Also f32[n, n], the curvature there, and bool[], whether the search has converged.
    """
    number, (begin, unravel) = pairs.relation.shape[0], ravel_pytree(start)

    def loss(vector: Array) -> Array:
        free = unravel(vector)
        total = jnp.sum(jax.nn.logsumexp(_log_joint(free, pairs), axis=1))
        return -(total + _log_prior(free, start, prior)) / number

    found = descend(loss, begin, slope_length=_FLAT, max_steps=max_steps)
    # A row at a time: a third of the compilation of ``jax.hessian``.
    curvature = jax.lax.map(
        lambda unit: jax.jvp(jax.grad(loss), (found.point,), (unit,))[1], jnp.eye(len(begin))
    )
    is_converged = jnp.max(jnp.abs(found.slope)) < _CONVERGED
    return unravel(found.point), curvature * number, is_converged


def _standard_errors(
    free: _Free, curvature: Array, num_pairs: Array
) -> tuple[RelationParams, Array]:
    """Carry the curvature over to the parameters and shares (the delta method)."""
    vector, unravel = ravel_pytree(free)
    covariance = np.linalg.pinv(np.asarray(curvature, np.float64), hermitian=True)

    def outputs(values: Array) -> tuple[RelationParams, Array]:
        params, log_share = _decode(unravel(values))
        return params, jnp.exp(log_share)

    slopes = jax.jit(jax.jacfwd(outputs))(vector)
    is_known = np.asarray(num_pairs) > 0

    def error(leaf: Array) -> Array:
        slope = np.asarray(leaf, np.float64)
        variance = np.einsum("...i,ij,...j->...", slope, covariance, slope)
        known = is_known.reshape(-1, *(1,) * (variance.ndim - 1))
        return jnp.asarray(np.sqrt(np.maximum(np.where(known, variance, 0.0), 0.0)), jnp.float32)

    params, share = slopes
    return jax.tree.map(error, params), error(share)


def fit_relations(
    pairs: RelationPairs,
    init: RelationParams | None = None,
    *,
    prior: RelationPrior | None = None,
    max_iterations: int = 200,
) -> RelationFit:
    """Fit relations and the shares of their frames to labelled pairs.

    Words without pairs keep their initial parameters. "Near" and "far" have no direction: only
    their distances are fitted. ``params`` of the fit goes through ``relations.prepare`` into
    ``MapParams.relations``.

    Args:
        pairs: N labelled pairs; see ``relation_pairs.make_pairs``.
        init: where the fit starts and the prior has its centre; the defaults if None.
        prior: how strong it is; about one pair if None.
        max_iterations: of L-BFGS.
    """
    start = _encode(default_params() if init is None else init)
    held = RelationPrior() if prior is None else prior
    free, curvature, is_converged = _maximise(pairs, start, held, jnp.float32(max_iterations))
    num_pairs = jnp.bincount(pairs.relation, length=len(MODELLED))
    params, log_share = _decode(free)
    standard_error, share_error = _standard_errors(free, curvature, num_pairs)
    joint = _log_joint(free, pairs)
    return RelationFit(
        params=params,
        standard_error=standard_error,
        frame_share=jnp.exp(log_share),
        frame_share_error=share_error,
        frame_posterior=jax.nn.softmax(joint, axis=1),
        log_likelihood=jnp.mean(jax.nn.logsumexp(joint, axis=1)),
        log_likelihood_before=jnp.mean(jax.nn.logsumexp(_log_joint(start, pairs), axis=1)),
        num_pairs=num_pairs,
        is_converged=is_converged,
    )


def describe(fit: RelationFit) -> list[dict[str, float | str]]:
    """List what has been fitted, a row for each word with pairs.

    ``relation``, ``pairs``, ``distance`` (median, metres), ``spread``, ``axis`` (degrees),
    ``concentration``, each with its standard error ``…_se``, and the shares of the frames.
    """
    rows: list[dict[str, float | str]] = []
    params, error = fit.params, fit.standard_error
    for index in np.flatnonzero(fit.num_pairs):
        median = jnp.exp(params.log_distance[index])
        numbers = {
            "distance": median,
            "distance_se": median * error.log_distance[index],
            "spread": params.log_distance_sd[index],
            "spread_se": error.log_distance_sd[index],
            "axis": jnp.rad2deg(params.axis[index]),
            "axis_se": jnp.rad2deg(error.axis[index]),
            "concentration": params.concentration[index],
            "concentration_se": error.concentration[index],
        }
        for end, shares in (("", fit.frame_share), ("_se", fit.frame_share_error)):
            named = zip(FRAMES, shares[index], strict=True)
            numbers |= {f"share_{frame}{end}": share for frame, share in named}
        rows.append(
            {"relation": REGISTRY[MODELLED[index]].name, "pairs": int(fit.num_pairs[index])}
            | {name: float(number) for name, number in numbers.items()}
        )
    return rows
