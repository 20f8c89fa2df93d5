"""Batched episodes with a simulated speaker who corrects, answers and makes statements.

The person (``world.person``) observes the robot's reported state and speaks before its decisions,
through ``speech_acts``; statements are grounded once for all lanes.
"""

import functools
import operator

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav import episode
from jaxlangnav.dialogue import DiscourseInfo, Merged, discourse_of, merge_utterance
from jaxlangnav.episode import EpisodeResult, EpisodeState, Task
from jaxlangnav.episode.lanes import EpisodeProgram
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.grounding.instruction import Instruction, pad_instruction
from jaxlangnav.grounding.readings import Capacity
from jaxlangnav.messages import NONE, Status
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams, NavigatorState, speech_acts
from jaxlangnav.navigator.speech_acts import Effect, tell
from jaxlangnav.pytree import pytree, replace, strong_types
from jaxlangnav.world.person import Person, PersonParams, RobotView, Says, new_person, utter
from jaxlangnav.world.simulator import SUCCESS_RADIUS, goal_distance

_KEY_INDEX = 31  # folded twice into an episode's key for the person; steps fold it only once
QUESTION_COST = 0.1
"""Default cost of a question, in probability of success, where questions are allowed."""
MIN_CANDIDATE_MASS = 0.01  # goal probability from which on an object is a candidate


@pytree
class Sentence:
    """The initial command, and statements that may follow during the episode."""

    instruction: Instruction  # leaves [1, …], with room for more
    words: DiscourseInfo  # roles of its mentions
    true_statement: Merged  # the command, with the statement merged in
    false_statement: Merged


@pytree
class DialogueResult:
    """Result of an episode with a simulated speaker."""

    result: EpisodeResult
    num_questions: Array  # i32[] answered questions
    num_corrections: Array  # i32[] corrections by the person
    walked: Array  # f32[] metres travelled after the first correction; NaN without one
    shortest: Array  # f32[] straight-line metres from there to where the robot may stop
    has_seen_goal: Array  # bool[] the map had the goal by then


@pytree
class _State:
    episode_state: EpisodeState
    person: Person
    is_done: Array  # bool[] the task has ended, and the person says nothing more
    corrected_at: Array  # f32[] metres travelled at the first correction; NaN before it
    shortest: Array  # f32[] straight-line metres from there to where it may stop
    has_seen_goal: Array  # bool[] the map had the goal by then


@pytree
class DialogueParams:
    """Parameters of navigator and person, and the sentences."""

    navigator: NavigatorParams
    person: PersonParams
    sentence: Sentence


def ground_dialogue(text: str, true_text: str, false_text: str) -> Sentence:
    """Ground a command, alone and merged with a true and with a false statement."""
    model = load_shipped()
    command = understand(text, model)
    padded = pad_instruction(command.instruction, Capacity())
    words = discourse_of(padded, command.spoken)

    def merge(statement: str) -> Merged:
        understood = understand(statement, model)
        reading = understood.instruction, understood.spoken
        return merge_utterance(padded.readings, words, *reading, is_new_task=False, is_asked=False)

    return Sentence(
        instruction=jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], padded),
        words=words,
        true_statement=merge(true_text),
        false_statement=merge(false_text),
    )


def _apply(state: NavigatorState, act: Array, slot: Array, sentence: Sentence) -> NavigatorState:
    pose, candidates = state.belief.last_pose, state.talk.candidate > 0.0
    bitmask = jnp.left_shift(1, jnp.arange(candidates.shape[0]))
    next_states = {
        Says.OTHER: speech_acts.correct(state),
        Says.THIS: speech_acts.choose(state, slot),
        Says.NONE_OF_THEM: speech_acts.rule_out(state, jnp.sum(jnp.where(candidates, bitmask, 0))),
        Says.TRUTH: tell(state, sentence.true_statement, pose, effect=Effect.INFORM),
        Says.FALSEHOOD: tell(state, sentence.false_statement, pose, effect=Effect.INFORM),
    }
    for option, updated in next_states.items():
        state = jax.tree.map(functools.partial(jnp.where, act == option), updated, state)
    return state


def _begin(task: Task, sentence: Sentence, *, config: NavigatorConfig) -> _State:
    episode_state = episode.begin(task, sentence.instruction, config=config)
    navigator = episode_state.navigator
    talk = replace(navigator.talk, words=sentence.words)
    nan, false = jnp.float32(jnp.nan), jnp.asarray(False)
    state = _State(
        episode_state=replace(episode_state, navigator=replace(navigator, talk=talk)),
        person=new_person(),
        is_done=false,
        corrected_at=nan,
        shortest=nan,
        has_seen_goal=false,
    )
    return strong_types(state)


def _advance(
    state: _State, *, params: DialogueParams, config: NavigatorConfig
) -> tuple[_State, None]:
    """Apply the person's speech act, run one decision cycle, and check whether both are done."""
    before, scenario = state.episode_state, state.episode_state.task.scenario
    person, act, slot = speak(before, state.person, params=params.person)
    is_first_correction = (act == Says.OTHER) & jnp.isnan(state.corrected_at)
    shortest = jnp.maximum(goal_distance(before.world, scenario) - SUCCESS_RADIUS, 0.0)
    navigator = before.navigator
    # Whether the map has an object at the true goal.
    view, weight = _robot_view(navigator, before.steps), jnp.exp(navigator.belief.log_weight)[None]
    is_object = jnp.sum(weight * (navigator.belief.particles.object_type != NONE), axis=1) > 0.5
    distance = jnp.hypot(view.x - scenario.goal[0], view.y - scenario.goal[1])
    has_seen_goal = jnp.any(is_object & (distance <= SUCCESS_RADIUS))
    updated = replace(before, navigator=_apply(navigator, act, slot, params.sentence))
    after, *_ = episode.advance(updated, params=params.navigator, config=config)
    is_waiting = speak(after, person, params=params.person)[0].will_speak
    next_state = _State(
        episode_state=after,
        person=person,
        is_done=after.navigator.is_done & ~is_waiting,
        corrected_at=jnp.where(is_first_correction, before.world.distance, state.corrected_at),
        shortest=jnp.where(is_first_correction, shortest, state.shortest),
        has_seen_goal=jnp.where(is_first_correction, has_seen_goal, state.has_seen_goal),
    )
    return strong_types(next_state), None


def _finish(state: _State) -> DialogueResult:
    return DialogueResult(
        result=episode.finish(state.episode_state),
        num_questions=state.person.num_answers,
        num_corrections=state.person.num_corrections,
        walked=state.episode_state.world.distance - state.corrected_at,
        shortest=state.shortest,
        has_seen_goal=state.has_seen_goal,
    )


DIALOGUE_PROGRAM = EpisodeProgram(
    begin=_begin,
    advance=_advance,
    finish=_finish,
    episode_state=operator.attrgetter("episode_state"),
    is_done=operator.attrgetter("is_done"),
)
"""Program for ``run_tasks`` with ``DialogueParams``, and a ``Sentence`` for instructions; its
results are of ``DialogueResult``."""


def speak(
    episode_state: EpisodeState, person: Person, *, params: PersonParams
) -> tuple[Person, Array, Array]:
    """Sample the person's speech act before a decision: person, ``Says`` and slot, i32[] each."""
    key = jax.random.fold_in(jax.random.fold_in(episode_state.task.key, _KEY_INDEX), _KEY_INDEX)
    view = _robot_view(episode_state.navigator, episode_state.steps)
    return utter(key, person, view, episode_state.task.scenario, params=params)


def _robot_view(state: NavigatorState, step: Array) -> RobotView:
    """Build the person's view of the robot's state before decision ``step``, i32[]."""
    # A robot that ended without a goal approaches nothing.
    particles = state.belief.particles
    num_slots = particles.object_type.shape[0]
    weight = jnp.exp(state.belief.log_weight)[None] * (particles.object_type != NONE)
    total = jnp.maximum(jnp.sum(weight, axis=1), 1e-9)

    def mean(values: Array) -> Array:
        return jnp.sum(weight * values[:num_slots], axis=1) / total

    is_approaching = (state.status == Status.APPROACHING) | (state.status == Status.ARRIVED)
    return RobotView(
        step=step,
        target=jnp.where(is_approaching, state.talk.approached, NONE),
        is_asking=state.status == Status.WHICH_ONE,
        is_candidate=state.talk.candidate >= MIN_CANDIDATE_MASS,
        x=mean(particles.mean_x),
        y=mean(particles.mean_y),
    )
