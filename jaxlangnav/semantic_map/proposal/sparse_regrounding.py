"""Re-ground the utterance where a hypothesis was refuted: *rejection control* (eq. 7a and 8).

A particle of weight w below the mean c survives with probability w / c and then has weight c;
otherwise it is replaced, with weight c, by the map of an ancestor drawn by weight and a fresh draw
from the posterior of the sentence given that map. Both are properly weighted for the same target,
so the mixture is too; when every hypothesis is refuted all are replaced, so the filter recovers.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.object_types import is_anything, label_of
from jaxlangnav.messages import Readings
from jaxlangnav.numerics import categorical
from jaxlangnav.numerics.batching import take
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.observe import MeasurementUpdate
from jaxlangnav.semantic_map.particle import SemanticMap

_NUM_PROBES = 16  # particles re-grounded at every step, to estimate the mean evidence


class Regrounded(NamedTuple):
    """Particles after re-grounding, and their weights."""

    particles: SemanticMap  # leaves [..., P]
    weight: Array  # f32[P] normalised
    is_fresh: Array  # bool[P] drew a new grounding
    log_total: Array  # f32[] log-likelihood of the observation
    log_language: Array  # f32[] log p(words | observed map), estimated
    is_dead: Array  # bool[] all weights were zero and were reset to uniform


def reground(
    key: Array,
    uniform: Array,
    belief: ParticleBelief,
    readings: Readings,
    update: MeasurementUpdate,
    ground: Callable[..., tuple[SemanticMap, Array]],
) -> Regrounded:
    """Re-ground the words in particles with a refuted hypothesis or a new object of their types.

    Belief and weights are those of ``observe``; ``uniform``, f32[2, P], selects the survivors and
    the ancestors of the others; ``ground`` is ``ground_words`` with all but key, belief, readings.
    """
    num_particles, particles = belief.log_weight.shape[0], belief.particles
    # A forced draw has the weight of the particle's map alone, without its hypotheses.
    log_map = belief.log_weight + update.log_map
    (kept_weight, map_weight), log_totals, are_dead = categorical.log_normalize(
        jnp.stack([log_map + update.log_hypotheses, log_map])
    )
    # Words that name a newly observed type or attribute are grounded anew, too.
    is_changed = update.is_type_changed
    if update.is_flipped.shape[0]:  # ranks compare objects that probably exist
        is_changed = is_changed | (update.is_flipped & jnp.any(readings.rank > 0))
    new_type = jnp.where(is_changed, label_of(particles.object_type), -3)
    types = readings.mention_type.reshape(-1)
    is_new_type = jnp.any(label_of(types)[:, None, None] == new_type[None], axis=(0, 1))
    is_new_type = is_new_type | (jnp.any(is_anything(types)) & jnp.any(new_type >= 0, axis=0))
    must_ground = belief.must_ground | is_new_type
    keep_uniform, ancestor_uniform = uniform
    is_fresh = must_ground | (keep_uniform > kept_weight * num_particles)
    is_fresh = is_fresh if update.is_lost is None else is_fresh | update.is_lost
    # A refuted particle is replaced as a whole: it copies the map of a particle drawn by weight,
    # so that a wrong map is lost, and then grounds the words in it.
    ancestors = categorical.independent(kept_weight, ancestor_uniform)
    ancestors = jnp.where(is_fresh & ~must_ground, ancestors, jnp.arange(num_particles))
    is_needed = is_fresh | (jnp.arange(num_particles) % max(1, num_particles // _NUM_PROBES) == 0)
    belief = replace(belief, particles=take(particles, ancestors))
    fresh, log_language = ground(key, belief, readings, is_asked=is_needed)
    # Fresh groundings have the evidence of the words relative to its mean as weight.
    num_needed = jnp.sum(is_needed).astype(jnp.float32)
    prob, log_evidence, _ = categorical.log_normalize(log_language)
    language = jnp.clip(prob * num_needed, 1e-6, 50.0)
    fresh_weight = jnp.where(must_ground, map_weight, 1.0 / num_particles) * language
    weight = jnp.where(is_fresh, fresh_weight, jnp.maximum(kept_weight, 1.0 / num_particles))

    def merge(new: Array, old: Array) -> Array:
        # Leaves without groundings are the same object in both.
        return old if new is old else jnp.where(is_fresh, new, old)

    return Regrounded(
        particles=jax.tree.map(merge, fresh, belief.particles),
        weight=weight / jnp.sum(weight),
        is_fresh=is_fresh,
        log_total=log_totals[0],
        log_language=log_evidence - jnp.log(num_needed),
        is_dead=are_dead[0],
    )
