"""Proposal and update for detections: which object is this? (section 3.2, eq. 7b).

Each detection is grounded in an existing object of its type or in a new one, drawn from the exact
conditional distribution, so that the weight is the predictive probability of the detections.

Everything takes one particle, or all of them with the particle axis last ("…" in shapes).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.kinds import joined, label_of
from jaxlangnav.messages import NONE, SensorParams
from jaxlangnav.numerics import categorical, gaussian
from jaxlangnav.numerics.batching import column, lead, pick
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.counts import made_likelier
from jaxlangnav.semantic_map.particle import SemanticMap, positions
from jaxlangnav.terrain.view import View, eye_of

LOG_SURPRISE = -30.0
"""Least log-weight of a detection where nothing can be: surprised, never dead."""


class Detections(NamedTuple):
    """Detections of one observation in map axes, relative to the robot."""

    object_type: Array  # i32[D] kinds
    offset_x: Array  # f32[D] metres, map axes; f32[D, 1, ...] where headings differ
    offset_y: Array  # see ``offset_x``
    log_new: Array  # f32[D] log density of a not yet seen object there, 1/m²; f32[D, ...] where
    # headings differ
    is_detection: Array  # bool[D]


class ClutterOdds(NamedTuple):
    """How often a detector reports what is not there, against true detections."""

    log_false: Array  # f32[] false detections of a type, 1/m²
    log_confused: Array  # f32[] odds that a thing is given a type that is not its own
    log_as: Array  # f32[] … that it is given a certain one


def clutter_odds(sensor: SensorParams, num_types: Array) -> ClutterOdds:
    """Work out how far detections are to be doubted; −∞ where not at all.

    Args:
        sensor: the specification; its ``detection_probability`` is of detections rightly labelled.
        num_types: i32[], T, types that the detector tells apart.

    Returns:
        The doubt.
    """

    def log_of(share: Array) -> Array:
        return jnp.where(share > 0.0, jnp.log(jnp.maximum(share, 1e-30)), -jnp.inf)

    in_view = 0.5 * sensor.field_of_view * sensor.range_max**2
    rate = sensor.false_detections / jnp.maximum(sensor.detection_probability, 1e-3)
    odds = sensor.mislabelled / (1.0 - sensor.mislabelled)
    return ClutterOdds(
        log_false=log_of(rate / in_view),
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
    noise_variance: Array,
    growth: Array | float = 0.0,
    doubt: ClutterOdds | None = None,
    *,
    is_pooled: bool = False,
) -> Association:
    """Ground each detection in an existing object or in a new one (eq. 7b).

        p(z_j is o) ∝ N(z_j; x_o − x_robot, S_o),   p(z_j is new) ∝ λ m(z_j)

    with S from the joint covariance of robot and object, λ = α / A the density of objects not yet
    seen and m the probability of having missed one there. An object is detected at most once.

    Args:
        particle: one particle, after the motion.
        detections: f32[D] each.
        uniform: f32[D, ...], uniform draws in [0, 1).
        noise_variance: f32[], R, square metres per axis.
        growth: f32[], by how much more of λ each thing of the type that is held makes it (κ / α).
        doubt: how far detections are to be doubted, of particles that hold ``existence``.
        is_pooled: whether things of any type make it more.

    Returns:
        The grounding and its weight.
    """
    num_objects = particle.object_type.shape[0]
    predicted_x, predicted_y, spread = _predicted(particle, noise_variance)
    slots = column(jnp.arange(num_objects), particle.object_type.ndim)

    def ground(so_far: Association, one: tuple[Detections, Array]) -> tuple[Association, None]:
        """Ground one detection, given how those before it are grounded."""
        (z_type, z_x, z_y, log_new, present), chance = one
        object_type, is_hit, is_new, offset_x, offset_y, log_weight, overflow, existence = so_far
        log_existing = gaussian.log_normal_isotropic(z_x - predicted_x, z_y - predicted_y, spread)
        options = _weigh(z_type, log_existing, log_new, so_far, growth, doubt, is_pooled)
        choice, log_total = categorical.draw(options.log_weight, chance)
        free = jnp.min(jnp.where(object_type == NONE, slots, num_objects), axis=0)
        wants_new = choice == num_objects
        slot = jnp.where(wants_new, free, choice)
        entry = (slots == slot[None]) & present
        if options.existence is not None:
            if_held, others_if_new = options.existence
            of_others = jnp.where(wants_new & present, others_if_new, existence)
            existence = jnp.where(entry, if_held, of_others)
        return Association(
            object_type=jnp.where(
                entry, jnp.where(wants_new, z_type, joined(object_type, z_type)), object_type
            ),
            is_hit=is_hit | entry,
            is_new=is_new | (entry & wants_new[None]),
            offset_x=jnp.where(entry, z_x, offset_x),
            offset_y=jnp.where(entry, z_y, offset_y),
            log_weight=log_weight + jnp.where(present, log_total, 0.0),
            overflow=overflow + (present & (slot == num_objects)).astype(jnp.int32),
            existence=existence,
        ), None

    nobody, nowhere = jnp.zeros(predicted_x.shape, bool), jnp.zeros_like(predicted_x)
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


def _predicted(particle: SemanticMap, noise_variance: Array) -> tuple[Array, Array, Array]:
    """Predict where things would be detected: f32[O, ...] x, y from the robot, and variance S."""
    num_objects = particle.object_type.shape[0]
    own = jnp.stack([particle.covariance[slot, slot] for slot in range(num_objects)])
    robot = particle.covariance[num_objects]
    spread = own + robot[num_objects:] - 2.0 * robot[:num_objects]
    return (
        particle.mean_x[:num_objects] - particle.mean_x[num_objects:],
        particle.mean_y[:num_objects] - particle.mean_y[num_objects:],
        jnp.maximum(spread, 0.0) + noise_variance,
    )


class _Options(NamedTuple):
    """What one detection may be, and what exists then; None where all that is detected does."""

    log_weight: Array  # f32[O + 1, ...] each slot; something new last
    existence: tuple[Array, Array] | None = None  # f32[O, ...] r of the slot that it falls to, and
    # of the others if it is something new


def _weigh(
    kind: Array,
    log_existing: Array,
    log_new: Array,
    so_far: Association,
    growth: Array | float,
    doubt: ClutterOdds | None,
    is_pooled: bool,
) -> _Options:
    """Weigh what a detection of a kind, i32[], may be, given how those before it are grounded.

    Args:
        kind: of the detection.
        log_existing: f32[O, ...], log N of each slot.
        log_new: f32[] or f32[...], log λ m where nothing of its type is held.
        so_far: of the detections before it.
        growth: see ``associate``.
        doubt: see ``associate``.
        is_pooled: see ``associate``.
    """
    # Attributes decide nothing here: a detector that wavers must not make two of one thing.
    is_alike = label_of(so_far.object_type) == label_of(kind)
    may_be = is_alike & ~so_far.is_hit
    is_counted = so_far.object_type != NONE if is_pooled else is_alike
    if doubt is None:
        log_more = (log_new + jnp.log1p(growth * jnp.sum(is_counted, axis=0)))[None]
        return _Options(jnp.concatenate([jnp.where(may_be, log_existing, -jnp.inf), log_more]))
    held = jnp.where(is_counted, so_far.existence, 0.0)
    log_more = (log_new + jnp.log1p(growth * jnp.sum(held, axis=0)))[None]
    is_other = ~is_alike & (so_far.object_type != NONE)
    log_confused = lead(log_new + doubt.log_confused, log_more.ndim)
    log_held, log_any, if_held = _doubted(
        log_existing, log_more, log_confused, so_far.existence, is_other, doubt
    )
    likelier = made_likelier(held, growth, jnp.exp(log_more - log_any)[0])
    return _Options(
        jnp.concatenate([jnp.where(may_be, log_held, -jnp.inf), log_any]),
        existence=(if_held, jnp.where(is_counted, likelier, so_far.existence)),
    )


def _doubted(
    log_existing: Array,
    log_new: Array,
    log_confused: Array,
    existence: Array,
    is_other: Array,
    doubt: ClutterOdds,
) -> tuple[Array, Array, Array]:
    """Weigh a detection that may be false: of something that is held, and of something new.

        p(z is o) ∝ (r + (1 − r) h) N,   p(z is new) ∝ λ m + c,   c = c₀ + λ₀ m k + h Σ_other r N

    with r the probability that o exists, c₀ the density of false detections, k the odds that a
    label is wrong and h those of a certain wrong one; λ₀ is λ of a type of which nothing is held.
    What does not exist as what it was entered as is a thing of another type, mislabelled each time:
    so it may be detected again, but rarely.

    Args:
        log_existing: f32[O, ...], log N of each slot.
        log_new: f32[1, ...], log λ m.
        log_confused: as ``log_new``, log λ₀ m k.
        existence: f32[O, ...], r.
        is_other: bool[O, ...], slots that hold something of another type.
        doubt: of the detector.

    Returns:
        Both log-weights, doubted, and f32[O, ...], r of each slot if the detection falls to it.
    """
    log_real = jnp.log(jnp.maximum(existence, 1e-9))
    log_mislabelled = jnp.log(jnp.maximum(1.0 - existence, 1e-9)) + doubt.log_as
    log_own = jnp.logaddexp(log_real, log_mislabelled)
    of_others = jnp.where(is_other, log_existing + log_real + doubt.log_as, -jnp.inf)
    of_others = jax.scipy.special.logsumexp(of_others, axis=0, keepdims=True)
    log_false = jnp.logaddexp(doubt.log_false, log_confused)
    log_any = jnp.logaddexp(log_new, jnp.logaddexp(log_false, of_others))
    is_held = existence > 0.0
    is_real = jnp.where(is_held, jnp.exp(log_real - log_own), jnp.exp(log_new - log_any))
    return log_existing + log_own, log_any, is_real


def condition(
    particle: SemanticMap, association: Association, noise_variance: Array
) -> SemanticMap:
    """Condition the Gaussian on the grounded detections: exact, one scalar update for each.

        x_o = x_robot + z_o + N(0, R)   for a new object o, which has a flat prior,
        z_o = x_o − x_robot + N(0, R)   for one that is known

    Limits: R → ∞ leaves known objects unchanged; a first detection places the object at
    robot + offset.

    Args:
        particle: one particle.
        association: from ``associate``.
        noise_variance: f32[], R, square metres per axis.

    Returns:
        The particle with new objects entered and the rest corrected.
    """
    num_objects, ndim = particle.object_type.shape[0], particle.object_type.ndim
    is_new = _with_robot(association.is_new)
    offset_x, offset_y = association.offset_x, association.offset_y
    variance = column(jnp.broadcast_to(noise_variance, (num_objects + 1,)), ndim)
    joint = gaussian.Moments(particle.covariance, particle.mean_x, particle.mean_y)
    joint = gaussian.enter(
        joint, num_objects, is_new, _with_robot(offset_x), _with_robot(offset_y), variance
    )
    joint = gaussian.condition_offsets(
        joint,
        [(slot, num_objects) for slot in range(num_objects)],
        association.is_hit & ~association.is_new,
        offset_x,
        offset_y,
        variance,
    )
    # A root of NONE is no slot: a hypothesis on the ground does not move.
    moved_x, moved_y = (
        pick((after - before)[:num_objects], particle.root)
        for after, before in ((joint.mean_x, particle.mean_x), (joint.mean_y, particle.mean_y))
    )
    return replace(
        particle,
        object_type=association.object_type,
        covariance=joint.covariance,
        mean_x=joint.mean_x,
        mean_y=joint.mean_y,
        existence=association.existence,
        hypothesis_x=particle.hypothesis_x + moved_x,
        hypothesis_y=particle.hypothesis_y + moved_y,
    )


def _with_robot(values: Array) -> Array:
    """Append a zero, or false, for the robot to what is known of the objects."""
    return jnp.concatenate([values, jnp.zeros_like(values[:1])])


def log_absence(
    particle: SemanticMap,
    is_hit: Array,
    heading: Array,
    softness: Array,
    sensor: SensorParams,
    view: View,
) -> tuple[Array, Array, Array]:
    """Weigh what was not seen: negative observations (eq. 8).

        Σ_o log(1 − p_d v_o r_o),   r' = r (1 − p_d v) / (1 − p_d v r)

    over the objects not detected, v the share in view and r the probability that they exist, 1
    where particles do not doubt it.

    Args:
        particle: one particle, after conditioning.
        is_hit: bool[O, ...], detected objects.
        heading: f32[] or f32[1, ...], radians.
        softness: f32[], metres over which an object's position is uncertain.
        sensor: range, field of view, detection probability.
        view: what can be seen in this place.

    Returns:
        f32[...] for observed objects, and f32[M, ...] for each hypothesis (0 where there is none);
        and how probable the observed objects are now to exist, as in the particle.
    """
    num_objects = particle.object_type.shape[0]
    x, y = positions(particle)
    robot_x, robot_y = particle.mean_x[num_objects:], particle.mean_y[num_objects:]
    in_view = view.share(eye_of(robot_x, robot_y, heading, sensor), x, y, softness)
    probability = jnp.minimum(sensor.detection_probability, 0.999)
    is_missed = jnp.concatenate([particle.is_observed & ~is_hit, particle.is_hypothesised])
    likely, existence = probability * in_view, particle.existence
    if existence.shape[0]:
        own = likely[:num_objects]
        left = existence * (1.0 - own) / (1.0 - own * existence)
        likely = jnp.concatenate([own * existence, likely[num_objects:]])
        existence = jnp.where(is_missed[:num_objects], left, existence)
    log_missed = jnp.where(is_missed, jnp.log1p(-likely), 0.0)
    return jnp.sum(log_missed[:num_objects], axis=0), log_missed[num_objects:], existence
