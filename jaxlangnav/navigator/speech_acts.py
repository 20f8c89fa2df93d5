"""Speech acts: what an utterance does to a navigator's state, as pure functions of arrays.

None of it compiles with the words: each may be ``vmap``-ed over the states of a batch that hears
the same, and ``jit`` sees no new shapes.
"""

import enum

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.dialogue import Merged, excluding, seen_from
from jaxlangnav.language.halting import Act
from jaxlangnav.messages import NONE, Status, UtteranceContext
from jaxlangnav.navigator import NavigatorState
from jaxlangnav.planner.blocked import start_progress
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import to_map_frame
from jaxlangnav.semantic_map.gating import is_pose

CLOSENESS_STEP, MIN_CLOSENESS = 0.5, 0.25
"""Share of the reach by which "closer" shortens it, and the least of the usual one that is left."""


class Effect(enum.Enum):
    """Effect of a new utterance on the task."""

    REPLACE = enum.auto()  # it is the task from now on
    APPEND = enum.auto()  # it is done after what is left of the task
    INFORM = enum.auto()  # the task stays


def apply_act(state: NavigatorState, act: Act) -> NavigatorState:
    """Halt, go on, or drop the task, whatever the robot is at; nothing is computed or compiled.

    Halted it stands still, however often it is stepped, and keeps looking about; to go on is to
    take up the same task where it was. To cancel leaves it idle until another command is heard;
    what the sentence said of the map stays.

    Args:
        state: of any robot, or of a batch of them, leaves [...].
        act: what it was told.
    """

    def everywhere(value: int | bool, like: Array) -> Array:
        return jnp.asarray(np.full(like.shape, value, like.dtype))

    is_halted = everywhere(act == Act.HALT, state.is_halted)
    if act != Act.CANCEL:
        return replace(state, is_halted=is_halted)
    instruction = state.instruction
    return replace(
        state,
        instruction=replace(instruction, num_clauses=everywhere(0, instruction.num_clauses)),
        status=everywhere(Status.IDLE, state.status),
        is_halted=is_halted,
    )


def tell(state: NavigatorState, joined: Merged, pose: Array, *, how: Effect) -> NavigatorState:
    """Take in what has been joined with what was said before: the words are grounded anew.

    The map is kept, and what earlier utterances said of it. Of a new task the robot begins at the
    first command, halted or not; a statement leaves it at what it is doing, but takes up again a
    search that has ended without a goal.

    Limits: what has no command changes no task, however it is told.

    Args:
        state: of a robot under way or at its goal, which has heard what was joined.
        joined: all that has been said.
        pose: f32[3], where the robot is as it hears it, by dead reckoning, map frame; one that
            cannot be is taken to be where it last was.
        how: what the new utterance does to the task.
    """
    belief, talk = state.belief, state.talk
    pose = jnp.where(is_pose(pose, belief.coverage.area), pose, belief.last_pose)
    pose = to_map_frame(belief, pose)
    heard = replace(
        state,
        belief=replace(belief, must_ground=jnp.asarray(True)),
        instruction=replace(state.instruction, readings=joined.instruction.readings),
        talk=replace(talk, words=joined.words, context=_merged_context(talk.context, joined, pose)),
    )
    if how is Effect.REPLACE:
        begun = _arranged(heard, joined, pose, jnp.int32(0))
        # What was being approached is then what was gone up to before the task.
        former, talk = begun.previous_goal, begun.talk
        former = jnp.where(talk.approached != NONE, talk.approached, former)
        talk = replace(
            talk,
            approached=jnp.int32(NONE),
            ruled_out=jnp.int32(0),
            chosen=jnp.int32(NONE),
            candidate=jnp.zeros_like(talk.candidate),
            closeness=jnp.float32(1.0),
            may_ask=jnp.asarray(True),
        )
        return _under_way(replace(begun, previous_goal=former, talk=talk))
    if how is Effect.APPEND:
        left = state.instruction.num_clauses - state.clause
        return _arranged(heard, joined, pose, jnp.maximum(left, 0))
    # There is news of the map: take up again a search that has ended without a goal.
    lacks = (heard.status == Status.NOT_FOUND) | (heard.status == Status.WHICH_ONE)
    return replace(heard, status=jnp.where(lacks, int(Status.SEARCHING), heard.status))


def _merged_context(context: UtteranceContext, joined: Merged, pose: Array) -> UtteranceContext:
    """Carry over from where relations were said, and what mentions are not."""
    source = jnp.maximum(joined.from_relation, 0)
    viewer = context.viewer.reshape(-1, 3)[source]
    excluded = context.excluded.reshape(-1)[jnp.maximum(joined.from_mention, 0)]
    return UtteranceContext(
        viewer=jnp.where((joined.from_relation == NONE)[..., None], pose[None, None], viewer),
        excluded=jnp.where(joined.from_mention == NONE, 0, excluded),
    )


def _arranged(state: NavigatorState, joined: Merged, pose: Array, left: Array) -> NavigatorState:
    """Put the new commands behind ``left`` of the old ones; the present one comes first."""
    old, told, talk = state.instruction, joined.instruction, state.talk
    place, last = jnp.arange(talk.viewer.shape[0]), talk.viewer.shape[0] - 1
    is_old = place < left
    kept, new = jnp.minimum(state.clause + place, last), jnp.clip(place - left, 0, last)

    def arrange(old: Array, fresh: Array) -> Array:
        return jnp.where(is_old.reshape(-1, *(1,) * (old.ndim - 1)), old[kept], fresh[new])

    words = talk.words
    goal = jnp.where(is_old[None], words.goal[:, kept], joined.new_goal[:, new])
    is_pinned = jnp.where(is_old[None], words.is_pinned[:, kept], joined.new_pinned[:, new])
    instruction = replace(
        old,
        program=jax.tree.map(arrange, old.program, told.program),
        num_clauses=(left + told.num_clauses).astype(jnp.int32),
        metres=arrange(old.metres, told.metres),
        frame=arrange(old.frame, told.frame),
    )
    viewer = arrange(talk.viewer, seen_from(pose, told.frame))
    talk = replace(talk, words=replace(words, goal=goal, is_pinned=is_pinned), viewer=viewer)
    return replace(state, instruction=instruction, clause=jnp.int32(0), talk=talk)


def _under_way(state: NavigatorState) -> NavigatorState:
    """Set out, halted or at an end as the robot may be."""
    return replace(
        state,
        status=jnp.int32(Status.SEARCHING),
        is_halted=jnp.asarray(False),
        way=start_progress(state.belief.last_pose),
    )


def rule_out(state: NavigatorState, slots: Array) -> NavigatorState:
    """Take observed slots, i32[] of a bit each, not to be what is meant, and go on."""
    talk = excluding(state.talk, state.clause, slots)
    belief = replace(state.belief, must_ground=jnp.asarray(True))
    is_out = (talk.ruled_out & _slot_bit(talk.approached)) != 0
    approached = jnp.where(is_out, NONE, talk.approached)
    talk = replace(talk, approached=approached, chosen=jnp.int32(NONE))
    return _under_way(replace(state, belief=belief, talk=talk))


def _slot_bit(slot: Array) -> Array:
    """Compute the bit of an observed slot, i32[]; no bit for ``NONE``."""
    return jnp.where(slot == NONE, 0, jnp.left_shift(1, jnp.maximum(slot, 0))).astype(jnp.int32)


def correct(state: NavigatorState) -> NavigatorState:
    """Exclude the object being approached: "no, the other one"."""
    return rule_out(state, _slot_bit(state.talk.approached))


def choose(state: NavigatorState, slot: Array) -> NavigatorState:
    """Take an observed slot to be what is meant: all other candidates of the question are not."""
    slots = jnp.arange(state.talk.candidate.shape[0])
    others = (state.talk.candidate > 0.0) & (slots != slot)
    after = rule_out(state, jnp.sum(jnp.where(others, jnp.left_shift(1, slots), 0)))
    return choose_freely(replace(after, talk=replace(after.talk, chosen=slot)))


def choose_freely(state: NavigatorState) -> NavigatorState:
    """Let the robot choose by itself, without further questions for this task."""
    return _under_way(replace(state, talk=replace(state.talk, may_ask=jnp.asarray(False))))


def come_closer(state: NavigatorState) -> NavigatorState:
    """Go on to half the distance at which the robot would have arrived; a quarter is the least."""
    closeness = jnp.maximum(state.talk.closeness * CLOSENESS_STEP, MIN_CLOSENESS)
    return _under_way(replace(state, talk=replace(state.talk, closeness=closeness)))


def come_back(state: NavigatorState, joined: Merged) -> NavigatorState:
    """Return to where the conversation began; ``joined`` has ``returning`` as the new task."""
    heard = tell(state, joined, state.belief.last_pose, how=Effect.REPLACE)
    talk = heard.talk
    return replace(heard, talk=replace(talk, viewer=jnp.broadcast_to(talk.home, talk.viewer.shape)))
