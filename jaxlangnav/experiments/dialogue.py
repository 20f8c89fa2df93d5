"""Batched episodes with a simulated person who corrects, answers and states.

The person (``world.person``) observes the robot's reported state and speaks before its decisions,
through ``speech_acts``; statements are grounded once for all lanes.
"""

import functools
import operator

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav import episode
from jaxlangnav.dialogue import Merged, Words, first_words, join
from jaxlangnav.episode import EpisodeResult, EpisodeState, Task
from jaxlangnav.episode.lanes import EpisodeProgram
from jaxlangnav.experiments.monte_carlo import OnProgress, run_tasks
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.grounding.readings import Capacity, widen
from jaxlangnav.messages import NONE, Status
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams, NavigatorState, speech_acts
from jaxlangnav.navigator.speech_acts import How
from jaxlangnav.pytree import pytree, replace, strong
from jaxlangnav.world.person import Person, PersonParams, RobotView, Says, say, unspoken
from jaxlangnav.world.simulator import SUCCESS_RADIUS, goal_distance

_KEY_INDEX = 31
"""Folded twice into an episode's key for the person; steps fold it only once."""
LEAST_SHARE = 0.01  # goal probability below which an object is no candidate


@pytree
class Sentence:
    """The initial command, and statements that may follow during the episode."""

    instruction: Instruction  # leaves [1, …], with room for more
    words: Words
    truth: Merged
    falsehood: Merged


@pytree
class Exchange:
    """Result of an episode with a person."""

    result: EpisodeResult
    num_questions: Array  # i32[] answered
    num_corrections: Array  # i32[]
    walked: Array  # f32[] metres from the first correction to the end; NaN without one
    straight: Array  # f32[] metres straight from there to where the robot may stop
    is_known: Array  # bool[] the robot had seen the goal by then


@pytree
class _Lane:
    progress: EpisodeState
    person: Person
    is_done: Array  # bool[] the robot is at an end, and the person has nothing more to say
    said_at: Array  # f32[] metres walked at the first correction; NaN before it
    straight: Array  # f32[] metres straight from there to where it may stop
    is_known: Array  # bool[] it had seen the goal by then


@pytree
class _Params:
    """Parameters of navigator and person, and the sentences."""

    navigator: NavigatorParams
    person: PersonParams
    sentence: Sentence


def sentence_with(text: str, truth: str, falsehood: str) -> Sentence:
    """Ground a command, and merge it with a statement that is true in its worlds and a false."""
    model = load_shipped()
    command = understand(text, model)
    given = replace(command.instruction, readings=widen(command.instruction.readings, Capacity()))
    words = first_words(given, command.spoken)

    def merged(statement: str) -> Merged:
        statement_read = understand(statement, model)
        args = statement_read.instruction, statement_read.spoken
        return join(given.readings, words, *args, is_new_task=False, is_asked=False)

    return Sentence(
        instruction=jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], given),
        words=words,
        truth=merged(truth),
        falsehood=merged(falsehood),
    )


def _hear(state: NavigatorState, spoken: Array, slot: Array, sentence: Sentence) -> NavigatorState:
    pose, candidates = state.belief.last_pose, state.talk.candidate > 0.0
    bits = jnp.left_shift(1, jnp.arange(candidates.shape[0]))
    outcomes = {
        Says.OTHER: speech_acts.correct(state),
        Says.THIS: speech_acts.choose(state, slot),
        Says.NONE_OF_THEM: speech_acts.rule_out(state, jnp.sum(jnp.where(candidates, bits, 0))),
        Says.TRUTH: speech_acts.tell(state, sentence.truth, pose, how=How.INFORM),
        Says.FALSEHOOD: speech_acts.tell(state, sentence.falsehood, pose, how=How.INFORM),
    }
    for act, updated in outcomes.items():
        state = jax.tree.map(functools.partial(jnp.where, spoken == act), updated, state)
    return state


def _begin(task: Task, sentence: Sentence, *, config: NavigatorConfig) -> _Lane:
    progress = episode.begin(task, sentence.instruction, config=config)
    navigator = progress.navigator
    talk = replace(navigator.talk, words=sentence.words)
    nan, false = jnp.float32(jnp.nan), jnp.asarray(False)
    lane = _Lane(
        progress=replace(progress, navigator=replace(navigator, talk=talk)),
        person=unspoken(),
        is_done=false,
        said_at=nan,
        straight=nan,
        is_known=false,
    )
    return strong(lane)


def _advance(lane: _Lane, *, params: _Params, config: NavigatorConfig) -> tuple[_Lane, None]:
    """Let the person speak, run one decision cycle, and determine whether both are done."""
    progress, scenario = lane.progress, lane.progress.task.scenario
    person, spoken, slot = speak(progress, lane.person, params=params.person)
    is_first = (spoken == Says.OTHER) & jnp.isnan(lane.said_at)
    left = jnp.maximum(goal_distance(progress.world, scenario) - SUCCESS_RADIUS, 0.0)
    state = progress.navigator
    # Whether the map has an object where the goal truly is.
    view, weight = _robot_view(state, progress.steps), jnp.exp(state.belief.log_weight)[None]
    is_object = jnp.sum(weight * (state.belief.particles.object_type != NONE), axis=1) > 0.5
    distance = jnp.hypot(view.x - scenario.goal[0], view.y - scenario.goal[1])
    has_seen_goal = jnp.any(is_object & (distance <= SUCCESS_RADIUS))
    progress = replace(progress, navigator=_hear(state, spoken, slot, params.sentence))
    after, _ = episode.advance(progress, params=params.navigator, config=config)
    is_waiting = speak(after, person, params=params.person)[0].intends
    lane = _Lane(
        progress=after,
        person=person,
        is_done=after.navigator.is_done & ~is_waiting,
        said_at=jnp.where(is_first, progress.world.distance, lane.said_at),
        straight=jnp.where(is_first, left, lane.straight),
        is_known=jnp.where(is_first, has_seen_goal, lane.is_known),
    )
    return strong(lane), None


def _finish(lane: _Lane) -> Exchange:
    return Exchange(
        result=episode.finish(lane.progress),
        num_questions=lane.person.num_answers,
        num_corrections=lane.person.num_corrections,
        walked=lane.progress.world.distance - lane.said_at,
        straight=lane.straight,
        is_known=lane.is_known,
    )


_PROGRAM = EpisodeProgram(
    begin=_begin,
    advance=_advance,
    finish=_finish,
    progress=operator.attrgetter("progress"),
    is_done=operator.attrgetter("is_done"),
)


def converse(
    tasks: Task,
    sentence: Sentence,
    person: PersonParams,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    on_progress: OnProgress | None = None,
) -> Exchange:
    """Run episodes with a person; returns NumPy arrays, leaves [E, …], in the tasks' order."""
    all_params = _Params(navigator=params, person=person, sentence=sentence)
    return run_tasks(
        tasks, sentence, params=all_params, config=config, on_progress=on_progress, program=_PROGRAM
    )


def speak(
    progress: EpisodeState, person: Person, *, params: PersonParams
) -> tuple[Person, Array, Array]:
    """Sample the person's speech before a decision: person, ``Says`` and slot, i32[] each."""
    key = jax.random.fold_in(jax.random.fold_in(progress.task.key, _KEY_INDEX), _KEY_INDEX)
    view = _robot_view(progress.navigator, progress.steps)
    return say(key, person, view, progress.task.scenario, params=params)


def _robot_view(state: NavigatorState, step: Array) -> RobotView:
    """Build the robot's state as shown to the person before decision ``step``, i32[]."""
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
        aimed=jnp.where(is_approaching, state.talk.approached, NONE),
        is_asking=state.status == Status.WHICH_ONE,
        is_candidate=state.talk.candidate >= LEAST_SHARE,
        x=mean(particles.mean_x),
        y=mean(particles.mean_y),
    )
