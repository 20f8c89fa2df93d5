"""Which of the things spoken of bear on the goal: those it is placed against, and theirs (ours).

A sentence may speak of more than its present command needs: of what to keep away from, of the next
command's goal, of what was said before. The relations of a reading tie its mentions into groups;
what bears on the goal is its group. The robot, against which anything may be placed, ties nothing.

Sets of mentions are bits of integers: bit m of a set says whether mention m is in it.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import NONE, ROBOT, Behavior, Readings
from jaxlangnav.numerics.batching import lookup
from jaxlangnav.semantic_map.particle import SemanticMap

LEAST_GOAL_MENTION = 1e-3
"""Goal probability below which a mention is no goal of a particle's."""


def groups(readings: Readings) -> Array:
    """Find which mentions the relations of each of K readings tie together, through others too.

    i32[M, K], a set of mentions for each; itself is in it.
    """
    num_mentions = readings.mention_type.shape[-1]
    mentions, same = np.arange(num_mentions)[None, None], np.eye(num_mentions, dtype=bool)[None]
    is_thing = readings.mention_type != ROBOT
    figure = readings.figure[..., None] == mentions  # [K, J, M]
    landmark = (readings.landmark[..., None] == mentions) & (readings.relation != NONE)[..., None]
    is_tied = jnp.any(figure[..., :, None] & landmark[..., None, :], axis=1)  # [K, M, M]
    is_tied = (is_tied | is_tied.mT) & is_thing[:, :, None] & is_thing[:, None, :]
    is_tied = is_tied | same
    for _ in range(max(1, int(np.ceil(np.log2(num_mentions))))):
        is_tied = jnp.any(is_tied[:, :, :, None] & is_tied[:, None, :, :], axis=2)
    return _set_of(is_tied.T)


def _set_of(is_in: Array) -> Array:
    """Write bool[M, ...] as a set of mentions, i32[...]."""
    place = (1 << np.arange(is_in.shape[0])).reshape(-1, *(1,) * (is_in.ndim - 1))
    return jnp.sum(jnp.where(is_in, place, 0), axis=0, dtype=jnp.int32)


def believed_groups(readings: Readings, particles: SemanticMap) -> Array:
    """Look up the groups of the reading that each particle believes, i32[M, P]."""
    table = groups(readings).T  # [K, M]
    number = particles.reading.shape[-1]
    index = jnp.broadcast_to(particles.reading, (table.shape[1], number))
    return lookup(table[:, :, None], index)


def has_open_partner(group: Array, particles: SemanticMap) -> Array:
    """Tell which mentions are tied to one that has not been seen, bool[M, P]; or are one."""
    return (group & _set_of(particles.is_hypothesised)[None]) != 0


def bears_on_goal(group: Array, particles: SemanticMap, behavior: Behavior) -> Array:
    """Tell which mentions are tied to the goal of the present command.

    bool[M, P], of the groups that ``believed_groups`` finds. Limits: in a particle whose goal is
    none of the mentions, such as "the other cone", all do.
    """
    num_objects, num_mentions = particles.object_type.shape[0], particles.referent.shape[0]
    goal = jnp.sum(behavior.goal, axis=0)  # [N + 1, P]
    is_referent = np.arange(num_objects)[:, None, None] == particles.referent[None]  # [O, M, P]
    seen = jnp.sum(jnp.where(is_referent, goal[:num_objects, None], 0.0), axis=0)
    on_mention = seen + goal[num_objects : num_objects + num_mentions]
    goals = _set_of((on_mention > LEAST_GOAL_MENTION) & particles.is_mentioned)
    return ((group & goals[None]) != 0) | (goals == 0)[None]
