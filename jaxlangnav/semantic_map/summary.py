"""What others want to know of a belief: the behavior model's world, positions, marginals."""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE, RELATIONS, ROBOT, BehaviorWorld, Readings
from jaxlangnav.semantic_map.particle import SemanticMap


def behavior_world(particle: SemanticMap, readings: Readings, previous: Array) -> BehaviorWorld:
    """Describe one particle's objects and relation edges to the behavior model (section 3.3).

    Args:
        particle: one particle.
        readings: the sentence, for the relations that the particle's edges stand for.
        previous: i32[], observed slot that was the goal of the last command; NONE at first.

    Returns:
        Objects (observed, then hypothesised, the robot last) and edges of the topology.
    """
    num_objects, num_mentions = particle.object_type.shape[0], particle.referent.shape[0]
    size = num_objects + num_mentions + 1
    slots = jnp.arange(size)
    mention_type = readings.mention_type[particle.reading]
    object_type = jnp.concatenate(
        [
            particle.object_type,
            jnp.where(particle.is_hypothesised, mention_type, NONE),
            jnp.full(1, ROBOT, jnp.int32),
        ]
    )
    is_object = jnp.concatenate([particle.is_observed, particle.is_hypothesised, jnp.ones(1, bool)])
    place = jnp.where(
        particle.referent == NONE, num_objects + jnp.arange(num_mentions), particle.referent
    )
    place = jnp.where(mention_type == ROBOT, size - 1, place)
    is_related = jnp.zeros((len(RELATIONS), size, size), bool)
    is_superlative = jnp.zeros((len(RELATIONS), size, size), bool)
    for index in range(readings.relation.shape[1]):
        relation = readings.relation[particle.reading, index]
        mentions = jnp.arange(num_mentions)
        figure = jnp.sum(jnp.where(mentions == readings.figure[particle.reading, index], place, 0))
        landmark = jnp.sum(
            jnp.where(mentions == readings.landmark[particle.reading, index], place, 0)
        )
        edge = (
            (jnp.arange(len(RELATIONS)) == relation)[:, None, None]
            & (slots == figure)[None, :, None]
            & (slots == landmark)[None, None, :]
        )
        is_related = is_related | edge
        is_superlative = is_superlative | (edge & readings.is_superlative[particle.reading, index])
    return BehaviorWorld(
        object_type=object_type,
        is_object=is_object,
        is_related=is_related,
        is_superlative=is_superlative,
        is_previous=(slots == previous) & (previous != NONE),
    )
