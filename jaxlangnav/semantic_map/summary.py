"""Inputs of the behavior model: a particle's objects and relations, and distinct topologies."""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE, RELATIONS, ROBOT, BehaviorWorld, Readings
from jaxlangnav.numerics.batching import select_row
from jaxlangnav.relations import symbol_of
from jaxlangnav.semantic_map.particle import SemanticMap


def behavior_world(particle: SemanticMap, readings: Readings, previous: Array) -> BehaviorWorld:
    """Build the behavior model's world from one particle's objects and relations (section 3.3).

    Args:
        particle: one particle.
        readings: interpretations of the sentence.
        previous: i32[], observed slot that was the goal of the last command; NONE at first.

    Returns:
        Objects (observed, then hypothesised, the robot last) and edges of the topology.
    """
    num_objects, num_mentions = particle.object_type.shape[0], particle.referent.shape[0]
    num_slots = num_objects + num_mentions + 1
    slots, mentions = jnp.arange(num_slots), jnp.arange(num_mentions)
    reading = select_row(readings, particle.reading)
    mention_type, robot = reading.mention_type, jnp.full(1, ROBOT, jnp.int32)
    hypothesised = jnp.where(particle.is_hypothesised, mention_type, NONE)
    is_object = jnp.concatenate([particle.is_observed, particle.is_hypothesised, jnp.ones(1, bool)])
    slot = jnp.where(particle.referent == NONE, num_objects + mentions, particle.referent)
    slot = jnp.where(mention_type == ROBOT, num_slots - 1, slot)
    figure, landmark = (
        jnp.sum(jnp.where(ends[:, None] == mentions[None], slot[None], 0), axis=1)
        for ends in (reading.figure, reading.landmark)
    )
    edge = (  # [J, 6, N + 1, N + 1]
        (symbol_of(reading.relation)[:, None] == jnp.arange(len(RELATIONS))[None])[:, :, None, None]
        & (figure[:, None] == slots[None])[:, None, :, None]
        & (landmark[:, None] == slots[None])[:, None, None, :]
    )
    return BehaviorWorld(
        object_type=jnp.concatenate([particle.object_type, hypothesised, robot]),
        is_object=is_object,
        is_related=jnp.any(edge, axis=0),
        is_superlative=jnp.any(edge & (reading.rank == 1)[:, None, None, None], axis=0),
        is_ordinal=jnp.any(edge & (reading.rank > 1)[:, None, None, None], axis=0),
        is_previous=(slots == previous) & (previous != NONE),
    )


def distinct_topologies(particles: SemanticMap) -> tuple[Array, Array, Array]:
    """Find the distinct topologies of particles: object types, reading and referents.

    Particles of one topology have the same behavior; there are far fewer topologies than particles.

    Returns:
        i32[P], the topology of each particle, counted from 0 in order of first appearance;
        i32[P], the first particle of topology u at index u (P beyond the last one); and i32[], the
        number of topologies.
    """
    fields = particles.object_type, particles.referent, particles.is_mentioned
    columns = jnp.concatenate([*fields, particles.reading[None]])
    num_particles = columns.shape[1]
    index = jnp.arange(num_particles)

    def is_unfinished(carry: tuple[Array, Array, Array]) -> Array:
        return jnp.any(carry[0] < 0)

    def assign_next(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        topology, representative, count = carry
        first = jnp.argmax(topology < 0)
        is_same = jnp.all(columns == columns[:, first, None], axis=0)
        return (
            jnp.where(is_same, count, topology),
            jnp.where(index == count, first, representative),
            count + 1,
        )

    # One topology after the other: comparing all pairs of particles is quadratic in P.
    start = (jnp.full(num_particles, -1), jnp.full(num_particles, num_particles), jnp.int32(0))
    return jax.lax.while_loop(is_unfinished, assign_next, start)
