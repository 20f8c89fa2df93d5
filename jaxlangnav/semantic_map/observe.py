"""Measurement update: data association, conditioning and weighting (eq. 7b, 8).

Beyond the paper: objects of negligible existence probability are pruned, so that false detections
do not fill the map; and an observation that contradicts the map is flagged. No weight becomes zero:
an impossible detection becomes a new object, and a vanished object stays where it was.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.object_types import type_code
from jaxlangnav.messages import Observation, SensorParams
from jaxlangnav.numerics import categorical, gaussian
from jaxlangnav.numerics.batching import append_axes, lookup
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import association
from jaxlangnav.semantic_map.association import Association
from jaxlangnav.semantic_map.belief import ParticleBelief, mean_drift
from jaxlangnav.semantic_map.counts import log_expected, log_exposure, lower_existence, unseen_frac
from jaxlangnav.semantic_map.coverage import area_size
from jaxlangnav.semantic_map.heading_bias import log_miss_at_offset, update_coverage
from jaxlangnav.semantic_map.motion import correct_heading, particle_headings
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.particle import SemanticMap, clear
from jaxlangnav.terrain import RANGING, SensorModel
from jaxlangnav.terrain.view import View, eye_of, rotate

MIN_ABSENT_PROB = 1e-2
"""Lower bound of the probability that a detected object does not exist: objects may be removed."""


class MeasurementUpdate(NamedTuple):
    """Result of one observation for the particles, before re-grounding."""

    log_map: Array  # f32[P] log-likelihood of the observation without hypotheses
    log_hypotheses: Array  # f32[P] additional log-likelihood with hypotheses and referents: their
    # misses, and the correction for referents, which the count model leaves out
    is_new: Array  # bool[O, P] slots of new objects
    is_type_changed: Array  # bool[O, P] slots whose type code changed: new, or another attribute
    is_flipped: Array  # bool[O or 0, P] slots that became probable to exist, or improbable
    is_lost: Array | None  # bool[P] a referent was pruned; None: every object exists
    overflow: Array  # i32[P] detections for which no object slot was free
    surprise: Array  # f32[] nats by which the observation is less probable than one that fits


def observe(
    uniform: tuple[Array, Array],
    belief: ParticleBelief,
    observation: Observation,
    *,
    params: MapParams,
    num_pooled: Array | None = None,
) -> tuple[ParticleBelief, MeasurementUpdate]:
    """Associate the detections, condition on them, and compute the likelihood including misses.

    The weights of the belief are not changed.

    Args:
        uniform: f32[D, P] for the data association, and f32[D, P] for the range of a new object
            if the detector does not measure it.
        belief: after the motion update.
        observation: pose and detections now, after gating.
        params: traced parameters.
        num_pooled: see ``ground_words``.
    """
    prior_map, observation = belief.particles, correct_heading(belief, observation)
    sensor, model, clutter = observation.sensor, belief.sensor_model, None
    if prior_map.existence.shape[0] > 0:  # the sensor's probability is of right labels
        prob_correct = sensor.detection_probability * (1.0 - sensor.mislabelled)
        sensor = replace(sensor, detection_probability=prob_correct)
        clutter = association.clutter_odds(sensor, belief.num_types, model)
    detections = _detections(uniform[1], belief, observation, params, num_pooled)
    growth, is_pooled = params.clumping / params.concentration, num_pooled is not None
    associated = association.associate(
        prior_map, detections, uniform[0], sensor, growth, clutter, is_pooled=is_pooled, model=model
    )
    posterior = condition(prior_map, associated, sensor, model)
    # No object exists for certain.
    existence = jnp.minimum(posterior.existence, 1.0 - MIN_ABSENT_PROB)
    belief = replace(belief, particles=replace(posterior, existence=existence))
    log_exposure_of = functools.partial(log_exposure, params=params, num_pooled=num_pooled)
    log_exposure_before = log_exposure_of(unseen_frac(belief.coverage))
    coverage, alternate_miss = update_coverage(belief, observation, sensor)
    log_rise = log_exposure_of(unseen_frac(coverage)) - log_exposure_before
    belief = replace(belief, coverage=coverage, alternate_miss=alternate_miss)
    heading, softness = particle_headings(belief, observation.pose[2]), 2.5 * params.kernel + 1e-3
    log_objects, log_hypotheses, existence = log_absence(
        belief.particles, associated.is_hit, heading, softness, sensor, belief.terrain.view, model
    )
    belief, log_no_more, log_ref, is_lost = _lower_existence(belief, prior_map, existence, log_rise)
    log_map = associated.log_weight + log_objects + log_no_more
    log_new = jnp.log(params.concentration) - jnp.log(area_size(belief.coverage))
    log_report = log_new + model.log_volume(sensor), model.log_fit(sensor)
    return belief, MeasurementUpdate(
        log_map=log_map,
        log_hypotheses=jnp.sum(log_hypotheses, axis=0) + log_ref,
        is_new=associated.is_new,
        is_type_changed=associated.object_type != prior_map.object_type,
        is_flipped=(belief.particles.existence > 0.5) != (prior_map.existence > 0.5),
        is_lost=is_lost,
        overflow=associated.overflow,
        surprise=surprise(belief.log_weight, associated, log_map, *log_report),
    )


def _detections(
    uniform: Array,
    belief: ParticleBelief,
    observation: Observation,
    params: MapParams,
    num_pooled: Array | None,
) -> association.Detections:
    """Convert detections to map axes, with the log-density of new objects there."""
    sensor, model = observation.sensor, belief.sensor_model
    distance = model.draw_range(uniform, observation.detection_range, sensor)
    bearing = append_axes(observation.pose[2] + observation.detection_bearing, distance.ndim)
    offset_x, offset_y = distance * jnp.cos(bearing), distance * jnp.sin(bearing)
    unseen, zero = unseen_frac(belief.coverage), jnp.float32(0.0)
    log_density = log_expected(zero, unseen, params=params, num_pooled=num_pooled)
    log_density = log_density - jnp.log(area_size(belief.coverage)) + model.log_volume(sensor)
    drift = mean_drift(belief)
    if drift is not None:
        offset_angle = (belief.particles.drift[:1] - drift)[None]
        offset_x, offset_y = (append_axes(offset, 3) for offset in (offset_x, offset_y))
        offset_x, offset_y = rotate(offset_x, offset_y, offset_angle)
    log_unseen = log_miss_at_offset(belief, offset_x, offset_y)
    types, attributes = observation.detection_type, observation.detection_attribute
    return association.Detections(
        object_type=types if attributes is None else type_code(types, attributes),
        offset_x=offset_x,
        offset_y=offset_y,
        log_new=log_density + jnp.maximum(log_unseen, association.MIN_LOG_NEW),
        is_detection=observation.is_detection,
    )


def _lower_existence(
    belief: ParticleBelief, prior_map: SemanticMap, existence: Array, log_rise: Array
) -> tuple[ParticleBelief, Array, Array, Array | None]:
    """Lower existence by the growth of the exposure, a logarithm (``counts``), and prune objects.

    Also f32[P], the log-likelihood that no further object is in the newly viewed area; the
    correction of that for referents; whether one was pruned.
    """
    particles, is_referent = belief.particles, prior_map.is_referent
    log_ref = log_rise * jnp.sum(is_referent, axis=0)
    if existence.shape[0] == 0:
        return belief, -log_rise * jnp.sum(particles.is_observed, axis=0), log_ref, None
    log_no_more, existence = lower_existence(existence, log_rise)
    log_survival = jnp.log(jnp.maximum(existence, 1e-9) / jnp.maximum(prior_map.existence, 1e-9))
    log_ref = log_ref + jnp.sum(jnp.where(is_referent, log_survival, 0.0), axis=0)
    particles, is_lost = prune_objects(replace(particles, existence=existence))
    return replace(belief, particles=particles), log_no_more, log_ref, is_lost


def condition(
    particle: SemanticMap, assoc: Association, sensor: SensorParams, model: SensorModel = RANGING
) -> SemanticMap:
    """Condition the Gaussian on the associated detections: exact, one scalar update for each.

        x_o = x_robot + z_o + N(0, R)   for a new object o, which has a flat prior,
        z_o = x_o − x_robot + N(0, R)   for one that is known

    Limits: R → ∞ leaves known objects unchanged; a first detection places the object at
    robot + offset.
    """
    num_objects = particle.object_type.shape[0]
    is_new = _append_robot(assoc.is_new)
    offset_x, offset_y = assoc.offset_x, assoc.offset_y
    variance = model.variance(offset_x, offset_y, sensor)
    variance = _append_robot(jnp.broadcast_to(variance, offset_x.shape))
    joint = gaussian.Moments(particle.covariance, particle.mean_x, particle.mean_y)
    joint = gaussian.add_coordinates(
        joint, num_objects, is_new, _append_robot(offset_x), _append_robot(offset_y), variance
    )
    offset_pairs, is_known = [(o, num_objects) for o in range(num_objects)], ~assoc.is_new
    joint = gaussian.condition_offsets(
        joint, offset_pairs, assoc.is_hit & is_known, offset_x, offset_y, variance
    )
    # A root of NONE is no slot: a hypothesis without an anchor does not move.
    shift_x = lookup((joint.mean_x - particle.mean_x)[:num_objects], particle.root)
    shift_y = lookup((joint.mean_y - particle.mean_y)[:num_objects], particle.root)
    return replace(
        particle,
        object_type=assoc.object_type,
        covariance=joint.covariance,
        mean_x=joint.mean_x,
        mean_y=joint.mean_y,
        existence=assoc.existence,
        hypothesis_x=particle.hypothesis_x + shift_x,
        hypothesis_y=particle.hypothesis_y + shift_y,
    )


def _append_robot(values: Array) -> Array:
    """Append a zero, or false, for the robot to values of the objects."""
    return jnp.concatenate([values, jnp.zeros_like(values[:1])])


def log_absence(
    particle: SemanticMap,
    is_hit: Array,
    heading: Array,
    softness: Array,
    sensor: SensorParams,
    view: View,
    model: SensorModel = RANGING,
) -> tuple[Array, Array, Array]:
    """Compute the likelihood of missed objects: negative information (eq. 8).

        Σ_o log(1 − p_d v_o r_o),   r' = r (1 − p_d v) / (1 − p_d v r)

    over the objects not detected, v the fraction in view and r the existence probability, 1 in
    particles without one; positions are uncertain over the softness, f32[] metres. The heading is
    f32[] or f32[1, ...], radians, and ``is_hit`` bool[O, ...]. Returns f32[...] for observed
    objects, f32[M, ...] for each hypothesis (0 where there is none), and r'.
    """
    num_objects = particle.object_type.shape[0]
    x = jnp.concatenate([particle.mean_x[:num_objects], particle.hypothesis_x])
    y = jnp.concatenate([particle.mean_y[:num_objects], particle.hypothesis_y])
    robot_x, robot_y = particle.mean_x[num_objects:], particle.mean_y[num_objects:]
    eye = eye_of(robot_x, robot_y, heading, sensor)
    prob_detected = model.report_probability(view, eye, x, y, softness, sensor)
    is_missed = jnp.concatenate([particle.is_observed & ~is_hit, particle.is_hypothesised])
    existence = particle.existence
    if existence.shape[0]:
        prob = prob_detected[:num_objects]
        posterior = existence * (1.0 - prob) / (1.0 - prob * existence)
        prob_detected = jnp.concatenate([prob * existence, prob_detected[num_objects:]])
        existence = jnp.where(is_missed[:num_objects], posterior, existence)
    log_miss = jnp.where(is_missed, jnp.log1p(-prob_detected), 0.0)
    return jnp.sum(log_miss[:num_objects], axis=0), log_miss[num_objects:], existence


MIN_EXISTENCE, MIN_EXISTENCE_FULL = 1e-4, 0.02
"""Existence probability below which an object is pruned; and if hardly a slot is free. An object
pruned too early may not be detected often enough to be entered again."""
_NUM_SPARE = 2  # slots kept free by pruning the object that is least likely to exist


def prune_objects(particles: SemanticMap) -> tuple[SemanticMap, Array]:
    """Prune improbable objects in all particles; bool[P], whether one was a referent."""
    is_observed = particles.is_observed
    likeliest = jnp.max(jnp.where(is_observed, particles.existence, 0.0), axis=-1, keepdims=True)
    is_used = jnp.any(is_observed, axis=-1, keepdims=True)
    is_crowded = jnp.sum(is_used) > is_used.shape[0] - _NUM_SPARE
    least_likely = jnp.argmin(jnp.where(is_used, likeliest, jnp.inf))
    is_least_likely = (jnp.arange(is_used.shape[0])[:, None] == least_likely) & is_crowded
    limit = jnp.where(is_least_likely, MIN_EXISTENCE_FULL, MIN_EXISTENCE)
    is_pruned = is_observed & (likeliest < limit)
    is_lost = jnp.any(is_pruned & particles.is_referent, axis=0)
    # Most observations prune none.
    rounds = jnp.any(is_pruned).astype(jnp.int32)
    pruned = jax.lax.fori_loop(0, rounds, lambda _, carry: clear(carry, is_pruned), particles)
    return pruned, is_lost


LOG_CONTRADICTION = 15.0
"""Surprise in nats above which an observation contradicts the map. Of 78 000 observations in
Table 2's worlds one exceeds it."""


def surprise(
    log_weight: Array, associated: Association, log_map: Array, log_new: Array, log_known: Array
) -> Array:
    """Compute the log Bayes factor of a perfectly fitting observation against the actual one.

        −log Σ_i w_i p_i(z) / p*_i(z),   log p* = n_new log λ + n_known E log p(z | x)

    p* is the likelihood of the same association if every new object were in an unobserved cell,
    every known one at the average distance under the noise (``log_known``), and none were missed;
    ``log_map``, f32[P], is log p, and ``log_new`` log λ. About 0 or less for an expected
    observation, and 0 if detections found no free slot (counted separately) or all weights were
    zero.
    """
    num_new = jnp.sum(associated.is_new, axis=0)
    num_known = jnp.sum(associated.is_hit, axis=0) - num_new
    log_fitting = num_new * log_new + num_known * log_known
    _, log_ratio, is_dead = categorical.log_normalize(log_weight + log_map - log_fitting)
    return jnp.where(is_dead | (jnp.max(associated.overflow) > 0), 0.0, -log_ratio)
