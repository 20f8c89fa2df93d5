"""The Rao-Blackwellized particle filter over semantic maps (section 3.2, eq. 5-8).

One step: predict the robot's motion (``predict``), ground detections and update (``observe``),
re-ground the utterance in particles whose hypothesis was refuted (``proposal``), resample.
"""

import functools
from collections.abc import Sequence
from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.inputs.object_types import MOST_LABELS
from jaxlangnav.messages import Fault, Observation, Readings, UtteranceContext, assert_observation
from jaxlangnav.numerics import batching
from jaxlangnav.numerics.batching import take
from jaxlangnav.numerics.resampling import effective_sample_size, systematic
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map import particle
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.components import COMPONENTS, Component
from jaxlangnav.semantic_map.coverage import unexplored
from jaxlangnav.semantic_map.gating import Look, sound_place
from jaxlangnav.semantic_map.motion import drift_noise, predict
from jaxlangnav.semantic_map.observe import LOG_CONTRADICTION, observe
from jaxlangnav.semantic_map.params import MapConfig, MapParams
from jaxlangnav.semantic_map.proposal.sparse_regrounding import Regrounded, reground
from jaxlangnav.semantic_map.proposal.utterance import ground_words
from jaxlangnav.semantic_map.unreferenced_objects import nobody
from jaxlangnav.terrain import OPEN, POSITIONS, SensorModel, Terrain

_RANGE = 1  # folded into the key of the detections for ranges that are not measured


@pytree
class FilterInfo:
    """What a person or a test wants to know of one filter step."""

    effective_sample_size: Array  # f32[]
    is_resampled: Array  # bool[]
    num_regrounded: Array  # i32[] particles that drew a new grounding
    log_language_evidence: Array  # f32[] log p(words | observed map), estimated
    overflow: Array  # i32[] detections without a free slot, most over particles, or without room
    # among the bystanders
    fault: Array  # i32[] bits of messages.Fault: why the observation was left out, or dead weights
    is_news: Array  # bool[] an object was seen for the first time, or words came in
    surprise: Array  # f32[] nats by which the observation is less probable than one that fits
    is_contradiction: Array  # bool[] … more than it is by chance: it contradicts the map


def start(
    pose: Array,
    area: Array,
    num_mentions: int,
    *,
    config: MapConfig,
    num_types: int = MOST_LABELS,
    terrain: Terrain = OPEN,
    sensor_model: SensorModel = POSITIONS,
) -> ParticleBelief:
    """Build the belief of a robot that has seen nothing.

    A pose or an area that cannot be is replaced by a harmless one, and every look is then at fault.

    Args:
        pose: f32[3], x, y, heading, metres and radians, map frame.
        area: f32[4], operating area x_min, x_max, y_min, y_max, metres.
        num_mentions: M, capacity for mentions.
        config: sizes.
        num_types: object types that a detection may name.
        terrain: how far one sees and walks in the area.
        sensor_model: how the detector reports.
    """
    pose, area, is_placed = sound_place(pose, area)
    coverage, number = unexplored(area, config.num_cells), config.num_particles
    has_drift = config.has_drift
    kinds = {"has_doubts": config.has_doubts, "has_drift": has_drift}
    one = particle.empty(config.num_objects, num_mentions, pose[0], pose[1], **kinds)
    held = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[..., None], (*leaf.shape, number)), one)
    if has_drift:
        sign = jnp.where(jnp.arange(number) % 2 == 0, 1.0, -1.0)
        held = replace(held, drift=held.drift.at[1].set(sign))
    return ParticleBelief(
        particles=held,
        log_weight=jnp.full(number, -jnp.log(float(number)), jnp.float32),
        coverage=coverage,
        alternate_miss=coverage.log_miss if has_drift else jnp.zeros((0, 0), jnp.float32),
        bias_sign=jnp.float32(1.0),
        terrain=terrain,
        sensor_model=sensor_model,
        bystanders=nobody(config.num_bystanders),
        last_pose=pose,
        reported_pose=pose,
        is_placed=is_placed,
        num_types=jnp.int32(num_types),
        viewer=pose,
        must_ground=jnp.asarray(True),
        log_evidence=jnp.float32(0.0),
    )


def _num_pooled(belief: ParticleBelief, spoken: Array | None) -> Array:
    """Count the types of which things take slots, f32[]: those that the task speaks of."""
    if spoken is None:
        return belief.num_types.astype(jnp.float32)
    is_type = jnp.arange(spoken.shape[0]) < belief.num_types
    return jnp.maximum(jnp.sum(spoken & is_type), 1).astype(jnp.float32)


def _assert_arrays(belief: ParticleBelief, readings: Readings, observation: Observation) -> None:
    """Refuse other shapes and dtypes than ``step``'s (when the program is traced)."""
    assert_observation(observation)
    chex.assert_rank([belief.log_weight, readings.log_probability], 1)
    chex.assert_shape([belief.last_pose, belief.viewer], (3,))
    chex.assert_equal_shape([readings.figure, readings.relation, readings.landmark, readings.rank])
    chex.assert_type([belief.log_weight, readings.mention_type], [float, int])


def _draw(keys: Array, num_detections: int, number: int) -> tuple[Any, Array, Array]:
    """Draw the uniform numbers of a step: f32[D, P] twice, f32[2, P], f32[]."""
    # What each detection is taken for, and how far it is, which is drawn apart for it is seldom
    # asked for; who is kept and whose map the others take; where the comb of the resampling begins.
    associate, keep, resample = batching.uniforms(
        keys[np.array([0, 2, 3])], max(num_detections, 2) * number
    )
    associate = associate[: num_detections * number].reshape(num_detections, number)
    ranges = jax.random.uniform(jax.random.fold_in(keys[2], _RANGE), associate.shape)
    return (associate, ranges), keep[: 2 * number].reshape(2, number), resample[0]


def _resample(
    uniform: Array, belief: ParticleBelief, found: Regrounded, params: MapParams
) -> tuple[ParticleBelief, Array, Array]:
    """Take over the particles with their weights, or resample them to equal ones; ESS, is it so."""
    number, size = belief.log_weight.shape[0], effective_sample_size(found.weight)
    is_resampled = size < params.resample_threshold * number
    ancestors = systematic(found.weight, uniform)
    ancestors = jnp.where(is_resampled, ancestors, jnp.arange(number))
    log_weight = jnp.log(jnp.maximum(found.weight, 1e-30))
    belief = replace(
        belief,
        particles=take(found.particles, ancestors),
        log_weight=jnp.where(is_resampled, -jnp.log(float(number)), log_weight),
        must_ground=jnp.asarray(False),
        log_evidence=belief.log_evidence + found.log_total,
    )
    return belief, size, is_resampled


def step(
    key: Array,
    belief: ParticleBelief,
    readings: Readings,
    observation: Observation,
    *,
    params: MapParams,
    context: UtteranceContext | None = None,
    is_sparse: bool = False,
    farthest: Array | None = None,
    spoken: Array | None = None,
    pools_counts: bool = False,
    components: Sequence[Component] = COMPONENTS,
) -> tuple[ParticleBelief, FilterInfo]:
    """Run one step: predict (eq. 6), associate and weigh (7b, 8), re-ground (7a), resample.

    Args:
        key: random key, consumed.
        belief: at the last step.
        readings: what the instruction says.
        observation: pose and detections now; what cannot be is left out and flagged.
        params: traced numbers.
        context: from where relations were said; by default the belief's viewer.
        is_sparse: under ``vmap`` ground the words only where needed; no reverse-mode gradient.
        farthest: f32[], metres that the robot can have gone since the last step; None: anywhere.
        spoken: bool[T], types that the task speaks of, the others are bystanders; None: all.
        pools_counts: whether the types that it speaks of have one rate of how many there are.
        components: what goes beyond the paper; the paper's step has none.
    """
    _assert_arrays(belief, readings, observation)
    keys, was_told = jax.random.split(key, 4), belief.must_ground
    associate, keep, resample = _draw(keys, observation.detection_type.size, belief.log_weight.size)
    look = Look(observation, farthest, spoken)
    for component in components:
        belief, look = component.admit(belief, look)
    # Propose where the robot is (eq. 6) and what each detection is of (7b), and weigh (8).
    seen, noise = look.observation, drift_noise(keys[0], belief)
    belief = predict(belief, seen.pose, look.is_jump, noise, params=params)
    pooled = _num_pooled(belief, spoken) if pools_counts else None
    belief, update = observe(associate, belief, seen, params=params, num_pooled=pooled)
    for component in components:
        belief, look = component.keep(belief, look)
    # Propose what the words refer to (7a), where that was refuted.
    options = {"context": context, "is_sparse": is_sparse, "num_pooled": pooled}
    ground = functools.partial(ground_words, params=params, **options)
    grounded = reground(keys[1], keep, belief, readings, update, ground)
    belief, size, is_resampled = _resample(resample, belief, grounded, params)
    for component in components:
        belief = component.settle(belief)
    return belief, FilterInfo(
        effective_sample_size=size,
        is_resampled=is_resampled,
        num_regrounded=jnp.sum(grounded.is_fresh),
        log_language_evidence=grounded.log_language,
        overflow=jnp.max(update.overflow) + look.num_lost,
        fault=look.fault | jnp.where(grounded.is_dead, int(Fault.WEIGHTS), 0),
        is_news=was_told | jnp.any(update.is_new),
        surprise=update.surprise,
        is_contradiction=update.surprise > LOG_CONTRADICTION,
    )
