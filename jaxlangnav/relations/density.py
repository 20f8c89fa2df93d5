"""Spatial relations as differentiable, normalised log-densities (section 3.2, eq. 7a).

A relation says where a figure lies, given a landmark and a frame. In polar coordinates about
the landmark the distance is log-normal and the direction von Mises about the relation's axis:

    f(o) = LogNormal(r; μ, σ) · VonMises(Δ; κ) / r,      r = |o|,  Δ = ∠(o, axis)

so "behind" is directed (κ > 0) and "near" a ring (κ = 0); ∫ f(o) do = 1 for every relation.

x and y stand apart everywhere: XLA on CPU vectorises badly over a trailing axis of two.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from jaxlangnav.numerics.batching import prepend_axes
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.relations.table import ROW, ReferenceFrame, RelationParams, to_frame

NUM_QUANTILES = 256
"""Resolution of the tabulated von Mises quantile function used for sampling."""
MAX_NORMAL = 4.5
"""Standard normal draws are clipped here when they choose an angle."""
SIDE_CONCENTRATION = 4.0
"""κ of a side of the robot: 30 degrees off still fits, the opposite side does not."""


@pytree
class RelationModel:
    """``RelationParams`` made ready for the filter: constants and sampling tables."""

    log_distance: Array  # f32[R]
    log_distance_sd: Array  # f32[R]
    axis_along: Array  # f32[R] cosine of the axis
    axis_lateral: Array  # f32[R] sine of the axis
    concentration: Array  # f32[R]
    log_constant: Array  # f32[R] log normaliser of the density
    angle_quantile: Array  # f32[R, Q + 1] radians, |Δ| at equal steps of a normal's quantile


@pytree
class Law:
    """The density of one relation, or of each particle's: numbers picked from the model."""

    log_distance: Array  # f32[...]
    log_distance_sd: Array  # f32[...]
    axis_along: Array  # f32[...]
    axis_lateral: Array  # f32[...]
    concentration: Array  # f32[...]
    log_constant: Array  # f32[...]
    has_range: Array  # f32[...] 1, or 0 where how far counts for nothing: a side, an order


def prepare(params: RelationParams) -> RelationModel:
    """Compute constants and the quantile table of the von Mises angle, once per set of parameters.

    Differentiable in ``params``, f32[R] each; ``log_distance_sd`` > 0, ``concentration`` >= 0.
    """
    # The angle is symmetric: tabulate |Δ| by its survival function, summed from the far tail so
    # that float32 keeps the rare large angles, at equal steps of a standard normal's quantile.
    angles = jnp.linspace(0.0, jnp.pi, 2049, dtype=jnp.float32)
    density = jnp.exp(params.concentration[:, None] * (jnp.cos(angles)[None, :] - 1.0))
    steps = 0.5 * (density[:, 1:] + density[:, :-1])
    survival = jnp.cumsum(steps[:, ::-1], axis=1)[:, ::-1]
    log_survival = jnp.log(survival) - jnp.log(survival[:, :1])
    levels = jnp.log(2.0) + jax.scipy.stats.norm.logcdf(
        -jnp.linspace(0.0, MAX_NORMAL, NUM_QUANTILES + 1, dtype=jnp.float32)
    )
    quantile = jax.vmap(lambda row: jnp.interp(-levels, -row, angles[:-1]))(log_survival)
    log_constant = -(
        jnp.log(params.log_distance_sd)
        + 0.5 * jnp.log(2 * jnp.pi)
        + jnp.log(2 * jnp.pi * jax.scipy.special.i0e(params.concentration))
    )
    return RelationModel(
        log_distance=params.log_distance,
        log_distance_sd=params.log_distance_sd,
        axis_along=jnp.cos(params.axis),
        axis_lateral=jnp.sin(params.axis),
        concentration=params.concentration,
        log_constant=log_constant,
        angle_quantile=quantile,
    )


def law_of(model: RelationModel, relation: ArrayLike) -> Law:
    """Look up the numbers f32[...] of relations by index, i32[...]."""
    names = [field.name for field in dataclasses.fields(Law) if field.name != "has_range"]
    # One gather for all, of which the slope is one scatter.
    numbers = jnp.stack([getattr(model, name) for name in names])[:, jnp.asarray(ROW)[relation]]
    values = dict(zip(names, jnp.unstack(numbers), strict=True))
    return Law(**values, has_range=jnp.ones_like(values["log_distance"]))


def anywhere(law: Law, is_side: Array, is_order: Array, log_area: Array) -> Law:
    """Say where, but not how far: a side of the robot ("on your left"), or an order alone.

        f = 1 / A · e^κ(cos Δ − 1) / (I₀(κ) e^−κ) of a side,   f = 1 / A of an order

    Limits: over all directions f is 1 / A on average; neither side nor order leaves the law as is.

    Args:
        law: of the relation, leaves f32[...].
        is_side: bool[...].
        is_order: bool[...], nowhere a side as well.
        log_area: f32[], log square metres of the area A.
    """
    kappa = jnp.where(is_side, SIDE_CONCENTRATION, jnp.where(is_order, 0.0, law.concentration))
    log_flat = -log_area - jnp.log(jax.scipy.special.i0e(kappa))
    is_anywhere = is_side | is_order
    return replace(
        law,
        concentration=kappa,
        log_constant=jnp.where(is_anywhere, log_flat, law.log_constant),
        has_range=jnp.where(is_anywhere, 0.0, law.has_range),
    )


def log_density(
    model: RelationModel,
    relation: ArrayLike,
    offset_x: Array,
    offset_y: Array,
    frame: ReferenceFrame,
) -> Array:
    """Evaluate ``log_density_of`` for a relation by its index, i32[]."""
    return log_density_of(law_of(model, relation), offset_x, offset_y, frame)


def log_density_of(law: Law, offset_x: Array, offset_y: Array, frame: ReferenceFrame) -> Array:
    """Evaluate how likely a relation places its figure at an offset from the landmark.

        log f = c − 2 log r − (log r − μ)² / 2σ² + κ (cos Δ − 1)

    Limits: κ = 0 depends on the distance alone; r → 0 and r → ∞ give −∞ smoothly; what says
    nothing of how far (``anywhere``) has the direction alone.

    Args:
        law: of the relation, f32[] or f32[P], P the last axis of the offset.
        offset_x: f32[...], figure minus landmark, metres, map frame.
        offset_y: f32[...], metres.
        frame: directions, broadcastable to the offset.

    Returns:
        f32[...], per square metre.
    """
    along, lateral = to_frame(frame, offset_x, offset_y)
    return _log_density(law, along, lateral, offset_x * offset_x + offset_y * offset_y + 1e-6)


def log_density_in_frame(law: Law, along: Array, lateral: Array) -> Array:
    """Evaluate ``log_density_of`` at an offset in frame coordinates, f32[...] metres each."""
    return _log_density(law, along, lateral, along * along + lateral * lateral + 1e-6)


def _log_density(law: Law, along: Array, lateral: Array, squared: Array) -> Array:
    law = jax.tree.map(lambda leaf: prepend_axes(leaf, squared.ndim), law)
    log_distance = 0.5 * jnp.log(squared)
    cosine = (along * law.axis_along + lateral * law.axis_lateral) * jax.lax.rsqrt(squared)
    standard = (log_distance - law.log_distance) / law.log_distance_sd
    log_range = -2.0 * log_distance - 0.5 * standard * standard
    return law.log_constant + law.has_range * log_range + law.concentration * (cosine - 1.0)


def sample_polar(
    model: RelationModel, relation: ArrayLike, distance_normal: Array, angle_normal: Array
) -> tuple[Array, Array]:
    """Draw f32[...] along and lateral of a relation, by standard normal draws f32[...].

    In metres, in the frame of ``log_density``.
    """
    return sample_law(law_of(model, relation), model, relation, distance_normal, angle_normal)


def sample_law(
    law: Law, model: RelationModel, relation: ArrayLike, distance_normal: Array, angle_normal: Array
) -> tuple[Array, Array]:
    """Draw as ``sample_polar`` does, from a law looked up before; where it has a range."""
    law = jax.tree.map(lambda leaf: prepend_axes(leaf, distance_normal.ndim), law)
    distance = jnp.exp(law.log_distance + law.log_distance_sd * distance_normal)
    position = jnp.minimum(jnp.abs(angle_normal), MAX_NORMAL) * (NUM_QUANTILES / MAX_NORMAL)
    lower = jnp.clip(position.astype(jnp.int32), 0, NUM_QUANTILES - 1)
    fraction = position - lower
    table = model.angle_quantile.reshape(-1)
    cell = jnp.asarray(ROW)[relation] * (NUM_QUANTILES + 1) + lower
    angle = table[cell] * (1.0 - fraction) + table[cell + 1] * fraction
    angle = jnp.where(angle_normal < 0.0, -angle, angle)
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    along = distance * (law.axis_along * cosine - law.axis_lateral * sine)
    lateral = distance * (law.axis_lateral * cosine + law.axis_along * sine)
    return along, lateral
