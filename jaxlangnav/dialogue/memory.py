"""Dialogue state on the device, and how it constrains the inferred behavior.

The paper conditions on the history of utterances A^t. Here their readings are merged into one set
(``merge_utterance``). This state adds what readings lack: the viewpoint of each relation, which
mentions the task requests, which of them are to be avoided, and which objects are excluded.

All arrays have fixed shapes. C commands, K readings, M mentions, J relations, O slots. In functions
on behaviors, particles and their behavior have leaves [..., P], ``mention_type`` i32[K, M] is that
of the readings, ``words`` are the discourse information on these, ``clause`` i32[] is the index of
the present command.
"""

from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.inputs.object_types import is_type
from jaxlangnav.messages import AT, NONE, Behavior, UtteranceContext
from jaxlangnav.numerics.batching import select_row
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.semantic_map.proposal.relation_query import current_context

_Floats = TypeVar("_Floats", Array, np.ndarray)
AVOID_IT, AVOID_ALL = 1, 2
"""Values of ``avoid``: keep away from the mentioned object; from all objects of its type."""


@pytree
class DiscourseInfo:
    """Roles of mentions and sources of relations in the readings; set by the utterances alone."""

    is_asked: Array  # bool[K, M] the task refers to it; otherwise it only describes the map
    avoid: Array  # i32[K, M] AVOID_IT, AVOID_ALL, or 0
    goal: Array  # i32[K, C] goal mention of each command; NONE: unknown
    is_pinned: Array  # bool[K, C] other utterances specify which object that is
    heard: Array  # i32[K, J] index of the utterance that stated the relation
    num_heard: Array  # i32[] utterances so far
    num_dropped: Array  # i32[] relations dropped from the likeliest reading, for lack of capacity


@pytree
class Conversation:
    """Dialogue state: utterances so far, answers, exclusions and the object last approached."""

    words: DiscourseInfo
    context: UtteranceContext  # viewpoints of relations, and excluded objects of mentions
    viewer: Array  # f32[C, 3] x, y, heading of the robot as it heard each command; map frame
    home: Array  # f32[3] x, y, heading where the conversation began
    approached: Array  # i32[] observed slot last approached for this task; NONE
    ruled_out: Array  # i32[] bit mask of observed slots that are not the present command's goal
    chosen: Array  # i32[] observed slot that an answer has named; NONE
    candidate: Array  # f32[O] goal probability of the observed slots at the last decision
    closeness: Array  # f32[] factor on the distance to the goal at which the robot has arrived
    may_ask: Array  # bool[] false once the user has left the choice to the robot


def begin_conversation(
    instruction: Instruction, pose: Array, num_objects: int, words: DiscourseInfo | None = None
) -> Conversation:
    """Initialize the dialogue state from the first command.

    Args:
        instruction: grounded sentence.
        pose: f32[3], x, y, heading as the robot hears it, map frame.
        num_objects: O.
        words: discourse information on the readings; by default the task requests all mentions.
    """
    return Conversation(
        words=default_discourse(instruction) if words is None else words,
        context=current_context(instruction.readings, pose),
        viewer=compose_poses(pose, instruction.frame),  # frame: commands' poses, robot frame
        home=pose,
        **new_task_fields(num_objects),
    )


def new_task_fields(num_objects: int) -> dict[str, Array]:
    """Initialize the fields of ``Conversation`` that a new task resets, by name; O objects."""
    return {
        "approached": jnp.int32(NONE),
        "ruled_out": jnp.int32(0),
        "chosen": jnp.int32(NONE),
        "candidate": jnp.zeros(num_objects, jnp.float32),
        "closeness": jnp.float32(1.0),
        "may_ask": jnp.asarray(True),
    }


def compose_poses(pose: _Floats, relative: _Floats) -> _Floats:
    """Compose a robot's ``pose`` f32[3] with poses f32[C, 3] in its frame: poses in the map frame.

    Poses are x, y, heading, metres and radians. Limits: zeros give the robot's own pose.
    """
    xp: Any = np if isinstance(pose, np.ndarray) else jnp
    cos, sin = xp.cos(pose[2]), xp.sin(pose[2])
    x = pose[0] + cos * relative[:, 0] - sin * relative[:, 1]
    y = pose[1] + sin * relative[:, 0] + cos * relative[:, 1]
    return xp.stack([x, y, pose[2] + relative[:, 2]], axis=1)


def default_discourse(
    instruction: Instruction, utterance: int = 0, *, is_asked: bool = True, xp: Any = jnp
) -> DiscourseInfo:
    """Initialize for utterance number ``utterance``; it requests all its mentions, or none.

    Goals are unknown as yet. Leaves are arrays of ``xp``, NumPy or JAX.
    """
    readings = instruction.readings
    mentions, relations = readings.mention_type.shape, readings.relation.shape
    commands = mentions[0], instruction.clauses.num_phrases.shape[-1]
    return DiscourseInfo(
        is_asked=xp.full(mentions, is_asked),
        avoid=xp.zeros(mentions, xp.int32),
        goal=xp.full(commands, NONE, xp.int32),
        is_pinned=xp.zeros(commands, bool),
        heard=xp.full(relations, utterance, xp.int32),
        num_heard=xp.int32(utterance + 1),
        num_dropped=xp.int32(0),
    )


def _per_particle(values: Array, particles: SemanticMap) -> Array:
    """Gather values [K, M] by each particle's reading, [M, P]."""
    return jnp.take(values, particles.reading, axis=0, mode="clip").T


def task_mentions(particles: SemanticMap, words: DiscourseInfo) -> SemanticMap:
    """Keep in particles only the mentions that the task requests.

    What other utterances describe stays in the map, but need not be searched for, and no goal is
    confirmed by it.

    Limits: where the task requests all mentions, nothing changes.
    """
    is_asked = _per_particle(words.is_asked, particles)
    is_mentioned = particles.is_mentioned & is_asked
    referent = jnp.where(is_asked, particles.referent, NONE)
    return replace(particles, is_mentioned=is_mentioned, referent=referent)


def apply_answers(behavior: Behavior, particles: SemanticMap, state: Conversation) -> Behavior:
    """Condition goals [..., P] on answers: zero those ruled out, set the one that was named.

    The named object is the goal in every particle that has it; its region is the belief's marginal.
    """
    goal, slots = behavior.goal, jnp.arange(behavior.goal.shape[1])
    is_out = (slots < 31) & ((state.ruled_out >> jnp.minimum(slots, 30)) & 1 == 1)
    goal = jnp.where(is_out[None, :, None], 0.0, goal)
    region = jnp.sum(goal, axis=(1, 2)) / jnp.maximum(jnp.sum(goal), 1e-12)
    is_observed = jnp.pad(particles.is_observed, ((0, slots.size - state.candidate.size), (0, 0)))
    named = region[:, None, None] * ((slots == state.chosen)[:, None] & is_observed)[None]
    return replace(behavior, goal=jnp.where(state.chosen == NONE, goal, named))


def pin_goals(
    behavior: Behavior, particles: SemanticMap, types: Array, words: DiscourseInfo, clause: Array
) -> Behavior:
    """Restrict a command's goal to its referent where other utterances specify which object it is.

    "Go to the hydrant" alone accepts any hydrant. If another utterance says that the hydrant is
    behind the car, only the referent of that mention in the particle is the goal: its grounding
    satisfies that relation. ``types`` is the readings' ``mention_type``.

    Limits: nothing changes where no other utterance refers to the command's goal.

    Returns:
        The behavior, without goals at other objects of that type.
    """
    num_objects, reading = particles.object_type.shape[0], particles.reading
    by_reading = [jnp.take(field, clause, axis=1) for field in (words.goal, words.is_pinned)]
    goal, is_pinned = (jnp.take(field, reading, mode="clip") for field in by_reading)  # [P]
    is_goal = jnp.arange(types.shape[1])[:, None] == goal[None]
    mention_type = _per_particle(types, particles)  # [M, P]
    goal_type = jnp.sum(jnp.where(is_goal, mention_type, 0), axis=0)
    referent = jnp.sum(jnp.where(is_goal, particles.referent, 0), axis=0)
    is_other = jnp.concatenate(
        [
            is_type(particles.object_type, goal_type[None])
            & (jnp.arange(num_objects)[:, None] != referent[None]),
            is_type(mention_type, goal_type[None]) & ~is_goal,
        ]
    )
    is_other = is_other & (is_pinned & (goal != NONE))[None]
    is_other = jnp.pad(is_other, ((0, 1), (0, 0)))  # the robot
    return replace(behavior, goal=jnp.where(is_other[None], 0.0, behavior.goal))


def add_avoidance(
    behavior: Behavior, particles: SemanticMap, mention_type: Array, words: DiscourseInfo
) -> Behavior:
    """Add constraints to keep away from mentions that are to be avoided.

    The goal itself is exempt, whatever was said before.

    Returns:
        The behavior with constraints on observed slots; nothing changes where nothing is avoided.
    """
    num_objects = particles.object_type.shape[0]
    avoid, types = (_per_particle(v, particles)[:, None] for v in (words.avoid, mention_type))
    slots = jnp.arange(num_objects)[None, :, None]
    is_referent = (avoid == AVOID_IT) & (particles.referent[:, None] == slots)
    is_alike = (avoid == AVOID_ALL) & is_type(particles.object_type[None], types)
    is_avoided = jnp.any(is_referent | is_alike, axis=0) & particles.is_observed
    goal = jnp.sum(behavior.goal, axis=0)[:num_objects]
    prob = jnp.where(is_avoided, 1.0 - jnp.minimum(goal, 1.0), 0.0)
    prob = jnp.pad(prob, ((0, behavior.constraint.shape[1] - num_objects), (0, 0)))
    is_at = (jnp.arange(behavior.constraint.shape[0]) == AT)[:, None, None]
    constraint = jnp.maximum(behavior.constraint, jnp.where(is_at, prob[None], 0.0))
    return replace(behavior, constraint=constraint)


def forget_slots(state: Conversation, is_held: Array) -> Conversation:
    """Forget what was said of slots that hold no object any more, bool[O]; another may take it."""
    held = jnp.sum(jnp.where(is_held, 1 << np.arange(is_held.size, dtype=np.int32), 0))
    context = replace(state.context, excluded=state.context.excluded & held)
    slots = {name: getattr(state, name) for name in ("approached", "chosen")}
    slots = {n: jnp.where(select_row(is_held, slot), slot, NONE) for n, slot in slots.items()}
    return replace(state, context=context, ruled_out=state.ruled_out & held, **slots)


def exclude_slots(state: Conversation, clause: Array, slots: Array) -> Conversation:
    """Exclude observed slots, a bit mask i32[], from the groundings of the present command's goal.

    It is evidence: the utterance is re-grounded without them, and importance weights follow. So a
    hypothesis without another grounding loses its weight.
    """
    excluded = state.context.excluded
    goal = jnp.take(state.words.goal, clause, axis=1, mode="clip")
    is_goal = jnp.arange(excluded.shape[1])[None] == goal[:, None]
    context = replace(state.context, excluded=jnp.where(is_goal, excluded | slots, excluded))
    return replace(state, context=context, ruled_out=state.ruled_out | slots)
