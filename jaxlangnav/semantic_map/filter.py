"""The Rao-Blackwellized particle filter over semantic maps (section 3.2, eq. 5-8).

One step: move, ground the detections, condition, weigh what was and was not seen, ground the
words anew where the old hypothesis has been refuted or a new object calls for it, resample.

Words are re-grounded by *rejection control*: a particle of weight w below the mean c survives with
probability w / c and then weighs c; otherwise the map of an ancestor drawn by weight and a fresh
draw from the posterior of the sentence given that map take its place, with weight c. Both kinds
are properly weighted for the same target, so the mixture is too; and when every hypothesis is
refuted all are replaced, which is how the filter revives.
"""

from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.kinds import MOST_LABELS, is_anything, kind_of, label_of
from jaxlangnav.messages import Fault, Observation, Readings, Told, assert_observation
from jaxlangnav.numerics import batching, categorical
from jaxlangnav.numerics.batching import column, take
from jaxlangnav.numerics.resampling import effective_sample_size, independent, systematic
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map import association, bystanders, motion, particle
from jaxlangnav.semantic_map.belief import ParticleBelief, is_led, mean_drift, robot_position
from jaxlangnav.semantic_map.counts import exposed, log_expected, log_exposure, share_unseen
from jaxlangnav.semantic_map.coverage import area_size, unexplored
from jaxlangnav.semantic_map.looking import go_by_the_likelier, log_missed, look_around
from jaxlangnav.semantic_map.params import MapConfig, MapParams
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.semantic_map.regrounding import ground_words
from jaxlangnav.semantic_map.soundness import sound_look, sound_place
from jaxlangnav.semantic_map.surprise import LOG_CONTRADICTION, surprise
from jaxlangnav.sensing import MIN_NOISE
from jaxlangnav.terrain import OPEN, Terrain

_ASKED = 16
"""Particles that ground the words at every step, whatever happens: enough to tell the mean of the
evidence, against which fresh groundings are weighed."""

LEAST_EXISTENCE, LEAST_WORTH = 1e-4, 0.02
"""Probability below which a thing that was detected is taken not to exist, and forgotten; and where
hardly a slot is free. What is forgotten takes its detections with it, but the looks that missed it
stay: a thing forgotten too soon would have to be detected more often than it can be."""
_SPARE_SLOTS = 2
"""Slots that are kept free, if need be, by forgetting what is least likely to exist."""

_DRIFT = 1
"""Folded into the key of the detections for the drift of the heading."""


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

    Returns:
        The belief; words are grounded at the first step.
    """
    pose, area, is_placed = sound_place(pose, area)
    one = particle.empty(
        config.num_objects,
        num_mentions,
        pose[0],
        pose[1],
        has_doubts=config.has_doubts,
        has_drift=config.has_drift,
    )
    number = config.num_particles
    particles = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf[..., None], (*leaf.shape, number)), one
    )
    if config.has_drift:
        sign = jnp.where(jnp.arange(number) % 2 == 0, 1.0, -1.0)
        particles = replace(particles, drift=particles.drift.at[1].set(sign))
    coverage = unexplored(area, config.num_cells)
    return ParticleBelief(
        particles=particles,
        log_weight=jnp.full(number, -jnp.log(float(number)), jnp.float32),
        coverage=coverage,
        other_miss=coverage.log_miss if config.has_drift else jnp.zeros((0, 0), jnp.float32),
        led_sign=jnp.float32(1.0),
        terrain=terrain,
        bystanders=bystanders.nobody(config.num_bystanders),
        last_pose=pose,
        doubted_pose=pose,
        is_placed=is_placed,
        num_types=jnp.int32(num_types),
        viewer=pose,
        must_ground=jnp.asarray(True),
        log_evidence=jnp.float32(0.0),
    )


def predict(
    belief: ParticleBelief,
    pose: Array,
    is_jump: Array,
    noise: Array | None = None,
    *,
    params: MapParams,
) -> ParticleBelief:
    """Move the robot in every particle by what odometry has measured since the last step.

    Args:
        belief: before the motion.
        pose: f32[3], dead-reckoned pose now.
        is_jump: bool[], motion does not explain it: the robot may be there or where it was.
        noise: f32[P], standard normal, of particles that hold a ``drift``.
        params: odometry noise.

    Returns:
        The belief after the motion.
    """
    step_x, step_y = pose[0] - belief.last_pose[0], pose[1] - belief.last_pose[1]
    share = jnp.where(is_jump, 1.0, params.motion.odometry_noise)
    squared = step_x * step_x + step_y * step_y
    variance, particles = (share**2) * squared, belief.particles
    if noise is not None:
        way, turn = jnp.sqrt(squared), motion.wrapped(pose[2] - belief.last_pose[2])
        drift = motion.drifted(particles.drift, way, turn, noise, motion=params.motion)
        # Over the step it is half of what has come in.
        halfway = 0.5 * (particles.drift[:1] + drift[:1])
        step_x, step_y = motion.rotated(step_x, step_y, halfway)
        particles = replace(particles, drift=drift)
    moved = motion.move(particles, step_x, step_y, variance)
    return replace(belief, particles=moved, last_pose=pose)


def _with_drift(belief: ParticleBelief, observation: Observation) -> Observation:
    """Correct the heading of a look by how far the robot is believed to have drifted."""
    drift, pose = mean_drift(belief), observation.pose
    return observation if drift is None else replace(observation, pose=pose.at[2].add(drift))


def _detections(
    belief: ParticleBelief, observation: Observation, params: MapParams, num_pooled: Array | None
) -> association.Detections:
    """Turn detections into map axes and look up how likely something new is there."""
    bearing = observation.pose[2] + observation.detection_bearing
    offset_x = observation.detection_range * jnp.cos(bearing)
    offset_y = observation.detection_range * jnp.sin(bearing)
    unseen, nobody = share_unseen(belief.coverage), jnp.float32(0.0)
    log_density = log_expected(nobody, unseen, params=params, num_pooled=num_pooled)
    log_density = log_density - jnp.log(area_size(belief.coverage))
    drift = mean_drift(belief)
    if drift is not None:
        own = (belief.particles.drift[:1] - drift)[None]
        offset_x, offset_y = (column(offset, 3) for offset in (offset_x, offset_y))
        offset_x, offset_y = motion.rotated(offset_x, offset_y, own)
    log_unseen = log_missed(belief, offset_x, offset_y)
    return association.Detections(
        object_type=kinds_seen(observation),
        offset_x=offset_x,
        offset_y=offset_y,
        log_new=log_density + jnp.maximum(log_unseen, association.LOG_SURPRISE),
        is_detection=observation.is_detection,
    )


def kinds_seen(observation: Observation) -> Array:
    """Put the types and the attributes of detections together, i32[D] kinds."""
    if observation.detection_attribute is None:
        return observation.detection_type
    return kind_of(observation.detection_type, observation.detection_attribute)


class Weighed(NamedTuple):
    """What one observation did to the particles, before any words are grounded anew."""

    log_map: Array  # f32[P] log-likelihood of the observation, hypotheses left out
    log_hypotheses: Array  # f32[P] what that of a particle with its words is above it: absence of
    # what is hypothesised, and bystanders that are none
    is_new: Array  # bool[O, P] slots that were entered
    is_other: Array  # bool[O, P] slots of another kind than before: entered, or better known
    is_lost: Array | None  # bool[P] what its words refer to does not exist; None: all of it does
    overflow: Array  # i32[P] detections that found no free slot
    surprise: Array  # f32[] nats by which the observation is less probable than one that fits


def _headings(belief: ParticleBelief, heading: Array) -> Array:
    """Tell where each particle takes the robot to look, f32[] or f32[1, P], given the mean."""
    drift = mean_drift(belief)
    return heading if drift is None else heading + belief.particles.drift[:1] - drift


def observe(
    uniform: Array,
    belief: ParticleBelief,
    observation: Observation,
    is_jump: Array,
    noise: Array | None = None,
    *,
    params: MapParams,
    num_pooled: Array | None = None,
) -> tuple[ParticleBelief, Weighed]:
    """Move, ground the detections, condition, and weigh what was and what was not seen.

    Args:
        uniform: f32[D, P], which decides what each detection is taken for.
        belief: at the last step.
        observation: pose and detections now, all of them sound.
        is_jump: bool[], motion does not explain the pose.
        noise: see ``predict``.
        params: traced numbers.
        num_pooled: see ``ground_words``.

    Returns:
        The belief with its weights as they were, and the likelihoods.
    """
    belief = predict(belief, observation.pose, is_jump, noise, params=params)
    observation = _with_drift(belief, observation)
    detections = _detections(belief, observation, params, num_pooled)
    heading, sensor = observation.pose[2], observation.sensor
    noise_variance = jnp.maximum(sensor.noise, MIN_NOISE) ** 2
    growth = params.clumping / params.concentration
    has_doubts, doubt = belief.particles.existence.shape[0] > 0, None
    if has_doubts:
        right = sensor.detection_probability * (1.0 - sensor.mislabelled)
        sensor = replace(sensor, detection_probability=right)
        doubt = association.clutter_odds(sensor, belief.num_types)
    grounded = association.associate(
        belief.particles,
        detections,
        uniform,
        noise_variance,
        growth,
        doubt,
        is_pooled=num_pooled is not None,
    )
    particles = association.condition(belief.particles, grounded, noise_variance)
    believed, belief = belief.particles, replace(belief, particles=particles)
    view, softness = belief.terrain.view, 2.5 * params.kernel + 1e-3
    before = belief.coverage
    coverage, other_miss = look_around(belief, observation, sensor)
    log_objects, log_hypotheses, existence = association.log_absence(
        particles, grounded.is_hit, _headings(belief, heading), softness, sensor, view
    )
    # What is looked at and shows no more of a type tells against there being many.
    now, earlier = (
        log_exposure(share_unseen(one), params=params, num_pooled=num_pooled)
        for one in (coverage, before)
    )
    exposure = now - earlier
    is_lost = None
    if has_doubts:
        log_exposed, existence = exposed(existence, exposure)
        particles, is_lost = _forget(replace(particles, existence=existence))
        belief = replace(belief, particles=particles)
    else:
        log_exposed = -exposure * jnp.sum(particles.is_observed, axis=0)
    log_map = grounded.log_weight + log_objects + log_exposed
    log_new = jnp.log(params.concentration) - jnp.log(area_size(coverage))
    return replace(belief, coverage=coverage, other_miss=other_miss), Weighed(
        log_map=log_map,
        log_hypotheses=jnp.sum(log_hypotheses, axis=0) + _log_meant(believed, existence, exposure),
        is_new=grounded.is_new,
        is_other=grounded.object_type != believed.object_type,
        is_lost=is_lost,
        overflow=grounded.overflow,
        surprise=surprise(belief.log_weight, grounded, log_map, log_new, noise_variance),
    )


def _log_meant(believed: SemanticMap, existence: Array, exposure: Array) -> Array:
    """Weigh what the words refer to above what its map weighs: it is no bystander, and exists.

    Args:
        believed: particles before the look.
        existence: as in the particle, after the look.
        exposure: f32[], by which a bystander has grown less probable.

    Returns:
        f32[P].
    """
    is_meant = believed.is_meant
    log_meant = exposure * jnp.sum(is_meant, axis=0)
    if existence.shape[0] == 0:
        return log_meant
    log_kept = jnp.log(jnp.maximum(existence, 1e-9) / jnp.maximum(believed.existence, 1e-9))
    return log_meant + jnp.sum(jnp.where(is_meant, log_kept, 0.0), axis=0)


def _forget(particles: SemanticMap) -> tuple[SemanticMap, Array]:
    """Empty the slots of what hardly exists, in all particles: slots stay of one thing.

    Returns:
        The particles, and bool[P], whose words refer to such a thing.
    """
    is_held = particles.is_observed
    likeliest = jnp.max(jnp.where(is_held, particles.existence, 0.0), axis=-1, keepdims=True)
    is_taken = jnp.any(is_held, axis=-1, keepdims=True)
    is_crowded = jnp.sum(is_taken) > is_taken.shape[0] - _SPARE_SLOTS
    least = jnp.argmin(jnp.where(is_taken, likeliest, jnp.inf))
    is_least = (jnp.arange(is_taken.shape[0])[:, None] == least) & is_crowded
    limit = jnp.where(is_least, LEAST_WORTH, LEAST_EXISTENCE)
    is_gone = is_held & (likeliest < limit)
    is_lost = jnp.any(is_gone & particles.is_meant, axis=0)
    # Most looks empty none.
    rounds = jnp.any(is_gone).astype(jnp.int32)
    return jax.lax.fori_loop(
        0, rounds, lambda _, held: particle.clear(held, is_gone), particles
    ), is_lost


class Regrounded(NamedTuple):
    """Particles with words grounded anew where need was, and their weights."""

    particles: SemanticMap  # leaves [..., P]
    weight: Array  # f32[P] normalised
    is_fresh: Array  # bool[P] drew a new grounding
    log_total: Array  # f32[] log-likelihood of the observation
    log_language: Array  # f32[] log p(words | observed map), estimated
    is_dead: Array  # bool[] all weights had died and were made uniform


def reground(
    key: Array,
    uniform: Array,
    belief: ParticleBelief,
    readings: Readings,
    weighed: Weighed,
    *,
    params: MapParams,
    told: Told | None,
    is_sparse: bool,
    num_pooled: Array | None,
) -> Regrounded:
    """Ground the words anew where the old hypothesis was refuted or a new object calls for it.

    Args:
        key: random key of the groundings, consumed.
        uniform: f32[2, P], which decides who is kept, and whose map the others take.
        belief: of ``observe``.
        readings: what the instruction says.
        weighed: of ``observe``.
        params: traced numbers.
        told: see ``step``.
        is_sparse: see ``step``.
        num_pooled: see ``ground_words``.

    Returns:
        The particles, properly weighted.
    """
    number, particles = belief.log_weight.shape[0], belief.particles
    # What a particle's own map weighs, apart from its hypotheses, goes with a forced draw.
    log_map = belief.log_weight + weighed.log_map
    (kept_weight, map_weight), log_totals, are_dead = categorical.log_normalize(
        jnp.stack([log_map + weighed.log_hypotheses, log_map])
    )
    # A new object of a type the particle's words speak of reopens what they refer to, and so does
    # a new attribute of one.
    new_type = jnp.where(weighed.is_other, label_of(particles.object_type), -3)
    kinds = readings.mention_type.reshape(-1)
    mentioned = jnp.any(label_of(kinds)[:, None, None] == new_type[None], axis=(0, 1))
    mentioned = mentioned | (jnp.any(is_anything(kinds)) & jnp.any(new_type >= 0, axis=0))
    must_ground = belief.must_ground | mentioned
    keep_uniform, ancestor_uniform = uniform
    is_fresh = must_ground | (keep_uniform > kept_weight * number)
    is_fresh = is_fresh if weighed.is_lost is None else is_fresh | weighed.is_lost
    # A refuted particle is replaced as a whole: it takes over the map of a particle drawn by
    # weight, so that a wrong map dies out, and then grounds the words in it.
    ancestors = independent(kept_weight, ancestor_uniform)
    ancestors = jnp.where(is_fresh & ~must_ground, ancestors, jnp.arange(number))
    is_asked = is_fresh | (jnp.arange(number) % max(1, number // _ASKED) == 0)
    particles = take(particles, ancestors)
    fresh, log_language = ground_words(
        key,
        replace(belief, particles=particles),
        readings,
        params=params,
        told=told,
        is_asked=is_asked,
        is_sparse=is_sparse,
        num_pooled=num_pooled,
    )
    num_asked = jnp.sum(is_asked).astype(jnp.float32)
    language, log_language_total, _ = categorical.log_normalize(log_language)
    language = jnp.clip(language * num_asked, 1e-6, 50.0)
    fresh_weight = jnp.where(must_ground, map_weight, 1.0 / number) * language
    weight = jnp.where(is_fresh, fresh_weight, jnp.maximum(kept_weight, 1.0 / number))
    return Regrounded(
        particles=jax.tree.map(
            lambda new, old: old if new is old else jnp.where(is_fresh, new, old), fresh, particles
        ),
        weight=weight / jnp.sum(weight),
        is_fresh=is_fresh,
        log_total=log_totals[0],
        log_language=log_language_total - jnp.log(num_asked),
        is_dead=are_dead[0],
    )


def _drift_noise(key: Array, belief: ParticleBelief) -> Array | None:
    """Draw by what the headings drift, f32[P]; None where a compass gives them."""
    if belief.particles.drift.shape[0] == 0:
        return None
    return jax.random.normal(jax.random.fold_in(key, _DRIFT), belief.log_weight.shape)


def _part(
    belief: ParticleBelief, observation: Observation, spoken: Array | None
) -> tuple[ParticleBelief, Observation, Observation | None]:
    """Part what the particles hold from bystanders, in the map and in what is seen now."""
    if spoken is None or belief.bystanders.x.shape[0] == 0:
        return belief, observation, None
    particles, known = bystanders.promote(
        belief.particles, belief.bystanders, spoken, belief.log_weight, belief.must_ground
    )
    return (
        replace(belief, particles=particles, bystanders=known),
        *bystanders.part(observation, spoken),
    )


def _num_pooled(belief: ParticleBelief, spoken: Array | None) -> Array:
    """Count the types of which things take slots, f32[]: those that the task speaks of."""
    if spoken is None:
        return belief.num_types.astype(jnp.float32)
    is_type = jnp.arange(spoken.shape[0]) < belief.num_types
    return jnp.maximum(jnp.sum(spoken & is_type), 1).astype(jnp.float32)


def _remember(
    belief: ParticleBelief, others: Observation | None
) -> tuple[ParticleBelief, Array | int]:
    """Remember bystanders that are seen; i32[] tells how many found no room."""
    if others is None:
        return belief, 0
    weight, particles = jnp.exp(belief.log_weight), belief.particles
    here, spread = robot_position(belief), particles.covariance[-1, -1]
    if mean_drift(belief) is not None:
        weight = jnp.where(is_led(belief), weight, 0.0)
        weight = weight / jnp.maximum(jnp.sum(weight), 1e-30)
        apart = (particles.mean_x[-1] - here[0]) ** 2 + (particles.mean_y[-1] - here[1]) ** 2
        spread = spread + 0.5 * apart
    robot = *here, jnp.sum(weight * spread)
    others = _with_drift(belief, others)
    known, num_forgotten = bystanders.remember_bystanders(belief.bystanders, others, robot)
    return replace(belief, bystanders=known), num_forgotten


def _assert_arrays(belief: ParticleBelief, readings: Readings, observation: Observation) -> None:
    """Refuse other shapes and dtypes than ``step``'s (when the program is traced)."""
    assert_observation(observation)
    chex.assert_rank([belief.log_weight, readings.log_probability], 1)
    chex.assert_shape([belief.last_pose, belief.viewer], (3,))
    chex.assert_equal_shape([readings.figure, readings.relation, readings.landmark, readings.rank])
    chex.assert_type([belief.log_weight, readings.mention_type], [float, int])


def _draw(keys: Array, num_detections: int, number: int) -> tuple[Array, Array, Array]:
    """Draw the uniform numbers of a step in one go, given key[4].

    Returns:
        f32[D, P], what each detection is taken for; f32[2, P], who is kept and whose map the
        others take; f32[], where the comb of the resampling begins.
    """
    associate, keep, resample = batching.uniforms(
        keys[np.array([0, 2, 3])], max(num_detections, 2) * number
    )
    associate = associate[: num_detections * number].reshape(num_detections, number)
    return associate, keep[: 2 * number].reshape(2, number), resample[0]


def _resampled(
    uniform: Array, belief: ParticleBelief, found: Regrounded, is_resampled: Array
) -> ParticleBelief:
    """Take over the particles with their weights, or resample them to equal ones."""
    number = belief.log_weight.shape[0]
    ancestors = systematic(found.weight, uniform)
    ancestors = jnp.where(is_resampled, ancestors, jnp.arange(number))
    log_weight = jnp.log(jnp.maximum(found.weight, 1e-30))
    return replace(
        belief,
        particles=take(found.particles, ancestors),
        log_weight=jnp.where(is_resampled, -jnp.log(float(number)), log_weight),
        must_ground=jnp.asarray(False),
        log_evidence=belief.log_evidence + found.log_total,
    )


def step(
    key: Array,
    belief: ParticleBelief,
    readings: Readings,
    observation: Observation,
    *,
    params: MapParams,
    told: Told | None = None,
    is_sparse: bool = False,
    farthest: Array | None = None,
    spoken: Array | None = None,
    pools_counts: bool = False,
) -> tuple[ParticleBelief, FilterInfo]:
    """Run one step of the filter (eq. 6-8).

    Args:
        key: random key, consumed.
        belief: at the last step.
        readings: what the instruction says.
        observation: pose and detections now; what cannot be is left out and flagged.
        params: traced numbers.
        told: how it was said; all of it to the belief's viewer by default.
        is_sparse: under ``vmap`` over beliefs, ground the words only in the particles that need
            it, about a third of all. The same result, but no gradient in reverse mode.
        farthest: f32[], metres that the robot can have gone since the last step; None: anywhere.
        spoken: bool[T], types that the task speaks of; where the belief has room for bystanders,
            things of other types are remembered as such. None: it speaks of all.
        pools_counts: whether the types that it speaks of have one rate of how many there are.

    Returns:
        The belief now, and information on the step.
    """
    _assert_arrays(belief, readings, observation)
    number, was_told = belief.log_weight.shape[0], belief.must_ground
    keys = jax.random.split(key, 4)
    associate, keep, resample = _draw(keys, observation.detection_type.shape[0], number)
    sound = sound_look(belief, observation, farthest)
    is_alive = jnp.all(belief.log_weight < jnp.inf) & jnp.any(belief.log_weight > -jnp.inf)
    belief = replace(
        belief,
        log_weight=jnp.where(is_alive, belief.log_weight, -jnp.log(float(number))),
        doubted_pose=sound.doubted_pose,
    )
    belief, seen, others = _part(belief, sound.observation, spoken)
    noise, pooled = _drift_noise(keys[0], belief), None
    if pools_counts:
        pooled = _num_pooled(belief, spoken)
    belief, weighed = observe(
        associate, belief, seen, sound.is_jump, noise, params=params, num_pooled=pooled
    )
    belief, num_forgotten = _remember(belief, others)
    found = reground(
        keys[1],
        keep,
        belief,
        readings,
        weighed,
        params=params,
        told=told,
        is_sparse=is_sparse,
        num_pooled=pooled,
    )
    size = effective_sample_size(found.weight)
    is_resampled = size < params.resample_threshold * number
    belief = _resampled(resample, belief, found, is_resampled)
    return go_by_the_likelier(belief), FilterInfo(
        effective_sample_size=size,
        is_resampled=is_resampled,
        num_regrounded=jnp.sum(found.is_fresh),
        log_language_evidence=found.log_language,
        overflow=jnp.max(weighed.overflow) + num_forgotten,
        fault=sound.fault + jnp.where(is_alive & ~found.is_dead, 0, int(Fault.WEIGHTS)),
        is_news=was_told | jnp.any(weighed.is_new),
        surprise=weighed.surprise,
        is_contradiction=weighed.surprise > LOG_CONTRADICTION,
    )
