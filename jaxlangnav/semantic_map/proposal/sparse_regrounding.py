"""Re-ground the utterance where a hypothesis was refuted: *rejection control* (eq. 7a and 8).

A particle of weight w below the mean c survives with probability w / c and then weighs c; otherwise
the map of an ancestor drawn by weight and a fresh draw from the posterior of the sentence given
that map take its place, with weight c. Both kinds are properly weighted for the same target, so the
mixture is too; and when every hypothesis is refuted all are replaced, which is how the filter
revives.
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
from jaxlangnav.numerics.resampling import independent
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.observe import MeasurementUpdate
from jaxlangnav.semantic_map.particle import SemanticMap

_ASKED = 16  # particles that ground the words at every step, to tell the mean of the evidence


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
    weighed: MeasurementUpdate,
    ground: Callable[..., tuple[SemanticMap, Array]],
) -> Regrounded:
    """Ground the words anew where the old hypothesis was refuted or a new object calls for it.

    Belief and weights are those of ``observe``; ``uniform`` f32[2, P] decides who is kept, and
    whose map the others take; ``ground`` is ``ground_words`` with all but key, belief and readings.
    """
    number, particles = belief.log_weight.shape[0], belief.particles
    # What a particle's own map weighs, apart from its hypotheses, goes with a forced draw.
    log_map = belief.log_weight + weighed.log_map
    (kept_weight, map_weight), log_totals, are_dead = categorical.log_normalize(
        jnp.stack([log_map + weighed.log_hypotheses, log_map])
    )
    # Words that speak of a type or an attribute newly seen are grounded anew, too.
    new_type = jnp.where(weighed.is_other, label_of(particles.object_type), -3)
    kinds = readings.mention_type.reshape(-1)
    is_named = jnp.any(label_of(kinds)[:, None, None] == new_type[None], axis=(0, 1))
    is_named = is_named | (jnp.any(is_anything(kinds)) & jnp.any(new_type >= 0, axis=0))
    must_ground = belief.must_ground | is_named
    keep_uniform, ancestor_uniform = uniform
    is_fresh = must_ground | (keep_uniform > kept_weight * number)
    is_fresh = is_fresh if weighed.is_lost is None else is_fresh | weighed.is_lost
    # A refuted particle is replaced as a whole: it takes over the map of a particle drawn by
    # weight, so that a wrong map dies out, and then grounds the words in it.
    ancestors = independent(kept_weight, ancestor_uniform)
    ancestors = jnp.where(is_fresh & ~must_ground, ancestors, jnp.arange(number))
    is_asked = is_fresh | (jnp.arange(number) % max(1, number // _ASKED) == 0)
    belief = replace(belief, particles=take(particles, ancestors))
    fresh, log_language = ground(key, belief, readings, is_asked=is_asked)
    # Fresh groundings weigh by the evidence of the words against its mean.
    num_asked = jnp.sum(is_asked).astype(jnp.float32)
    share, log_evidence, _ = categorical.log_normalize(log_language)
    language = jnp.clip(share * num_asked, 1e-6, 50.0)
    fresh_weight = jnp.where(must_ground, map_weight, 1.0 / number) * language
    weight = jnp.where(is_fresh, fresh_weight, jnp.maximum(kept_weight, 1.0 / number))

    def renewed(new: Array, old: Array) -> Array:
        # What is not grounded is the same in both.
        return old if new is old else jnp.where(is_fresh, new, old)

    return Regrounded(
        particles=jax.tree.map(renewed, fresh, belief.particles),
        weight=weight / jnp.sum(weight),
        is_fresh=is_fresh,
        log_total=log_totals[0],
        log_language=log_evidence - jnp.log(num_asked),
        is_dead=are_dead[0],
    )
