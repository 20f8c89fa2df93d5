"""Spatial relations as differentiable, normalised log-densities (section 3.2, eq. 7a).

A relation is a density of the figure's position, given a landmark and a frame. In polar coordinates
about the landmark the distance is log-normal and the direction von Mises about the relation's axis:

    f(o) = LogNormal(r; μ, σ) · VonMises(Δ; κ) / r,      r = |o|,  Δ = ∠(o, axis)

so "behind" is directed (κ > 0) and "near" a ring (κ = 0); ∫ f(o) do = 1 for every relation.

x and y are separate arrays throughout: XLA on CPU vectorises badly over a trailing axis of two.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from jaxlangnav.numerics.batching import prepend_axes
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.relations.table import ROW_OF, ReferenceFrame, RelationParams, to_frame

NUM_QUANTILES = 256
"""Resolution of the tabulated von Mises quantile function used for sampling."""
MAX_NORMAL = 4.5
"""Standard normal draws are clipped here when they choose an angle."""
SIDE_CONCENTRATION = 4.0
"""κ of a side of the robot: 30 degrees off still fits, the opposite side does not."""


@pytree
class Density:
    """Density parameters of one relation, or of one per particle, looked up in the model."""

    log_distance: Array  # f32[...]
    log_distance_sd: Array  # f32[...]
    axis_along: Array  # f32[...] cosine of the axis
    axis_lateral: Array  # f32[...] sine of the axis
    concentration: Array  # f32[...]
    log_constant: Array  # f32[...] log normaliser of the density
    has_range: Array  # f32[...] 1, or 0 if distance does not matter: a side, a rank


@pytree
class RelationModel(Density):
    """``RelationParams`` prepared for the filter: densities, leaves [R], and a sampling table."""

    angle_quantile: Array  # f32[R, Q + 1] radians, |Δ| at equal steps of a normal's quantile


def prepare(params: RelationParams) -> RelationModel:
    """Compute the normalisers and the von Mises quantile table of relations.

    Differentiable in ``params``, f32[R] each; ``log_distance_sd`` > 0, ``concentration`` >= 0.
    """
    # The angle is symmetric: tabulate |Δ| by its survival function, summed from the far tail so
    # that float32 keeps the rare large angles, at equal steps of a standard normal's quantile.
    angles = jnp.linspace(0.0, jnp.pi, 2049, dtype=jnp.float32)
    unnormalised = jnp.exp(params.concentration[:, None] * (jnp.cos(angles)[None, :] - 1.0))
    steps = 0.5 * (unnormalised[:, 1:] + unnormalised[:, :-1])
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
        has_range=jnp.ones_like(log_constant),
        angle_quantile=quantile,
    )


def density_of(model: RelationModel, relation: ArrayLike) -> Density:
    """Look up the density parameters f32[...] of relations by index, i32[...]."""
    names = [field.name for field in dataclasses.fields(Density)]
    # A single gather, whose gradient is a single scatter.
    table = jnp.stack([getattr(model, name) for name in names])[:, jnp.asarray(ROW_OF)[relation]]
    return Density(**dict(zip(names, jnp.unstack(table), strict=True)))


def without_range(pdf: Density, is_side: Array, is_ordinal: Array, log_area: Array) -> Density:
    """Drop the range of sides of the robot ("on your left") and of ranks; only direction counts.

        f = 1 / A · e^κ(cos Δ − 1) / (I₀(κ) e^−κ) of a side,   f = 1 / A of a rank

    Limits: over all directions f is 1 / A on average; neither side nor rank leaves f as it is.

    Args:
        pdf: of the relation, leaves f32[...].
        is_side: bool[...].
        is_ordinal: bool[...], a rank ("the second"); never a side as well.
        log_area: f32[], log square metres of the area A.
    """
    kappa = jnp.where(is_side, SIDE_CONCENTRATION, jnp.where(is_ordinal, 0.0, pdf.concentration))
    log_flat = -log_area - jnp.log(jax.scipy.special.i0e(kappa))
    is_rangeless = is_side | is_ordinal
    return replace(
        pdf,
        concentration=kappa,
        log_constant=jnp.where(is_rangeless, log_flat, pdf.log_constant),
        has_range=jnp.where(is_rangeless, 0.0, pdf.has_range),
    )


def log_density(pdf: Density, offset_x: Array, offset_y: Array, frame: ReferenceFrame) -> Array:
    """Evaluate a relation's log-density of its figure at an offset from the landmark.

        log f = c − 2 log r − (log r − μ)² / 2σ² + κ (cos Δ − 1)

    Limits: κ = 0 depends on the distance alone; r → 0 and r → ∞ give −∞ smoothly; without a
    range (``without_range``) only the direction counts.

    Args:
        pdf: of the relation, f32[] or f32[P], P the last axis of the offset.
        offset_x: f32[...], figure minus landmark, metres, map frame.
        offset_y: f32[...], metres.
        frame: directions, broadcastable to the offset.

    Returns:
        f32[...], per square metre.
    """
    along, lateral = to_frame(frame, offset_x, offset_y)
    return _log_density(pdf, along, lateral, offset_x * offset_x + offset_y * offset_y + 1e-6)


def log_density_in_frame(pdf: Density, along: Array, lateral: Array) -> Array:
    """Evaluate ``log_density`` at an offset in frame coordinates, f32[...] metres each."""
    return _log_density(pdf, along, lateral, along * along + lateral * lateral + 1e-6)


def _log_density(pdf: Density, along: Array, lateral: Array, squared: Array) -> Array:
    pdf = jax.tree.map(lambda leaf: prepend_axes(leaf, squared.ndim), pdf)
    log_distance = 0.5 * jnp.log(squared)
    cosine = (along * pdf.axis_along + lateral * pdf.axis_lateral) * jax.lax.rsqrt(squared)
    standard = (log_distance - pdf.log_distance) / pdf.log_distance_sd
    log_range = -2.0 * log_distance - 0.5 * standard * standard
    return pdf.log_constant + pdf.has_range * log_range + pdf.concentration * (cosine - 1.0)


def sample_pdf(
    pdf: Density, model: RelationModel, relation: ArrayLike, normal_r: Array, normal_angle: Array
) -> tuple[Array, Array]:
    """Sample offsets of a relation with a range from standard normals, f32[...] each.

    f32[...] metres along and lateral, in the frame of ``log_density``; ``pdf`` is the relation's.
    """
    pdf = jax.tree.map(lambda leaf: prepend_axes(leaf, normal_r.ndim), pdf)
    distance = jnp.exp(pdf.log_distance + pdf.log_distance_sd * normal_r)
    position = jnp.minimum(jnp.abs(normal_angle), MAX_NORMAL) * (NUM_QUANTILES / MAX_NORMAL)
    lower = jnp.clip(position.astype(jnp.int32), 0, NUM_QUANTILES - 1)
    fraction = position - lower
    table = model.angle_quantile.reshape(-1)
    cell = jnp.asarray(ROW_OF)[relation] * (NUM_QUANTILES + 1) + lower
    angle = table[cell] * (1.0 - fraction) + table[cell + 1] * fraction
    angle = jnp.where(normal_angle < 0.0, -angle, angle)
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    along = distance * (pdf.axis_along * cosine - pdf.axis_lateral * sine)
    lateral = distance * (pdf.axis_lateral * cosine + pdf.axis_along * sine)
    return along, lateral
