"""The second half of a step: ground what is seen, and weigh what is and is not (eq. 7b, 8).

Beyond the paper: objects of hardly any existence probability are pruned, so that false detections
do not fill the map; and an observation that contradicts the map is flagged. No particle need die of
it: an impossible detection becomes a new object, and a vanished object stays where it was.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.object_types import kind_of
from jaxlangnav.messages import Observation
from jaxlangnav.numerics import categorical
from jaxlangnav.numerics.batching import append_axes
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import association
from jaxlangnav.semantic_map.association import Association
from jaxlangnav.semantic_map.belief import ParticleBelief, mean_drift
from jaxlangnav.semantic_map.counts import log_expected, log_exposure, lower_existence, unseen_frac
from jaxlangnav.semantic_map.coverage import area_size
from jaxlangnav.semantic_map.heading_bias import log_miss_at_offset, update_coverage
from jaxlangnav.semantic_map.motion import headings, with_drift
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.particle import SemanticMap, clear
from jaxlangnav.semantic_map.update import condition, log_absence
from jaxlangnav.terrain.view import rotated

MIN_ABSENT_PROB = 1e-2
"""Least probability that what has been detected is not there: things are taken away."""


class MeasurementUpdate(NamedTuple):
    """What one observation did to the particles, before any words are grounded anew."""

    log_map: Array  # f32[P] log-likelihood of the observation, hypotheses left out
    log_hypotheses: Array  # f32[P] what that of a particle with its words is above it: absence of
    # what is hypothesised, and bystanders that are none
    is_new: Array  # bool[O, P] slots that were entered
    is_other: Array  # bool[O, P] slots of another kind than before: entered, or better known
    is_lost: Array | None  # bool[P] what its words refer to does not exist; None: all of it does
    overflow: Array  # i32[P] detections that found no free slot
    surprise: Array  # f32[] nats by which the observation is less probable than one that fits


def observe(
    uniform: tuple[Array, Array],
    belief: ParticleBelief,
    observation: Observation,
    *,
    params: MapParams,
    num_pooled: Array | None = None,
) -> tuple[ParticleBelief, MeasurementUpdate]:
    """Ground the detections, condition, and weigh what was and what was not seen.

    The weights of the belief stay as they were.

    Args:
        uniform: f32[D, P] that decides what each detection is taken for, and f32[D, P], how far
            something new is where the detector does not tell.
        belief: after the motion.
        observation: pose and detections now, all of them sound.
        params: traced numbers.
        num_pooled: see ``ground_words``.
    """
    believed, observation = belief.particles, with_drift(belief, observation)
    sensor, model, doubt = observation.sensor, belief.sensor_model, None
    if believed.existence.shape[0] > 0:  # the sensor's probability is of right labels
        right = sensor.detection_probability * (1.0 - sensor.mislabelled)
        sensor = replace(sensor, detection_probability=right)
        doubt = association.clutter_odds(sensor, belief.num_types, model)
    seen = _detections(uniform[1], belief, observation, params, num_pooled)
    growth, is_pooled = params.clumping / params.concentration, num_pooled is not None
    grounded = association.associate(
        believed, seen, uniform[0], sensor, growth, doubt, is_pooled=is_pooled, model=model
    )
    held = condition(believed, grounded, sensor, model)
    # Some doubt is left of all that is held.
    existence = jnp.minimum(held.existence, 1.0 - MIN_ABSENT_PROB)
    belief = replace(belief, particles=replace(held, existence=existence))
    exposed_by = functools.partial(log_exposure, params=params, num_pooled=num_pooled)
    before = exposed_by(unseen_frac(belief.coverage))
    coverage, alternate_miss = update_coverage(belief, observation, sensor)
    exposure = exposed_by(unseen_frac(coverage)) - before
    belief = replace(belief, coverage=coverage, alternate_miss=alternate_miss)
    heading, softness = headings(belief, observation.pose[2]), 2.5 * params.kernel + 1e-3
    log_objects, log_hypotheses, existence = log_absence(
        belief.particles, grounded.is_hit, heading, softness, sensor, belief.terrain.view, model
    )
    belief, log_exposed, log_meant, is_lost = _counted(belief, believed, existence, exposure)
    log_map = grounded.log_weight + log_objects + log_exposed
    log_new = jnp.log(params.concentration) - jnp.log(area_size(belief.coverage))
    log_report = log_new + model.log_volume(sensor), model.log_fit(sensor)
    return belief, MeasurementUpdate(
        log_map=log_map,
        log_hypotheses=jnp.sum(log_hypotheses, axis=0) + log_meant,
        is_new=grounded.is_new,
        is_other=grounded.object_type != believed.object_type,
        is_lost=is_lost,
        overflow=grounded.overflow,
        surprise=surprise(belief.log_weight, grounded, log_map, *log_report),
    )


def _detections(
    uniform: Array,
    belief: ParticleBelief,
    observation: Observation,
    params: MapParams,
    num_pooled: Array | None,
) -> association.Detections:
    """Turn detections into map axes and look up how likely something new is there."""
    sensor, model = observation.sensor, belief.sensor_model
    metres = model.draw_range(uniform, observation.detection_range, sensor)
    bearing = append_axes(observation.pose[2] + observation.detection_bearing, metres.ndim)
    offset_x, offset_y = metres * jnp.cos(bearing), metres * jnp.sin(bearing)
    unseen, nobody = unseen_frac(belief.coverage), jnp.float32(0.0)
    log_density = log_expected(nobody, unseen, params=params, num_pooled=num_pooled)
    log_density = log_density - jnp.log(area_size(belief.coverage)) + model.log_volume(sensor)
    drift = mean_drift(belief)
    if drift is not None:
        own = (belief.particles.drift[:1] - drift)[None]
        offset_x, offset_y = (append_axes(offset, 3) for offset in (offset_x, offset_y))
        offset_x, offset_y = rotated(offset_x, offset_y, own)
    log_unseen = log_miss_at_offset(belief, offset_x, offset_y)
    kinds, attributes = observation.detection_type, observation.detection_attribute
    return association.Detections(
        object_type=kinds if attributes is None else kind_of(kinds, attributes),
        offset_x=offset_x,
        offset_y=offset_y,
        log_new=log_density + jnp.maximum(log_unseen, association.MIN_LOG_NEW),
        is_detection=observation.is_detection,
    )


def _counted(
    belief: ParticleBelief, believed: SemanticMap, existence: Array, exposure: Array
) -> tuple[ParticleBelief, Array, Array, Array | None]:
    """Hold against what has been seen that more of the area shows no more of its type.

    f32[P], log-likelihood of the maps, what that of a particle with its words is above it, is lost.
    """
    particles, is_meant = belief.particles, believed.is_meant
    log_meant = exposure * jnp.sum(is_meant, axis=0)
    if existence.shape[0] == 0:
        return belief, -exposure * jnp.sum(particles.is_observed, axis=0), log_meant, None
    log_exposed, existence = lower_existence(existence, exposure)
    log_kept = jnp.log(jnp.maximum(existence, 1e-9) / jnp.maximum(believed.existence, 1e-9))
    log_meant = log_meant + jnp.sum(jnp.where(is_meant, log_kept, 0.0), axis=0)
    particles, is_lost = prune_objects(replace(particles, existence=existence))
    return replace(belief, particles=particles), log_exposed, log_meant, is_lost


MIN_EXISTENCE, MIN_EXISTENCE_FULL = 1e-4, 0.02
"""Probability below which a thing that was detected is forgotten; and where hardly a slot is free.
A thing forgotten too soon would have to be detected more often than it can be."""
_SPARE_SLOTS = 2  # kept free, if need be, by forgetting what is least likely to exist


def prune_objects(particles: SemanticMap) -> tuple[SemanticMap, Array]:
    """Empty the slots of what hardly exists, in all particles; bool[P], whose words refer to it."""
    is_held = particles.is_observed
    likeliest = jnp.max(jnp.where(is_held, particles.existence, 0.0), axis=-1, keepdims=True)
    is_taken = jnp.any(is_held, axis=-1, keepdims=True)
    is_crowded = jnp.sum(is_taken) > is_taken.shape[0] - _SPARE_SLOTS
    least = jnp.argmin(jnp.where(is_taken, likeliest, jnp.inf))
    is_least = (jnp.arange(is_taken.shape[0])[:, None] == least) & is_crowded
    limit = jnp.where(is_least, MIN_EXISTENCE_FULL, MIN_EXISTENCE)
    is_gone = is_held & (likeliest < limit)
    is_lost = jnp.any(is_gone & particles.is_meant, axis=0)
    # Most looks empty none.
    rounds = jnp.any(is_gone).astype(jnp.int32)
    kept = jax.lax.fori_loop(0, rounds, lambda _, held: clear(held, is_gone), particles)
    return kept, is_lost


LOG_CONTRADICTION = 15.0
"""Nats by which an observation that contradicts the map is less probable than one expected. Of
78 000 looks in Table 2's worlds one is beyond."""


def surprise(
    log_weight: Array, grounded: Association, log_map: Array, log_new: Array, log_known: Array
) -> Array:
    """Measure how much less probable an observation is than one that fits.

        −log Σ_i w_i p_i(z) / p*_i(z),   log p* = n_new log λ + n_known E log p(z | x)

    p* is what the same grounding would weigh if every new object stood where nobody has looked,
    every known one as far from its place as the noise takes it on average, and none were missed.

    Args:
        log_weight: f32[P], before the observation, normalised.
        grounded: how the particles grounded the detections, leaves [..., P].
        log_map: f32[P], log probability of detections and absences of seen objects.
        log_new: f32[], log λ, density of reports of objects not yet seen.
        log_known: f32[], ``SensorModel.log_fit``.

    Returns:
        f32[], nats; about 0 or less for what was to be expected, and 0 where detections found no
        free slot (the map cannot know those, which is counted by itself) or all weights had died.
    """
    num_new = jnp.sum(grounded.is_new, axis=0)
    num_known = jnp.sum(grounded.is_hit, axis=0) - num_new
    log_fitting = num_new * log_new + num_known * log_known
    _, log_share, is_dead = categorical.log_normalize(log_weight + log_map - log_fitting)
    return jnp.where(is_dead | (jnp.max(grounded.overflow) > 0), 0.0, -log_share)
