"""Spatial relations as differentiable, normalised log-densities (section 3.2, eq. 7a).

A relation says where a figure lies, given a landmark and a frame. In polar coordinates about
the landmark the distance is log-normal and the direction von Mises about the relation's axis:

    f(o) = LogNormal(r; μ, σ) · VonMises(Δ; κ) / r,      r = |o|,  Δ = ∠(o, axis)

so "behind" is directed (κ > 0) and "near" a ring (κ = 0); ∫ f(o) do = 1 for every relation.
The frame is the viewer's at the moment of the utterance: "behind the cone" lies beyond the cone
as seen from where the person spoke. Where the robot itself is the landmark ("on your left"), the
frame is the robot's own at that moment.

x and y stand apart everywhere: XLA on CPU vectorises badly over a trailing axis of two.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from jaxlangnav.messages import FAR, NEAR
from jaxlangnav.numerics.axes import lead, pick
from jaxlangnav.pytree import pytree

NUM_QUANTILES = 256
"""Resolution of the tabulated von Mises quantile function used for sampling."""
MAX_NORMAL = 4.5
"""Standard normal draws are clipped here when they choose an angle."""
# Axis of each relation in (along, lateral): behind is further along the line of sight.
_AXIS_ALONG = (-1.0, 1.0, 0.0, 0.0, 1.0, 1.0)
_AXIS_LATERAL = (0.0, 0.0, 1.0, -1.0, 0.0, 0.0)
_HOLDS_MIN_COSINE = 0.7071  # within 45 degrees of the axis
_HOLDS_MAX_DISTANCE = 5.0  # metres; "far" begins where the others end


@pytree
class RelationParams:
    """Free parameters of the six relations, in the order of ``messages.RELATIONS``."""

    log_distance: Array  # f32[6] μ, log metres
    log_distance_sd: Array  # f32[6] σ, dimensionless
    axis: Array  # f32[6] radians, direction in the frame, 0: along, π/2: to the left
    concentration: Array  # f32[6] κ; 0 is undirected


@pytree
class RelationModel:
    """``RelationParams`` made ready for the filter: constants and sampling tables."""

    log_distance: Array  # f32[6]
    log_distance_sd: Array  # f32[6]
    axis_along: Array  # f32[6] cosine of the axis
    axis_lateral: Array  # f32[6] sine of the axis
    concentration: Array  # f32[6]
    log_constant: Array  # f32[6] log normaliser of the density
    angle_quantile: Array  # f32[6, Q + 1] radians, |Δ| at equal steps of a normal's quantile


@pytree
class Law:
    """The density of one relation, or of each particle's: numbers picked from the model."""

    log_distance: Array  # f32[...]
    log_distance_sd: Array  # f32[...]
    axis_along: Array  # f32[...]
    axis_lateral: Array  # f32[...]
    concentration: Array  # f32[...]
    log_constant: Array  # f32[...]


@pytree
class Frame:
    """Orthonormal directions in which a relation is understood, map frame."""

    along_x: Array  # f32[...]
    along_y: Array  # f32[...]
    lateral_x: Array  # f32[...]
    lateral_y: Array  # f32[...]


def default_params() -> RelationParams:
    """Build plausible relations: an object's neighbourhood is a few metres."""
    pi = jnp.pi
    return RelationParams(
        log_distance=jnp.log(jnp.array([2.4, 2.4, 2.4, 2.4, 2.2, 8.0], jnp.float32)),
        log_distance_sd=jnp.array([0.35, 0.35, 0.35, 0.35, 0.35, 0.4], jnp.float32),
        axis=jnp.array([pi, 0.0, pi / 2, -pi / 2, 0.0, 0.0], jnp.float32),
        concentration=jnp.array([12.0, 12.0, 12.0, 12.0, 0.0, 0.0], jnp.float32),
    )


def prepare(params: RelationParams) -> RelationModel:
    """Compute what the density and the sampler need once per set of parameters.

    Args:
        params: free parameters, f32[6] each; ``log_distance_sd`` > 0, ``concentration`` >= 0.

    Returns:
        Constants and the quantile table of the von Mises angle; differentiable in ``params``.
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


def viewer_frame(
    viewer_x: ArrayLike, viewer_y: ArrayLike, landmark_x: ArrayLike, landmark_y: ArrayLike
) -> Frame:
    """Build the frame of somebody who looks at the landmark.

    Args:
        viewer_x: f32[...], metres, map frame: where the viewer stands.
        viewer_y: f32[...], metres.
        landmark_x: f32[...], metres, map frame.
        landmark_y: f32[...], metres.

    Returns:
        ``along`` points from the viewer through the landmark, ``lateral`` to the viewer's left.
    """
    dx, dy = jnp.subtract(landmark_x, viewer_x), jnp.subtract(landmark_y, viewer_y)
    scale = jax.lax.rsqrt(dx * dx + dy * dy + 1e-12)
    ux, uy = dx * scale, dy * scale
    return Frame(along_x=ux, along_y=uy, lateral_x=-uy, lateral_y=ux)


def robot_frame(heading: Array) -> Frame:
    """Build the frame of the robot as its own landmark: "in front of you" is where it heads.

    Args:
        heading: f32[...], radians, map frame.

    Returns:
        ``along`` points backwards (for "behind"), ``lateral`` to the robot's left.
    """
    cosine, sine = jnp.cos(heading), jnp.sin(heading)
    return Frame(along_x=-cosine, along_y=-sine, lateral_x=-sine, lateral_y=cosine)


def law_of(model: RelationModel, relation: ArrayLike) -> Law:
    """Pick the numbers of a relation.

    Args:
        model: prepared relations.
        relation: i32[...], relation index in [0, 6).

    Returns:
        Its law, leaves f32[...].
    """
    fields = dataclasses.fields(Law)
    index = jnp.asarray(relation)
    return Law(**{field.name: pick(getattr(model, field.name), index) for field in fields})


def log_density(
    model: RelationModel, relation: ArrayLike, offset_x: Array, offset_y: Array, frame: Frame
) -> Array:
    """Evaluate ``log_density_of`` for a relation by its index in [0, 6), i32[]."""
    return log_density_of(law_of(model, relation), offset_x, offset_y, frame)


def log_density_of(law: Law, offset_x: Array, offset_y: Array, frame: Frame) -> Array:
    """Evaluate how likely a relation places its figure at an offset from the landmark.

        log f = c − 2 log r − (log r − μ)² / 2σ² + κ (cos Δ − 1)

    Limits: κ = 0 depends on the distance alone; r → 0 and r → ∞ give −∞ smoothly.

    Args:
        law: of the relation, f32[] or f32[P], P the last axis of the offset.
        offset_x: f32[...], figure minus landmark, metres, map frame.
        offset_y: f32[...], metres.
        frame: directions, broadcastable to the offset.

    Returns:
        f32[...], log of the density per square metre.
    """
    squared = offset_x * offset_x + offset_y * offset_y + 1e-6

    law = jax.tree.map(lambda leaf: lead(leaf, squared.ndim), law)
    log_distance = 0.5 * jnp.log(squared)
    along = offset_x * frame.along_x + offset_y * frame.along_y
    lateral = offset_x * frame.lateral_x + offset_y * frame.lateral_y
    cosine = (along * law.axis_along + lateral * law.axis_lateral) * jax.lax.rsqrt(squared)
    standard = (log_distance - law.log_distance) / law.log_distance_sd
    return (
        law.log_constant
        - 2.0 * log_distance
        - 0.5 * standard * standard
        + law.concentration * (cosine - 1.0)
    )


def sample_polar(
    model: RelationModel, relation: ArrayLike, distance_normal: Array, angle_normal: Array
) -> tuple[Array, Array]:
    """Draw an offset from a relation in frame coordinates.

    Args:
        model: prepared relations.
        relation: i32[...] or i32[], relation index in [0, 6).
        distance_normal: f32[...], standard normal draws.
        angle_normal: f32[...], standard normal draws, turned into angles by their quantile.

    Returns:
        f32[...] along and f32[...] lateral, metres, in the frame of ``log_density``.
    """
    law = law_of(model, relation)
    distance = jnp.exp(law.log_distance + law.log_distance_sd * distance_normal)
    position = jnp.minimum(jnp.abs(angle_normal), MAX_NORMAL) * (NUM_QUANTILES / MAX_NORMAL)
    lower = jnp.clip(position.astype(jnp.int32), 0, NUM_QUANTILES - 1)
    fraction = position - lower
    table = model.angle_quantile
    angle = table[relation, lower] * (1.0 - fraction) + table[relation, lower + 1] * fraction
    angle = jnp.where(angle_normal < 0.0, -angle, angle)
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    along = distance * (law.axis_along * cosine - law.axis_lateral * sine)
    lateral = distance * (law.axis_lateral * cosine + law.axis_along * sine)
    return along, lateral


def to_map(frame: Frame, along: Array, lateral: Array) -> tuple[Array, Array]:
    """Turn frame coordinates into map axes.

    Args:
        frame: directions, broadcastable to the coordinates.
        along: f32[...], metres.
        lateral: f32[...], metres.

    Returns:
        f32[...] x and f32[...] y, metres, map axes.
    """
    return (
        along * frame.along_x + lateral * frame.lateral_x,
        along * frame.along_y + lateral * frame.lateral_y,
    )


def holds(
    relation: int,
    figure: ArrayLike,
    landmark: ArrayLike,
    viewer: ArrayLike,
    heading: float | None = None,
) -> Array:
    """Decide whether a relation holds between known positions, as people would say it.

    Directed relations hold within 45 degrees of their axis and 5 m of the landmark, "near"
    within 5 m, "far" beyond. Used for worlds whose truth is known (labels, the known-map
    baseline), never by the filter.

    Args:
        relation: relation index in [0, 6).
        figure: f32[..., 2], metres, map frame.
        landmark: f32[..., 2], metres, map frame.
        viewer: f32[..., 2], where the speaker and robot stand at the utterance.
        heading: radians; given where the landmark is the robot itself.

    Returns:
        bool[...].
    """
    figure, landmark, viewer = jnp.asarray(figure), jnp.asarray(landmark), jnp.asarray(viewer)
    if heading is None:
        frame = viewer_frame(viewer[..., 0], viewer[..., 1], landmark[..., 0], landmark[..., 1])
    else:
        frame = robot_frame(jnp.asarray(heading, jnp.float32))
    x, y = figure[..., 0] - landmark[..., 0], figure[..., 1] - landmark[..., 1]
    distance = jnp.sqrt(x * x + y * y)
    if relation == NEAR:
        return distance <= _HOLDS_MAX_DISTANCE
    if relation == FAR:
        return distance > _HOLDS_MAX_DISTANCE
    along = x * frame.along_x + y * frame.along_y
    lateral = x * frame.lateral_x + y * frame.lateral_y
    projection = along * _AXIS_ALONG[relation] + lateral * _AXIS_LATERAL[relation]
    return (projection >= _HOLDS_MIN_COSINE * distance) & (distance <= _HOLDS_MAX_DISTANCE)
