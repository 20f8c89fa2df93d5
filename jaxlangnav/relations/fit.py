"""Maximum a posteriori fit of relations to labelled pairs (section 3.2, eq. 7a).

A labelled pair is a figure, a landmark, the relation between them, the speaker's pose at the
utterance and the robot's pose now. The intended frame is not labelled, so each pair is a mixture
over three of them,

    p(o | word) = Σ_k π_k f(o; θ, frame_k),   k: viewer's frame at the utterance,
                                                 robot's present frame, undirected (κ = 0)

with the density f of ``relations`` and mixture weights π of each relation. Parameters and weights
maximise the posterior by L-BFGS on exact gradients, and the curvature there gives standard errors.
The frame of each pair is reported as a posterior.

The filter uses relations in the viewer's frame alone. Relations are "front" to "far".
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree

from jaxlangnav.messages import RELATIONS
from jaxlangnav.numerics.descent import descend
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.relations import (
    REGISTRY,
    SIDES,
    ReferenceFrame,
    RelationParams,
    default_params,
    density_of,
    log_density,
    prepare,
    robot_frame,
    viewer_frame,
)
from jaxlangnav.relations.table import MODELLED

FRAMES = ("viewer", "robot", "undirected")
"""Frames of reference of the mixture, in the order of every axis F."""
_RINGS = [row for row, index in enumerate(MODELLED) if index not in SIDES]
"""Undirected relations: κ stays 0, and all frames are equivalent."""
_MIN_CONCENTRATION = 1e-3
_PRIOR_SD = {"log_distance": 1.0, "log_distance_sd": 1.0, "axis": 1.5, "concentration": 1.5}
"""Standard deviations of the Gaussian prior about the start of the fit, of log σ and log κ in place
of σ and κ: it is worth about one pair, so that it matters only without data."""
_PRIOR_FRAME_PAIRS = 1.0
"""Number of pairs that the uniform prior on frames is worth."""
_MAX_STEPS = 200.0
_GRADIENT_TOL, _CONVERGED_TOL = 1e-4, 0.1
"""Norm of the mean gradient that ends the search, where rounding does not end it before, and the
maximum distance to the optimum, in standard errors, at convergence."""


@pytree
class RelationPairs:
    """Labelled pairs; metres and radians, map frame."""

    relation: Array  # i32[N] index into ``messages.RELATIONS``
    figure: Array  # f32[N, 2] x, y
    landmark: Array  # f32[N, 2] ignored where the landmark is the robot
    is_robot: Array  # bool[N] the landmark is the robot itself ("on your left")
    viewer: Array  # f32[N, 3] x, y, heading of speaker and robot at the utterance
    robot: Array  # f32[N, 3] x, y, heading of the robot now


def make_pairs(
    relation: np.ndarray,
    figure: np.ndarray,
    landmark: np.ndarray,
    viewer: np.ndarray,
    robot: np.ndarray | None = None,
    is_robot: np.ndarray | None = None,
) -> RelationPairs:
    """Validate N labelled pairs and convert them to arrays (host only).

    Args:
        relation: i[N], index into ``messages.RELATIONS``.
        figure: f[N, 2], metres, map frame.
        landmark: f[N, 2], metres.
        viewer: f[N, 3], x, y, heading at the utterance, metres and radians.
        robot: f[N, 3], the robot's present pose; the viewer's by default.
        is_robot: bool[N], the landmark is the robot itself; False by default.

    Raises:
        ValueError: no pairs, shapes that do not agree, an unknown relation, numbers that are not
            finite.
    """
    index = np.atleast_1d(np.asarray(relation))
    if (num_pairs := len(index)) == 0:
        raise ValueError("there are no pairs to fit relations to")
    if index.ndim > 1:
        raise ValueError(f"relation has shape {index.shape}, but must have ({num_pairs},)")
    fields = {
        "figure": np.asarray(figure, np.float32),
        "landmark": np.asarray(landmark, np.float32),
        "viewer": np.asarray(viewer, np.float32),
        "robot": np.asarray(viewer if robot is None else robot, np.float32),
        "is_robot": np.zeros(num_pairs, bool) if is_robot is None else np.asarray(is_robot, bool),
    }
    sizes = {"figure": (2,), "landmark": (2,), "viewer": (3,), "robot": (3,), "is_robot": ()}
    for name, values in fields.items():
        shape = (num_pairs, *sizes[name])
        if values.shape != shape:
            raise ValueError(f"{name} has shape {values.shape}, but {num_pairs} pairs need {shape}")
        if not np.isfinite(values).all():
            raise ValueError(f"{name} holds numbers that are not finite: leave those pairs out")
    if not np.isin(index, np.arange(len(RELATIONS))).all():
        raise ValueError(
            f"relation must be an index from 0 to {len(RELATIONS) - 1} ({', '.join(RELATIONS)})"
        )
    arrays = {name: jnp.asarray(values) for name, values in fields.items()}
    return RelationPairs(relation=jnp.asarray(index, jnp.int32), **arrays)


def _in_frame(pairs: RelationPairs, pose: Array) -> tuple[Array, Array, ReferenceFrame]:
    """Compute offsets and reference frames of the pairs for a pose f32[N, 3]."""
    x, y = jnp.where(pairs.is_robot[:, None], pose[:, :2], pairs.landmark).T
    extrinsic, intrinsic = viewer_frame(pose[:, 0], pose[:, 1], x, y), robot_frame(pose[:, 2])
    frame = jax.tree.map(lambda i, e: jnp.where(pairs.is_robot, i, e), intrinsic, extrinsic)
    return pairs.figure[:, 0] - x, pairs.figure[:, 1] - y, frame


def log_frame_densities(pairs: RelationPairs, *, params: RelationParams) -> Array:
    """Evaluate the log-density of every pair in every frame, f32[N, F] per square metre.

    Without the mixture weights of the frames. Limits: κ = 0 makes the viewer's frame and
    "undirected" the same; without motion since the utterance the robot's frame is the viewer's.
    """
    by_viewer = _in_frame(pairs, pairs.viewer)
    by_robot = _in_frame(pairs, pairs.robot)
    undirected = replace(params, concentration=jnp.zeros_like(params.concentration))
    directed, ring = (density_of(prepare(each), pairs.relation) for each in (params, undirected))
    components = ((directed, by_viewer), (directed, by_robot), (ring, by_viewer))
    return jnp.stack([log_density(pdf, *offset) for pdf, offset in components], axis=1)


@pytree
class RelationFit:
    """Fitted relations with standard errors and diagnostics."""

    params: RelationParams
    standard_error: RelationParams  # of each parameter; 0 where it was not fitted
    frame_share: Array  # f32[R, F] π, mixture weights of each relation's frames, sum to one
    frame_share_error: Array  # f32[R, F]
    frame_posterior: Array  # f32[N, F] posterior of each pair's frame
    log_likelihood: Array  # f32[] mean over the pairs, log of a density per square metre
    log_likelihood_before: Array  # f32[] at the start: initial parameters, uniform frames
    num_pairs: Array  # i32[R] number of pairs of each relation
    is_converged: Array  # bool[] the optimum is within a tenth of a standard error


_Free = tuple[RelationParams, Array]
"""Unconstrained parameters: relations with log σ and log κ in place of σ and κ, and logits of the
frames f32[R, F]."""


def _decode(free: _Free) -> tuple[RelationParams, Array]:
    """Transform unconstrained parameters to relations and log mixture weights f32[R, F]."""
    params, logit = free
    is_ring = jnp.isin(jnp.arange(len(MODELLED)), jnp.asarray(_RINGS))
    concentration = jnp.where(is_ring, 0.0, jnp.exp(params.concentration))
    spread = jnp.exp(params.log_distance_sd)
    params = replace(params, log_distance_sd=spread, concentration=concentration)
    return params, jax.nn.log_softmax(logit, axis=1)


def _encode(params: RelationParams) -> _Free:
    """Transform relations to unconstrained parameters, with uniform frames."""
    log_spread = jnp.log(params.log_distance_sd)
    log_concentration = jnp.log(jnp.maximum(params.concentration, _MIN_CONCENTRATION))
    params = replace(params, log_distance_sd=log_spread, concentration=log_concentration)
    return params, jnp.zeros((len(MODELLED), len(FRAMES)), jnp.float32)


def _log_joint(free: _Free, pairs: RelationPairs) -> Array:
    """Compute the log joint density of every pair and its frame, f32[N, F]."""
    params, log_weight = _decode(free)
    return log_frame_densities(pairs, params=params) + log_weight[pairs.relation]


def _log_prior(free: _Free, start: _Free) -> Array:
    """Compute the log-prior of the unconstrained parameters, up to a constant."""
    log_probs = jax.tree.map(
        lambda value, centre, deviation: -0.5 * jnp.sum(((value - centre) / deviation) ** 2),
        free[0],
        start[0],
        replace(start[0], **_PRIOR_SD),
    )
    frames = _PRIOR_FRAME_PAIRS / len(FRAMES) * jnp.sum(jax.nn.log_softmax(free[1], axis=1))
    # The softmax is invariant to the sum of the logits: regularise it to zero.
    anchor = -0.5 * jnp.sum(jnp.sum(free[1], axis=1) ** 2)
    return sum(jax.tree.leaves(log_probs)) + frames + anchor


@jax.jit
def _maximise(pairs: RelationPairs, start: _Free) -> tuple[_Free, Array, Array]:
    """Minimise the mean loss over pairs by L-BFGS, from the centre of the prior.

    Also f32[n, n], the curvature at the optimum, and bool[], whether the search has converged.
    """
    num_pairs, (init, unravel) = pairs.relation.shape[0], ravel_pytree(start)

    def loss(vector: Array) -> Array:
        free = unravel(vector)
        total = jnp.sum(jax.nn.logsumexp(_log_joint(free, pairs), axis=1))
        return -(total + _log_prior(free, start)) / num_pairs

    optimum = descend(loss, init, gradient_norm=_GRADIENT_TOL, max_steps=_MAX_STEPS)
    # Row by row: a third of the compilation time of ``jax.hessian``.
    curvature = jax.lax.map(
        lambda unit: jax.jvp(jax.grad(loss), (optimum.point,), (unit,))[1], jnp.eye(len(init))
    )
    squared_distance = num_pairs * optimum.grad @ jnp.linalg.solve(curvature, optimum.grad)
    is_converged = squared_distance < _CONVERGED_TOL**2
    return unravel(optimum.point), curvature * num_pairs, is_converged


def _standard_errors(free: _Free, curvature: Array, counts: Array) -> tuple[RelationParams, Array]:
    """Compute standard errors of parameters and weights from the curvature (delta method)."""
    vector, unravel = ravel_pytree(free)
    covariance = np.linalg.pinv(np.asarray(curvature, np.float64), hermitian=True)

    def outputs(values: Array) -> tuple[RelationParams, Array]:
        params, log_weight = _decode(unravel(values))
        return params, jnp.exp(log_weight)

    params, weight = jax.jit(jax.jacfwd(outputs))(vector)
    has_pairs = np.asarray(counts) > 0

    def error(leaf: Array) -> Array:
        jacobian = np.asarray(leaf, np.float64)
        variance = np.einsum("...i,ij,...j->...", jacobian, covariance, jacobian)
        variance = np.where(has_pairs.reshape(-1, *(1,) * (variance.ndim - 1)), variance, 0.0)
        return jnp.asarray(np.sqrt(np.maximum(variance, 0.0)), jnp.float32)

    return jax.tree.map(error, params), error(weight)


def fit_relations(pairs: RelationPairs) -> RelationFit:
    """Fit relations and the mixture weights of their frames to labelled pairs.

    The default parameters are the start of the fit and the centre of the prior; relations without
    pairs keep them. "Near" and "far" have no direction: only their distances are fitted. ``params``
    of the fit goes through ``relations.prepare`` into ``MapParams.relations``.

    Args:
        pairs: N labelled pairs, of ``make_pairs``.
    """
    start = _encode(default_params())
    free, curvature, is_converged = _maximise(pairs, start)
    num_pairs = jnp.bincount(pairs.relation, length=len(MODELLED))
    params, log_weight = _decode(free)
    standard_error, weight_error = _standard_errors(free, curvature, num_pairs)
    joint = _log_joint(free, pairs)
    return RelationFit(
        params=params,
        standard_error=standard_error,
        frame_share=jnp.exp(log_weight),
        frame_share_error=weight_error,
        frame_posterior=jax.nn.softmax(joint, axis=1),
        log_likelihood=jnp.mean(jax.nn.logsumexp(joint, axis=1)),
        log_likelihood_before=jnp.mean(jax.nn.logsumexp(_log_joint(start, pairs), axis=1)),
        num_pairs=num_pairs,
        is_converged=is_converged,
    )


def describe(fit: RelationFit) -> list[dict[str, float | str]]:
    """List the fitted parameters, a row for each relation with pairs.

    ``relation``, ``pairs``, ``distance`` (median, metres), ``spread``, ``axis`` (degrees),
    ``concentration``, each with its standard error ``…_se``, and the shares of the frames.
    """
    params, error = fit.params, fit.standard_error
    median = jnp.exp(params.log_distance)
    columns = {
        "distance": (median, median * error.log_distance),
        "spread": (params.log_distance_sd, error.log_distance_sd),
        "axis": (jnp.rad2deg(params.axis), jnp.rad2deg(error.axis)),
        "concentration": (params.concentration, error.concentration),
    }
    for frame, name in enumerate(FRAMES):
        columns[f"share_{name}"] = fit.frame_share[:, frame], fit.frame_share_error[:, frame]
    return [
        {"relation": REGISTRY[MODELLED[index]].name, "pairs": int(fit.num_pairs[index])}
        | {name: float(value[index]) for name, (value, _) in columns.items()}
        | {f"{name}_se": float(deviation[index]) for name, (_, deviation) in columns.items()}
        for index in np.flatnonzero(fit.num_pairs)
    ]
