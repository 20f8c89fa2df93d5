"""Relevance of mentions to the goal: connected components of the relation graph (not in paper).

A sentence may mention more than its current command needs: constraints, the next command's goal,
earlier statements. The relations of an interpretation connect its mentions into groups; the group
of the goal is relevant. The robot, to which any object may be related, connects nothing.

Sets of mentions are bits of integers: bit m of a set says whether mention m is in it.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import NONE, ROBOT, Behavior, Readings
from jaxlangnav.numerics.batching import lookup
from jaxlangnav.semantic_map.particle import SemanticMap

_MIN_GOAL_PROB = 1e-3
"""Goal probability below which a mention is not a goal in a particle."""


def components(readings: Readings) -> Array:
    """Compute the connected components of mentions in each of K interpretations.

    i32[M, K], for each mention the bit set of its component, itself included.
    """
    num_mentions = readings.mention_type.shape[-1]
    mentions, identity = np.arange(num_mentions)[None, None], np.eye(num_mentions, dtype=bool)[None]
    is_object = readings.mention_type != ROBOT
    figure = readings.figure[..., None] == mentions  # [K, J, M]
    landmark = (readings.landmark[..., None] == mentions) & (readings.relation != NONE)[..., None]
    is_connected = jnp.any(figure[..., :, None] & landmark[..., None, :], axis=1)  # [K, M, M]
    is_connected = (is_connected | is_connected.mT) & is_object[:, :, None] & is_object[:, None, :]
    is_connected = is_connected | identity
    for _ in range(max(1, int(np.ceil(np.log2(num_mentions))))):
        is_connected = jnp.any(is_connected[:, :, :, None] & is_connected[:, None, :, :], axis=2)
    return _bitset(is_connected.T)


def _bitset(is_member: Array) -> Array:
    """Encode bool[M, ...] as a bit set of mentions, i32[...]."""
    bits = (1 << np.arange(is_member.shape[0])).reshape(-1, *(1,) * (is_member.ndim - 1))
    return jnp.sum(jnp.where(is_member, bits, 0), axis=0, dtype=jnp.int32)


def particle_groups(readings: Readings, particles: SemanticMap) -> Array:
    """Look up the groups under each particle's interpretation, i32[M, P]."""
    table = components(readings).T  # [K, M]
    index = jnp.broadcast_to(particles.reading, (table.shape[1], particles.reading.shape[-1]))
    return lookup(table[:, :, None], index)


def links_to_unseen(group_bits: Array, particles: SemanticMap) -> Array:
    """Mark mentions in groups with a hypothesised (unobserved) object, bool[M, P]."""
    return (group_bits & _bitset(particles.is_hypothesised)[None]) != 0


def links_to_goal(group_bits: Array, particles: SemanticMap, behavior: Behavior) -> Array:
    """Mark the mentions in the group of the current command's goal.

    bool[M, P], for the groups from ``particle_groups``. Limits: in a particle whose goal is none
    of the mentions, such as "the other cone", all are marked.
    """
    num_objects, num_mentions = particles.object_type.shape[0], particles.referent.shape[0]
    goal = jnp.sum(behavior.goal, axis=0)  # [O + 1, P]
    is_referent = np.arange(num_objects)[:, None, None] == particles.referent[None]  # [O, M, P]
    observed_mass = jnp.sum(jnp.where(is_referent, goal[:num_objects, None], 0.0), axis=0)
    mention_mass = observed_mass + goal[num_objects : num_objects + num_mentions]
    goals = _bitset((mention_mass > _MIN_GOAL_PROB) & particles.is_mentioned)
    return ((group_bits & goals[None]) != 0) | (goals == 0)[None]
