"""Proposal and update for detections: which object is this? (section 3.2, eq. 7b).

Each detection is grounded in an existing object of its type or in a new one, drawn from the exact
conditional distribution, so that the weight is the predictive probability of the detections.

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
from jaxlangnav.terrain import POSITIONS, SensorModel

MIN_LOG_NEW = -30.0
"""Least log-weight of a detection where nothing can be: surprised, never dead."""


class Detections(NamedTuple):
    """Detections of one observation in map axes, relative to the robot."""

    object_type: Array  # i32[D] kinds
    offset_x: Array  # f32[D] metres, map axes; f32[D, 1, ...] where particles differ
    offset_y: Array  # see ``offset_x``
    log_new: Array  # f32[D] log density of reports like it of what was not yet seen; f32[D, ...]
    # where offsets differ
    is_detection: Array  # bool[D]


class ClutterOdds(NamedTuple):
    """How often a detector reports what is not there, against true detections."""

    log_false: Array  # f32[] density of false detections of a type
    log_confused: Array  # f32[] odds that a thing is given a type that is not its own
    log_as: Array  # f32[] … that it is given a certain one


def clutter_odds(
    sensor: SensorParams, num_types: Array, model: SensorModel = POSITIONS
) -> ClutterOdds:
    """Work out how far detections are to be doubted; −∞ where not at all.

    Args:
        sensor: the specification; its ``detection_probability`` is of detections rightly labelled.
        num_types: i32[], T, types that the detector tells apart.
        model: how it reports.
    """

    def log_of(share: Array) -> Array:
        return jnp.where(share > 0.0, jnp.log(jnp.maximum(share, 1e-30)), -jnp.inf)

    in_view = 0.5 * sensor.field_of_view * sensor.range_max**2
    rate = sensor.false_detections / jnp.maximum(sensor.detection_probability, 1e-3)
    odds = sensor.mislabelled / (1.0 - sensor.mislabelled)
    return ClutterOdds(
        log_false=log_of(rate / in_view) + model.log_volume(sensor),
        log_confused=log_of(odds),
        log_as=log_of(odds / jnp.maximum(num_types - 1, 1)),
    )


class Association(NamedTuple):
    """How one particle grounded the detections."""

    object_type: Array  # i32[O, ...] kinds, new objects entered
    is_hit: Array  # bool[O, ...] detected in this observation
    is_new: Array  # bool[O, ...] entered in this observation
    offset_x: Array  # f32[O, ...] measured offset where hit
    offset_y: Array  # f32[O, ...]
    log_weight: Array  # f32[...] log predictive probability
    overflow: Array  # i32[...] detections that found no free slot
    existence: Array  # f32[O, ...] as in the particle


def associate(
    particle: SemanticMap,
    detections: Detections,
    uniform: Array,
    sensor: SensorParams,
    growth: Array | float = 0.0,
    doubt: ClutterOdds | None = None,
    *,
    is_pooled: bool = False,
    model: SensorModel = POSITIONS,
) -> Association:
    """Ground each detection in an existing object or in a new one (eq. 7b).

        p(z_j is o) ∝ p(z_j | x_o − x_robot, S_o),   p(z_j is new) ∝ λ m(z_j)

    with S from the joint covariance of robot and object, λ = α / A the density of objects not yet
    seen and m the probability of having missed one there. An object is detected at most once.

    Args:
        particle: one particle, after the motion.
        detections: f32[D] each.
        uniform: f32[D, ...], uniform draws in [0, 1).
        sensor: the detector's specification.
        growth: f32[], by how much more of λ each thing of the type that is held makes it (κ / α).
        doubt: how far detections are to be doubted, of particles that hold ``existence``.
        is_pooled: whether things of any type that are held make it more.
        model: how the detector reports.
    """
    num_objects = particle.object_type.shape[0]
    own = jnp.stack([particle.covariance[slot, slot] for slot in range(num_objects)])
    robot = particle.covariance[num_objects]
    spread = own + robot[num_objects:] - 2.0 * robot[:num_objects]
    x = particle.mean_x[:num_objects] - particle.mean_x[num_objects:]
    y = particle.mean_y[:num_objects] - particle.mean_y[num_objects:]
    predicted = (x, y), jnp.maximum(spread, 0.0) + model.variance(x, y, sensor)
    weigh = functools.partial(_weigh, growth=growth, doubt=doubt, is_pooled=is_pooled)

    def ground(so_far: Association, one: tuple[Detections, Array]) -> tuple[Association, None]:
        return _ground(so_far, *one, model, predicted, weigh), None

    nobody, nowhere = jnp.zeros(x.shape, bool), jnp.zeros_like(x)
    before = Association(
        object_type=particle.object_type,
        is_hit=nobody,
        is_new=nobody,
        offset_x=nowhere,
        offset_y=nowhere,
        log_weight=nowhere[0],
        overflow=jnp.zeros(nowhere.shape[1:], jnp.int32),
        existence=particle.existence,
    )
    return jax.lax.scan(ground, before, (detections, uniform))[0]


def _ground(
    so_far: Association,
    seen: Detections,
    chance: Array,
    model: SensorModel,
    predicted: tuple[tuple[Array, Array], Array],
    weigh: Callable[..., Any],
) -> Association:
    """Ground one detection, leaves [], given how those before it are grounded."""
    num_objects, kind, is_there = so_far.object_type.shape[0], seen.object_type, seen.is_detection
    log_existing, x, y = model.match((seen.offset_x, seen.offset_y), *predicted)
    log_weight, doubted = weigh(seen, log_existing, so_far)
    choice, log_total = categorical.draw(log_weight, chance)
    slots = append_axes(jnp.arange(num_objects), so_far.object_type.ndim)
    free = jnp.min(jnp.where(so_far.object_type == NONE, slots, num_objects), axis=0)
    is_new = choice == num_objects
    slot = jnp.where(is_new, free, choice)
    entry, existence = (slots == slot[None]) & is_there, so_far.existence
    if doubted is not None:
        if_held, others_if_new = doubted
        existence = jnp.where(is_new & is_there, others_if_new, existence)
        existence = jnp.where(entry, if_held, existence)
    entered = jnp.where(is_new, kind, merge_types(so_far.object_type, kind))
    return Association(
        object_type=jnp.where(entry, entered, so_far.object_type),
        is_hit=so_far.is_hit | entry,
        is_new=so_far.is_new | (entry & is_new[None]),
        offset_x=jnp.where(entry, jnp.where(is_new, seen.offset_x, x), so_far.offset_x),
        offset_y=jnp.where(entry, jnp.where(is_new, seen.offset_y, y), so_far.offset_y),
        log_weight=so_far.log_weight + jnp.where(is_there, log_total, 0.0),
        overflow=so_far.overflow + (is_there & (slot == num_objects)).astype(jnp.int32),
        existence=existence,
    )


def _weigh(
    seen: Detections,
    log_existing: Array,
    so_far: Association,
    growth: Array | float,
    doubt: ClutterOdds | None,
    is_pooled: bool,
) -> tuple[Array, tuple[Array, Array] | None]:
    """Weigh what a detection may be, f32[O + 1, ...], something new last; log N of each slot given.

    And f32[O, ...] twice, how probable things are then to exist: of the slot that it falls to, and
    of the others if it is something new. None where all that is detected exists. A doubted one has

        p(z is o) ∝ (r + (1 − r) h) N,   p(z is new) ∝ λ m + c,   c = c₀ + λ₀ m k + h Σ_other r N

    with r the probability that o exists, c₀ the density of false detections, k the odds that a
    label is wrong and h those of a certain wrong one; λ₀ is λ of a type of which nothing is held.
    """
    # Attributes decide nothing here: a detector that wavers must not make two of one thing.
    is_alike, log_new = label_of(so_far.object_type) == label_of(seen.object_type), seen.log_new
    may_be = is_alike & ~so_far.is_hit
    is_counted = so_far.object_type != NONE if is_pooled else is_alike
    if doubt is None:
        log_more = (log_new + jnp.log1p(growth * jnp.sum(is_counted, axis=0)))[None]
        return jnp.concatenate([jnp.where(may_be, log_existing, -jnp.inf), log_more]), None
    existence = so_far.existence
    held = jnp.where(is_counted, existence, 0.0)
    log_more = (log_new + jnp.log1p(growth * jnp.sum(held, axis=0)))[None]
    is_other = ~is_alike & (so_far.object_type != NONE)
    log_confused = prepend_axes(log_new + doubt.log_confused, log_more.ndim)
    log_real = jnp.log(jnp.maximum(existence, 1e-9))
    log_mislabelled = jnp.log(jnp.maximum(1.0 - existence, 1e-9)) + doubt.log_as
    log_own = jnp.logaddexp(log_real, log_mislabelled)
    of_others = jnp.where(is_other, log_existing + log_real + doubt.log_as, -jnp.inf)
    of_others = jax.scipy.special.logsumexp(of_others, axis=0, keepdims=True)
    log_false = jnp.logaddexp(doubt.log_false, log_confused)
    log_any = jnp.logaddexp(log_more, jnp.logaddexp(log_false, of_others))
    is_real = jnp.exp(log_more - log_any)
    if_held = jnp.where(existence > 0.0, jnp.exp(log_real - log_own), is_real)
    others_if_new = jnp.where(is_counted, raise_existence(held, growth, is_real[0]), existence)
    log_held = jnp.where(may_be, log_existing + log_own, -jnp.inf)
    return jnp.concatenate([log_held, log_any]), (if_held, others_if_new)
