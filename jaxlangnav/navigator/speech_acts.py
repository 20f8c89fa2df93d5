"""Speech acts: updates of a navigator's state by utterances, as pure functions of arrays.

Shapes do not depend on the words: nothing recompiles for a new utterance, and each function may be
``vmap``-ed over the states of a batch that hears the same.
"""

import enum

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.dialogue import Merged, compose_poses, exclude_slots, new_task_fields
from jaxlangnav.language.halting import Act
from jaxlangnav.messages import NONE, Status, UtteranceContext
from jaxlangnav.navigator import NavigatorState
from jaxlangnav.planner.blocked import init_progress
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import to_map_frame
from jaxlangnav.semantic_map.gating import is_pose

CLOSENESS_STEP, MIN_CLOSENESS = 0.5, 0.25
"""Factor of "closer" on the arrival radius, and the minimum of all such factors together."""


class Effect(enum.Enum):
    """Effect of a new utterance on the task."""

    REPLACE = enum.auto()  # it replaces the task
    APPEND = enum.auto()  # it is appended to the task
    INFORM = enum.auto()  # the task is unchanged


def apply_act(state: NavigatorState, act: Act) -> NavigatorState:
    """Halt, resume or cancel in any state, without computation or compilation.

    A halted robot stands still in every step but keeps observing; resuming continues the same
    task. A cancelled robot is idle until the next command; its semantic map and statements about it
    are kept.

    Args:
        state: of one robot, or of a batch, leaves [...].
        act: halt, resume or cancel.
    """

    def full_like(value: int | bool, like: Array) -> Array:
        return jnp.asarray(np.full(like.shape, value, like.dtype))

    is_halted = full_like(act == Act.HALT, state.is_halted)
    if act != Act.CANCEL:
        return replace(state, is_halted=is_halted)
    instruction = state.instruction
    return replace(
        state,
        instruction=replace(instruction, num_clauses=full_like(0, instruction.num_clauses)),
        status=full_like(Status.IDLE, state.status),
        is_halted=is_halted,
    )


def tell(state: NavigatorState, merged: Merged, pose: Array, *, effect: Effect) -> NavigatorState:
    """Update the state by an utterance merged with the earlier ones, to be re-grounded next.

    The map is kept, and so are earlier statements about it. A new task begins at its first command,
    even if the robot was halted; a statement leaves the task unchanged, but resumes a search that
    has ended without a goal.

    Limits: an utterance without a command changes no task.

    Args:
        state: before the utterance.
        merged: the utterance merged with all earlier ones.
        pose: f32[3], dead-reckoned pose at the utterance, map frame; an invalid one is replaced by
            the last.
        effect: effect on the task.
    """
    belief, talk = state.belief, state.talk
    pose = jnp.where(is_pose(pose, belief.coverage.area), pose, belief.last_pose)
    pose = to_map_frame(belief, pose)
    heard = replace(
        state,
        belief=replace(belief, must_ground=jnp.asarray(True)),
        instruction=replace(state.instruction, readings=merged.instruction.readings),
        talk=replace(talk, words=merged.words, context=_merged_context(talk.context, merged, pose)),
    )
    if effect is Effect.REPLACE:
        after = _enqueue(heard, merged, pose, jnp.int32(0))
        # The object being approached becomes the previous goal.
        previous, talk = after.previous_goal, after.talk
        previous = jnp.where(talk.approached != NONE, talk.approached, previous)
        talk = replace(talk, **new_task_fields(talk.candidate.size))
        return _resume_search(replace(after, previous_goal=previous, talk=talk))
    if effect is Effect.APPEND:
        num_old = state.instruction.num_clauses - state.clause
        return _enqueue(heard, merged, pose, jnp.maximum(num_old, 0))
    # A statement resumes a search that has ended without a goal.
    is_open = (heard.status == Status.NOT_FOUND) | (heard.status == Status.WHICH_ONE)
    return replace(heard, status=jnp.where(is_open, int(Status.SEARCHING), heard.status))


def _merged_context(context: UtteranceContext, merged: Merged, pose: Array) -> UtteranceContext:
    """Carry over the viewer pose of earlier relations and the exclusions of earlier mentions."""
    viewer = context.viewer.reshape(-1, 3)[jnp.maximum(merged.from_relation, 0)]
    excluded = context.excluded.reshape(-1)[jnp.maximum(merged.from_mention, 0)]
    return UtteranceContext(
        viewer=jnp.where((merged.from_relation == NONE)[..., None], pose[None, None], viewer),
        excluded=jnp.where(merged.from_mention == NONE, 0, excluded),
    )


def _enqueue(state: NavigatorState, merged: Merged, pose: Array, num_old: Array) -> NavigatorState:
    """Append the new commands to the ``num_old`` remaining ones; the current command is first."""
    old, new, talk = state.instruction, merged.instruction, state.talk
    index, last = jnp.arange(talk.viewer.shape[0]), talk.viewer.shape[0] - 1
    is_old = index < num_old
    from_old, from_new = jnp.minimum(state.clause + index, last), jnp.clip(index - num_old, 0, last)

    def arrange(old: Array, new: Array) -> Array:
        return jnp.where(is_old.reshape(-1, *(1,) * (old.ndim - 1)), old[from_old], new[from_new])

    words = talk.words
    goal = jnp.where(is_old[None], words.goal[:, from_old], merged.new_goal[:, from_new])
    pinned = jnp.where(is_old[None], words.is_pinned[:, from_old], merged.new_pinned[:, from_new])
    instruction = replace(
        old,
        clauses=jax.tree.map(arrange, old.clauses, new.clauses),
        num_clauses=(num_old + new.num_clauses).astype(jnp.int32),
        metres=arrange(old.metres, new.metres),
        frame=arrange(old.frame, new.frame),
    )
    viewer = arrange(talk.viewer, compose_poses(pose, new.frame))
    talk = replace(talk, words=replace(words, goal=goal, is_pinned=pinned), viewer=viewer)
    return replace(state, instruction=instruction, clause=jnp.int32(0), talk=talk)


def _resume_search(state: NavigatorState) -> NavigatorState:
    """Set the status to searching, even if the robot was halted or had ended."""
    return replace(
        state,
        status=jnp.int32(Status.SEARCHING),
        is_halted=jnp.asarray(False),
        progress=init_progress(state.belief.last_pose),
    )


def rule_out(state: NavigatorState, slots: Array) -> NavigatorState:
    """Exclude observed slots, a bit set i32[], as goals, and resume the search."""
    talk = exclude_slots(state.talk, state.clause, slots)
    belief = replace(state.belief, must_ground=jnp.asarray(True))
    is_out = (talk.ruled_out & _slot_bit(talk.approached)) != 0
    approached = jnp.where(is_out, NONE, talk.approached)
    talk = replace(talk, approached=approached, chosen=jnp.int32(NONE))
    return _resume_search(replace(state, belief=belief, talk=talk))


def _slot_bit(slot: Array) -> Array:
    """Compute the bit of an observed slot, i32[]; no bit for ``NONE``."""
    return jnp.where(slot == NONE, 0, jnp.left_shift(1, jnp.maximum(slot, 0))).astype(jnp.int32)


def correct(state: NavigatorState) -> NavigatorState:
    """Exclude the object being approached: "no, the other one"."""
    return rule_out(state, _slot_bit(state.talk.approached))


def choose(state: NavigatorState, slot: Array) -> NavigatorState:
    """Choose an observed slot as the goal; exclude all other candidates of the question."""
    slots = jnp.arange(state.talk.candidate.shape[0])
    others = (state.talk.candidate > 0.0) & (slots != slot)
    after = rule_out(state, jnp.sum(jnp.where(others, jnp.left_shift(1, slots), 0)))
    return choose_freely(replace(after, talk=replace(after.talk, chosen=slot)))


def choose_freely(state: NavigatorState) -> NavigatorState:
    """Let the robot choose by itself, without further questions for this task."""
    return _resume_search(replace(state, talk=replace(state.talk, may_ask=jnp.asarray(False))))


def come_closer(state: NavigatorState) -> NavigatorState:
    """Halve the arrival radius, down to a quarter of the usual one, and resume."""
    closeness = jnp.maximum(state.talk.closeness * CLOSENESS_STEP, MIN_CLOSENESS)
    return _resume_search(replace(state, talk=replace(state.talk, closeness=closeness)))


def come_back(state: NavigatorState, merged: Merged) -> NavigatorState:
    """Return to where the conversation began; ``merged`` has ``come_here`` as the new task."""
    heard = tell(state, merged, state.belief.last_pose, effect=Effect.REPLACE)
    talk = heard.talk
    return replace(heard, talk=replace(talk, viewer=jnp.broadcast_to(talk.home, talk.viewer.shape)))
