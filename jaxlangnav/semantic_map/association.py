"""Data association: sample the object of each detection (section 3.2, eq. 7b).

Each detection is associated with an existing object of its type or a new one, sampled from the
exact conditional distribution, so that the weight is the predictive probability of the detections.

Everything takes one particle, or all of them with the particle axis last ("…" in shapes).
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.object_types import label_of, merge_types
from jaxlangnav.messages import NONE, SensorParams
from jaxlangnav.numerics import categorical
from jaxlangnav.numerics.batching import append_axes, prepend_axes
from jaxlangnav.semantic_map.counts import raise_existence
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.terrain import RANGING, SensorModel

MIN_LOG_NEW = -30.0
"""Lower bound of the log miss probability of a new object, so that no weight becomes zero."""


class Detections(NamedTuple):
    """Detections of one observation in map axes, relative to the robot."""

    object_type: Array  # i32[D] type codes
    offset_x: Array  # f32[D] metres, map axes; f32[D, 1, ...] where particles differ
    offset_y: Array  # see ``offset_x``
    log_new: Array  # f32[D] log density of reports of a new object there; f32[D, ...] where offsets
    # differ
    is_detection: Array  # bool[D] valid entry


class ClutterOdds(NamedTuple):
    """Log-odds of false and mislabelled detections relative to correct ones."""

    log_false: Array  # f32[] density of false detections of a type
    log_confused: Array  # f32[] odds that an object is given a wrong type
    log_specific: Array  # f32[] … that it is given a specific wrong type


def clutter_odds(sensor: SensorParams, num_types: Array, model: SensorModel) -> ClutterOdds:
    """Compute the odds of clutter and confusion of a sensor; −∞ where it has none.

    Its detection probability is that of correct labels; T types are distinguished, i32[].
    """

    def log_of(odds_value: Array) -> Array:
        return jnp.where(odds_value > 0.0, jnp.log(jnp.maximum(odds_value, 1e-30)), -jnp.inf)

    view_area = 0.5 * sensor.field_of_view * sensor.range_max**2
    rate = sensor.false_detections / jnp.maximum(sensor.detection_probability, 1e-3)
    odds = sensor.mislabelled / (1.0 - sensor.mislabelled)
    return ClutterOdds(
        log_false=log_of(rate / view_area) + model.log_volume(sensor),
        log_confused=log_of(odds),
        log_specific=log_of(odds / jnp.maximum(num_types - 1, 1)),
    )


class Association(NamedTuple):
    """Data association of the detections in one particle."""

    object_type: Array  # i32[O, ...] type codes, with new objects added
    is_hit: Array  # bool[O, ...] detected in this observation
    is_new: Array  # bool[O, ...] entered in this observation
    offset_x: Array  # f32[O, ...] measured offset where hit
    offset_y: Array  # f32[O, ...]
    log_weight: Array  # f32[...] log predictive probability
    overflow: Array  # i32[...] detections for which no object slot was free
    existence: Array  # f32[O, ...] as in the particle


def associate(
    particle: SemanticMap,
    detections: Detections,
    uniform: Array,
    sensor: SensorParams,
    growth: Array | float = 0.0,
    clutter: ClutterOdds | None = None,
    *,
    is_pooled: bool = False,
    model: SensorModel = RANGING,
) -> Association:
    """Sample for each detection an existing object or a new one (eq. 7b).

        p(z_j is o) ∝ p(z_j | x_o − x_robot, S_o),   p(z_j is new) ∝ λ m(z_j)

    with S from the joint covariance of robot and object, λ = α / A the density of objects not yet
    seen and m the probability of having missed one there. An object is detected at most once.
    ``uniform`` is f32[D, ...] in [0, 1); ``growth``, κ / α, the relative increase of λ for each
    observed object of the type, or of any if pooled; particles with existence have ``clutter``.
    """
    num_objects = particle.object_type.shape[0]
    diagonal = jnp.stack([particle.covariance[slot, slot] for slot in range(num_objects)])
    robot_cov = particle.covariance[num_objects]
    variance = diagonal + robot_cov[num_objects:] - 2.0 * robot_cov[:num_objects]
    x = particle.mean_x[:num_objects] - particle.mean_x[num_objects:]
    y = particle.mean_y[:num_objects] - particle.mean_y[num_objects:]
    predicted = (x, y), jnp.maximum(variance, 0.0) + model.variance(x, y, sensor)
    weigh = functools.partial(_log_weights, growth=growth, clutter=clutter, is_pooled=is_pooled)

    def scan(carry: Association, detection: tuple[Detections, Array]) -> tuple[Association, None]:
        return _associate_one(carry, *detection, model, predicted, weigh), None

    false, zeros = jnp.zeros(x.shape, bool), jnp.zeros_like(x)
    init = Association(
        object_type=particle.object_type,
        is_hit=false,
        is_new=false,
        offset_x=zeros,
        offset_y=zeros,
        log_weight=zeros[0],
        overflow=jnp.zeros(zeros.shape[1:], jnp.int32),
        existence=particle.existence,
    )
    return jax.lax.scan(scan, init, (detections, uniform))[0]


def _associate_one(
    carry: Association,
    z: Detections,
    uniform: Array,
    model: SensorModel,
    predicted: tuple[tuple[Array, Array], Array],
    weigh: Callable[..., Any],
) -> Association:
    """Associate one detection z, leaves [], given the associations of earlier ones."""
    num_objects, code, is_valid = carry.object_type.shape[0], z.object_type, z.is_detection
    log_existing, x, y = model.match((z.offset_x, z.offset_y), *predicted)
    log_weight, posterior = weigh(z, log_existing, carry)
    choice, log_total = categorical.draw(log_weight, uniform)
    slots = append_axes(jnp.arange(num_objects), carry.object_type.ndim)
    free = jnp.min(jnp.where(carry.object_type == NONE, slots, num_objects), axis=0)
    is_new = choice == num_objects
    slot = jnp.where(is_new, free, choice)
    entry, existence = (slots == slot[None]) & is_valid, carry.existence
    if posterior is not None:
        if_existing, others_if_new = posterior
        existence = jnp.where(is_new & is_valid, others_if_new, existence)
        existence = jnp.where(entry, if_existing, existence)
    new_type = jnp.where(is_new, code, merge_types(carry.object_type, code))
    return Association(
        object_type=jnp.where(entry, new_type, carry.object_type),
        is_hit=carry.is_hit | entry,
        is_new=carry.is_new | (entry & is_new[None]),
        offset_x=jnp.where(entry, jnp.where(is_new, z.offset_x, x), carry.offset_x),
        offset_y=jnp.where(entry, jnp.where(is_new, z.offset_y, y), carry.offset_y),
        log_weight=carry.log_weight + jnp.where(is_valid, log_total, 0.0),
        overflow=carry.overflow + (is_valid & (slot == num_objects)).astype(jnp.int32),
        existence=existence,
    )


def _log_weights(
    z: Detections,
    log_existing: Array,
    carry: Association,
    growth: Array | float,
    clutter: ClutterOdds | None,
    is_pooled: bool,
) -> tuple[Array, tuple[Array, Array] | None]:
    """Compute the log-weights of a detection's associations, f32[O + 1, ...], a new object last.

    And f32[O, ...] twice, existence probabilities afterwards: of the associated slot, and of the
    others if the object is new. None if every detected object exists. With clutter,

        p(z is o) ∝ (r + (1 − r) h) N,   p(z is new) ∝ λ m + c,   c = c₀ + λ₀ m k + h Σ_other r N

    with r the probability that o exists, c₀ the density of false detections, k the odds that a
    label is wrong and h those of a certain wrong one; λ₀ is λ of a type without observed objects.
    """
    # Attributes are ignored: inconsistent attributes must not split one object into two.
    is_alike, log_new = label_of(carry.object_type) == label_of(z.object_type), z.log_new
    is_candidate = is_alike & ~carry.is_hit
    is_counted = carry.object_type != NONE if is_pooled else is_alike
    existence = carry.existence
    counted = is_counted if clutter is None else jnp.where(is_counted, existence, 0.0)
    log_more = (log_new + jnp.log1p(growth * jnp.sum(counted, axis=0)))[None]
    if clutter is None:
        return jnp.concatenate([jnp.where(is_candidate, log_existing, -jnp.inf), log_more]), None
    is_other = ~is_alike & (carry.object_type != NONE)
    log_confused = prepend_axes(log_new + clutter.log_confused, log_more.ndim)
    log_exists = jnp.log(jnp.maximum(existence, 1e-9))
    log_mislabelled = jnp.log(jnp.maximum(1.0 - existence, 1e-9)) + clutter.log_specific
    log_match = jnp.logaddexp(log_exists, log_mislabelled)
    log_others = jnp.where(is_other, log_existing + log_exists + clutter.log_specific, -jnp.inf)
    log_others = jax.scipy.special.logsumexp(log_others, axis=0, keepdims=True)
    log_false = jnp.logaddexp(clutter.log_false, log_confused)
    log_any = jnp.logaddexp(log_more, jnp.logaddexp(log_false, log_others))
    prob_real = jnp.exp(log_more - log_any)
    if_existing = jnp.where(existence > 0.0, jnp.exp(log_exists - log_match), prob_real)
    others_if_new = jnp.where(is_counted, raise_existence(counted, growth, prob_real[0]), existence)
    log_old = jnp.where(is_candidate, log_existing + log_match, -jnp.inf)
    return jnp.concatenate([log_old, log_any]), (if_existing, others_if_new)
