"""What is kept of a conversation besides the readings, and what a decision makes of it.

The paper conditions on the history of utterances A^t. Here their readings are joined into one set
(``join``), and this record says of it what readings do not hold: from where each relation was said,
of which things the task speaks, which of them are to be kept away from, and what is not meant.

All of it is arrays of fixed shapes. C commands, K readings, M mentions, J relations, O slots. In
what a decision makes of it, particles and their behavior have leaves [..., P], ``mention_type``
i32[K, M] is of the readings, ``words`` are what these are about, and ``clause`` i32[] is the
present command.
"""

from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.inputs.object_types import is_type
from jaxlangnav.messages import AT, NONE, Behavior, UtteranceContext
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.semantic_map.proposal.relation_query import current_context

_Numbers = TypeVar("_Numbers", Array, np.ndarray)
AVOID_IT, AVOID_ALL = 1, 2
"""A mention is to be kept away from; all things of its type are."""


@pytree
class Words:
    """What readings are about: the same for all who have heard the same."""

    is_asked: Array  # bool[K, M] the task speaks of it; otherwise it is only known of the map
    avoid: Array  # i32[K, M] AVOID_IT, AVOID_ALL, or 0
    goal: Array  # i32[K, C] mention that each command is about; NONE: not known
    is_pinned: Array  # bool[K, C] other utterances say which one that is
    heard: Array  # i32[K, J] which utterance said the relation, counted from 0
    num_heard: Array  # i32[] utterances so far
    num_dropped: Array  # i32[] relations of the likeliest reading that found no room any more


@pytree
class Conversation:
    """What has been said, and done about it."""

    words: Words
    context: UtteranceContext  # from where the relations were said, and what mentions are not
    viewer: Array  # f32[C, 3] x, y, heading of the robot as it heard each command; map frame
    home: Array  # f32[3] x, y, heading where the conversation began
    approached: Array  # i32[] observed slot that the robot last went up to for this task; NONE
    ruled_out: Array  # i32[] observed slots that are no goal of the present command, a bit each
    chosen: Array  # i32[] observed slot that an answer has named; NONE
    candidate: Array  # f32[O] goal probability of the observed slots at the last decision
    closeness: Array  # f32[] share of the usual reach at which the robot has arrived
    may_ask: Array  # bool[] it has not been told to choose by itself


def begin_conversation(
    instruction: Instruction, pose: Array, num_objects: int, words: Words | None = None
) -> Conversation:
    """Build the memory of a robot that has just been told what to do.

    Args:
        instruction: grounded sentence.
        pose: f32[3], x, y, heading as it hears it, map frame.
        num_objects: O.
        words: what the readings are about; by default the task speaks of all of it.
    """
    readings = instruction.readings
    return Conversation(
        words=heard_alone(instruction) if words is None else words,
        context=current_context(readings, pose),
        viewer=seen_from(pose, instruction.frame),
        home=pose,
        approached=jnp.int32(NONE),
        ruled_out=jnp.int32(0),
        chosen=jnp.int32(NONE),
        candidate=jnp.zeros(num_objects, jnp.float32),
        closeness=jnp.float32(1.0),
        may_ask=jnp.asarray(True),
    )


def seen_from(pose: _Numbers, frame: _Numbers) -> _Numbers:
    """Put poses f32[C, 3] that are told in the frame of a robot at ``pose`` f32[3] into the map.

    Poses are x, y, heading, metres and radians. Limits: none told gives the robot's own.
    """
    xp: Any = np if isinstance(pose, np.ndarray) else jnp
    ahead, aside = xp.cos(pose[2]), xp.sin(pose[2])
    x = pose[0] + ahead * frame[:, 0] - aside * frame[:, 1]
    y = pose[1] + aside * frame[:, 0] + ahead * frame[:, 1]
    return xp.stack([x, y, pose[2] + frame[:, 2]], axis=1)


def heard_alone(
    instruction: Instruction, heard: int = 0, *, is_asked: bool = True, xp: Any = jnp
) -> Words:
    """Take an utterance by itself, the ``heard``-th, which asks for all that it speaks of or none.

    Of goals nothing is known yet. Leaves are arrays of ``xp``, NumPy or JAX.
    """
    readings = instruction.readings
    mentions, relations = readings.mention_type.shape, readings.relation.shape
    commands = mentions[0], instruction.program.num_phrases.shape[-1]
    return Words(
        is_asked=xp.full(mentions, is_asked),
        avoid=xp.zeros(mentions, xp.int32),
        goal=xp.full(commands, NONE, xp.int32),
        is_pinned=xp.zeros(commands, bool),
        heard=xp.full(relations, heard, xp.int32),
        num_heard=xp.int32(heard + 1),
        num_dropped=xp.int32(0),
    )


def _of_reading(values: Array, particles: SemanticMap) -> Array:
    """Look up [K, M] by the readings of the particles, [M, P]."""
    return jnp.take(values, particles.reading, axis=0, mode="clip").T


def focus(particles: SemanticMap, words: Words) -> SemanticMap:
    """Leave in particles only what the task speaks of.

    What other utterances have said stays in the map, but nobody has to look for it, and it is
    nothing that a goal would have to be confirmed by.

    Limits: where the task speaks of all of it, nothing changes.
    """
    is_asked = _of_reading(words.is_asked, particles)
    return replace(
        particles,
        is_mentioned=particles.is_mentioned & is_asked,
        referent=jnp.where(is_asked, particles.referent, NONE),
    )


def as_answered(behavior: Behavior, particles: SemanticMap, talk: Conversation) -> Behavior:
    """Condition goals [..., P] on answers: what is ruled out is none, what is named is the goal.

    What is named is so in every particle that has it; its region is the belief's marginal.
    """
    goal, slots = behavior.goal, jnp.arange(behavior.goal.shape[1])
    is_out = (slots < 31) & ((talk.ruled_out >> jnp.minimum(slots, 30)) & 1 == 1)
    goal = jnp.where(is_out[None, :, None], 0.0, goal)
    region = jnp.sum(goal, axis=(1, 2)) / jnp.maximum(jnp.sum(goal), 1e-12)
    is_there = jnp.pad(particles.is_observed, ((0, slots.size - talk.candidate.size), (0, 0)))
    named = region[:, None, None] * ((slots == talk.chosen)[:, None] & is_there)[None]
    return replace(behavior, goal=jnp.where(talk.chosen == NONE, goal, named))


def pinned(
    behavior: Behavior, particles: SemanticMap, mention_type: Array, words: Words, clause: Array
) -> Behavior:
    """Take for goals only what a command refers to, where other utterances say which one it is.

    By itself "go to the hydrant" is content with any hydrant. Told that the hydrant is behind the
    car it is not, and what its words refer to in a particle knows of that, which the words of the
    command do not.

    Limits: nothing changes where no other utterance has spoken of what the command is about.

    Returns:
        The behavior, without goals at others of that type.
    """
    num_objects, reading = particles.object_type.shape[0], particles.reading
    by_reading = [jnp.take(one, clause, axis=1) for one in (words.goal, words.is_pinned)]
    goal, is_pinned = (jnp.take(one, reading, mode="clip") for one in by_reading)  # [P]
    mentions = jnp.arange(mention_type.shape[1])[:, None]
    is_goal = mentions == goal[None]
    own_type = _of_reading(mention_type, particles)  # [M, P]
    kind = jnp.sum(jnp.where(is_goal, own_type, 0), axis=0)
    referent = jnp.sum(jnp.where(is_goal, particles.referent, 0), axis=0)
    is_other = jnp.concatenate(
        [
            is_type(particles.object_type, kind[None])
            & (jnp.arange(num_objects)[:, None] != referent[None]),
            is_type(own_type, kind[None]) & ~is_goal,
        ]
    )
    is_other = is_other & (is_pinned & (goal != NONE))[None]
    is_other = jnp.pad(is_other, ((0, 1), (0, 0)))  # the robot
    return replace(behavior, goal=jnp.where(is_other[None], 0.0, behavior.goal))


def avoided(
    behavior: Behavior, particles: SemanticMap, mention_type: Array, words: Words
) -> Behavior:
    """Add what is to be kept away from to the constraints.

    A thing that is the goal is not kept away from, whatever was said before.

    Returns:
        The behavior with constraints on observed slots; nothing changes where nothing is avoided.
    """
    num_objects = particles.object_type.shape[0]
    avoid, kind = (_of_reading(one, particles)[:, None] for one in (words.avoid, mention_type))
    slots = jnp.arange(num_objects)[None, :, None]
    is_it = (avoid == AVOID_IT) & (particles.referent[:, None] == slots)
    is_alike = (avoid == AVOID_ALL) & is_type(particles.object_type[None], kind)
    is_kept = jnp.any(is_it | is_alike, axis=0) & particles.is_observed
    goal = jnp.sum(behavior.goal, axis=0)[:num_objects]
    share = jnp.where(is_kept, 1.0 - jnp.minimum(goal, 1.0), 0.0)
    share = jnp.pad(share, ((0, behavior.constraint.shape[1] - num_objects), (0, 0)))
    is_at = (jnp.arange(behavior.constraint.shape[0]) == AT)[:, None, None]
    constraint = jnp.maximum(behavior.constraint, jnp.where(is_at, share[None], 0.0))
    return replace(behavior, constraint=constraint)


def excluding(talk: Conversation, clause: Array, slots: Array) -> Conversation:
    """Rule out observed slots, i32[], a bit each: the present command is about none of them.

    It is evidence like any other: the words are grounded anew without these, and what remains is
    weighed as before. So a hypothesis that had nothing else loses its weight.
    """
    excluded = talk.context.excluded
    goal = jnp.take(talk.words.goal, clause, axis=1, mode="clip")
    is_goal = jnp.arange(excluded.shape[1])[None] == goal[:, None]
    context = replace(talk.context, excluded=jnp.where(is_goal, excluded | slots, excluded))
    return replace(talk, context=context, ruled_out=talk.ruled_out | slots)
