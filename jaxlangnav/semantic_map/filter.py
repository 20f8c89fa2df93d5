"""The Rao-Blackwellized particle filter over semantic maps (section 3.2, eq. 5-8).

One step: predict the robot's motion (``predict``), ground detections and update (``observe``),
re-ground the utterance in particles whose hypothesis was refuted (``proposal``), resample.
"""

import functools
from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.inputs.object_types import MAX_LABELS
from jaxlangnav.messages import Fault, Observation, Readings, UtteranceContext, assert_observation
from jaxlangnav.numerics import batching
from jaxlangnav.numerics.batching import take
from jaxlangnav.numerics.categorical import effective_sample_size, systematic
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map import particle
from jaxlangnav.semantic_map.additions import add_unreferenced, reset_weights, split_objects
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.coverage import empty_coverage
from jaxlangnav.semantic_map.gating import GatedStep, gate, valid_start
from jaxlangnav.semantic_map.heading_bias import switch_bias_hypothesis
from jaxlangnav.semantic_map.motion import drift_noise, predict
from jaxlangnav.semantic_map.observe import LOG_CONTRADICTION, observe
from jaxlangnav.semantic_map.params import MapConfig, MapParams
from jaxlangnav.semantic_map.proposal.sparse_regrounding import Regrounded, reground
from jaxlangnav.semantic_map.proposal.utterance import ground_words
from jaxlangnav.semantic_map.unreferenced_objects import no_bystanders
from jaxlangnav.terrain import OPEN, RANGING, SensorModel, Terrain

_RANGE_KEY = 1  # folded into the survivors' key to draw ranges that are not measured


@pytree
class FilterInfo:
    """Diagnostics of one filter step."""

    effective_sample_size: Array  # f32[]
    is_resampled: Array  # bool[] the particles were resampled in this step
    num_regrounded: Array  # i32[] particles that drew a new grounding
    log_language_evidence: Array  # f32[] log p(words | observed map), estimated
    overflow: Array  # i32[] detections without a free slot, maximum over particles, or without
    # one among the bystanders
    fault: Array  # i32[] bits of messages.Fault: why the observation was rejected; zero weights
    is_news: Array  # bool[] a new object or a new utterance
    surprise: Array  # f32[] nats by which the observation is less probable than one that fits
    is_contradiction: Array  # bool[] … above ``LOG_CONTRADICTION``: it contradicts the map


def start(
    pose: Array,
    area: Array,
    num_mentions: int,
    *,
    config: MapConfig,
    num_types: int = MAX_LABELS,
    terrain: Terrain = OPEN,
    sensor_model: SensorModel = RANGING,
) -> ParticleBelief:
    """Build the initial belief of a robot that has observed nothing.

    An invalid pose or area is replaced by a harmless one; every observation is then flagged.

    Args:
        pose: f32[3], x, y, heading, metres and radians, map frame.
        area: f32[4], operating area x_min, x_max, y_min, y_max, metres.
        num_mentions: M, capacity for mentions.
        config: capacities.
        num_types: number of object types that the detector distinguishes.
        terrain: lines of sight and travel distances in the area.
        sensor_model: observation model of the detector.
    """
    pose, area, is_placed = valid_start(pose, area)
    coverage, count = empty_coverage(area, config.num_cells), config.num_particles
    options = {"has_doubts": config.has_doubts, "has_drift": config.has_drift}
    empty = particle.empty(config.num_objects, num_mentions, pose[0], pose[1], **options)
    particles = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, count)), empty)
    if config.has_drift:
        sign = jnp.where(jnp.arange(count) % 2 == 0, 1.0, -1.0)
        particles = replace(particles, drift=particles.drift.at[1].set(sign))
    return ParticleBelief(
        particles=particles,
        log_weight=jnp.full(count, -jnp.log(float(count)), jnp.float32),
        coverage=coverage,
        alternate_miss=coverage.log_miss if config.has_drift else jnp.zeros((0, 0), jnp.float32),
        bias_sign=jnp.float32(1.0),
        terrain=terrain,
        sensor_model=sensor_model,
        bystanders=no_bystanders(config.num_bystanders),
        last_pose=pose,
        reported_pose=pose,
        is_placed=is_placed,
        num_types=jnp.int32(num_types),
        viewer=pose,
        must_ground=jnp.asarray(True),
        log_evidence=jnp.float32(0.0),
    )


def _num_pooled(belief: ParticleBelief, mentioned: Array | None) -> Array:
    """Count the object types that share one rate, f32[]: those that the task mentions."""
    if mentioned is None:
        return belief.num_types.astype(jnp.float32)
    is_valid = jnp.arange(mentioned.shape[0]) < belief.num_types
    return jnp.maximum(jnp.sum(mentioned & is_valid), 1).astype(jnp.float32)


def _assert_arrays(belief: ParticleBelief, readings: Readings, observation: Observation) -> None:
    """Assert the shapes and dtypes of ``step``'s arguments (when the program is traced)."""
    assert_observation(observation)
    chex.assert_rank([belief.log_weight, readings.log_probability], 1)
    chex.assert_shape([belief.last_pose, belief.viewer], (3,))
    chex.assert_equal_shape([readings.figure, readings.relation, readings.landmark, readings.rank])
    chex.assert_type([belief.log_weight, readings.mention_type], [float, int])


def _draw(keys: Array, num_detections: int, count: int) -> tuple[Any, Array, Array]:
    """Sample the uniform numbers of a step: f32[D, P] twice, f32[2, P], f32[]."""
    # Association and range of each detection (the range separately, as it is rarely used);
    # survival and ancestor of each particle; offset of the systematic resampling.
    associate, survive, resample = batching.uniforms(
        keys[np.array([0, 2, 3])], max(num_detections, 2) * count
    )
    associate = associate[: num_detections * count].reshape(num_detections, count)
    ranges = jax.random.uniform(jax.random.fold_in(keys[2], _RANGE_KEY), associate.shape)
    return (associate, ranges), survive[: 2 * count].reshape(2, count), resample[0]


def _resample(
    uniform: Array, belief: ParticleBelief, regrounded: Regrounded, params: MapParams
) -> tuple[ParticleBelief, Array, Array]:
    """Resample if the effective sample size is low; returns belief, ESS and whether resampled."""
    num_particles, ess = belief.log_weight.shape[0], effective_sample_size(regrounded.weight)
    is_resampled = ess < params.resample_threshold * num_particles
    ancestors = systematic(regrounded.weight, uniform)
    ancestors = jnp.where(is_resampled, ancestors, jnp.arange(num_particles))
    log_weight = jnp.log(jnp.maximum(regrounded.weight, 1e-30))
    belief = replace(
        belief,
        particles=take(regrounded.particles, ancestors),
        log_weight=jnp.where(is_resampled, -jnp.log(float(num_particles)), log_weight),
        must_ground=jnp.asarray(False),
        log_evidence=belief.log_evidence + regrounded.log_total,
    )
    return belief, ess, is_resampled


def step(
    key: Array,
    belief: ParticleBelief,
    readings: Readings,
    observation: Observation,
    *,
    params: MapParams,
    context: UtteranceContext | None = None,
    max_travel: Array | None = None,
    mentioned: Array | None = None,
    pools_counts: bool = False,
) -> tuple[ParticleBelief, FilterInfo]:
    """Run one filter step: predict (eq. 6), associate, update (7b, 8), re-ground (7a), resample.

    Args:
        key: random key, consumed.
        belief: after the last step.
        readings: interpretations of the instruction.
        observation: pose and detections now; rejected and flagged if impossible.
        params: traced parameters.
        context: poses at which relations were uttered; by default the belief's viewer.
        max_travel: f32[], metres that the robot can have gone since the last step; None: no bound.
        mentioned: bool[T], types that the task mentions; the others are bystanders; None: all.
        pools_counts: whether the mentioned types share one rate (``counts``).
    """
    _assert_arrays(belief, readings, observation)
    keys, is_uttered = jax.random.split(key, 4), belief.must_ground
    assoc, survive, resample = _draw(keys, observation.detection_type.size, belief.log_weight.size)
    belief, gated = gate(belief, GatedStep(observation, max_travel, mentioned))
    belief, gated = split_objects(*reset_weights(belief, gated))
    # Sample the motion (eq. 6) and the data association (7b), and weigh (8).
    observed, noise = gated.observation, drift_noise(keys[0], belief)
    belief = predict(belief, observed.pose, gated.is_jump, noise, params=params)
    pooled = _num_pooled(belief, mentioned) if pools_counts else None
    belief, update = observe(assoc, belief, observed, params=params, num_pooled=pooled)
    belief, gated = add_unreferenced(belief, gated)
    # Sample new groundings of the utterance (7a) where they were refuted.
    ground = functools.partial(ground_words, params=params, context=context, num_pooled=pooled)
    grounded = reground(keys[1], survive, belief, readings, update, ground)
    belief, ess, is_resampled = _resample(resample, belief, grounded, params)
    return switch_bias_hypothesis(belief), FilterInfo(
        effective_sample_size=ess,
        is_resampled=is_resampled,
        num_regrounded=jnp.sum(grounded.is_fresh),
        log_language_evidence=grounded.log_language,
        overflow=jnp.max(update.overflow) + gated.num_dropped,
        fault=gated.fault | jnp.where(grounded.is_dead, int(Fault.WEIGHTS), 0),
        is_news=is_uttered | jnp.any(update.is_new),
        surprise=update.surprise,
        is_contradiction=update.surprise > LOG_CONTRADICTION,
    )
