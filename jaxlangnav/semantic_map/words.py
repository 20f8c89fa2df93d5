"""Grounding the words of an instruction in particles (section 3.2, eq. 7a)."""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import Readings, Told
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.candidates import Seen
from jaxlangnav.semantic_map.draws import draw_places
from jaxlangnav.semantic_map.gathered import ground_all, ground_sparse
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.semantic_map.said import listen, told_now


def ground_words(
    key: Array,
    belief: ParticleBelief,
    readings: Readings,
    *,
    params: MapParams,
    told: Told | None = None,
    is_asked: Array | None = None,
    is_sparse: bool = False,
    num_pooled: Array | None = None,
) -> tuple[SemanticMap, Array]:
    """Draw for particles a reading and what its words refer to (eq. 7a).

    Args:
        key: random key.
        belief: the observed map and where the robot has looked.
        readings: the sentence.
        params: relations, concentration.
        told: how it was said; all of it to the belief's viewer by default.
        is_asked: bool[P], the particles whose words are grounded; all by default.
        is_sparse: under ``vmap``, compute only those; no gradient in reverse mode.
        num_pooled: f32[], types that have one rate of how many there are; None: each its own.

    Returns:
        Particles with fresh groundings, and f32[P], log of the evidence estimated by each. Of
        particles that were not asked the groundings mean nothing and the evidence is −∞.
    """
    particles, number = belief.particles, belief.log_weight.shape[0]
    asked = jnp.ones(number, bool) if is_asked is None else is_asked
    uniform, draws, scene = draw_places(key, belief, readings.figure.shape[1])
    scene = scene._replace(num_pooled=num_pooled)
    reading = _reading(readings, uniform)
    own = _seen(particles), draws, reading
    how = told_now(readings, belief.viewer) if told is None else told
    said = listen(readings, how, params.relations, scene.log_area)
    num_mentions = readings.mention_type.shape[1]
    if is_sparse:
        grounding = ground_sparse(num_mentions)(asked, own, said, scene, params)
    else:
        grounding = ground_all(num_mentions, own, said, scene, params=params)
    fresh = replace(
        particles,
        reading=reading,
        referent=grounding.slot,
        anchor=grounding.anchor,
        root=grounding.root,
        hypothesis_x=grounding.x,
        hypothesis_y=grounding.y,
        is_mentioned=grounding.is_grounded,
    )
    return fresh, jnp.where(asked, grounding.log_weight, -jnp.inf)


def _reading(readings: Readings, uniform: Array) -> Array:
    """Choose the readings that particles believe by their probability, i32[P]; given f32[P]."""
    share = jnp.cumsum(jnp.exp(readings.log_probability))
    point = uniform * share[-1]
    return jnp.sum(share[:-1, None] <= point[None, :], axis=0).astype(jnp.int32)


def _seen(particles: SemanticMap) -> Seen:
    """Tell what particles have seen, leaves [..., P]."""
    num_objects = particles.object_type.shape[0]
    return Seen(
        particles.object_type,
        particles.mean_x[:num_objects],
        particles.mean_y[:num_objects],
        particles.existence if particles.existence.shape[0] else None,
    )
