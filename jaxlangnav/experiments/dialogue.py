"""Episodes in which a simulated person speaks, many at once: what a conversation is worth.

The person (``world.person``) is shown what the robot says of itself and speaks before its
decisions, through ``speech_acts``; the words of a statement are joined once for all lanes.
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

_SPEECH = 31
"""Folded twice into an episode's key for the person; its steps fold and split it otherwise."""
LEAST_SHARE = 0.01  # goal probability below which a thing is no candidate of a question


@pytree
class Sentence:
    """What is said at first, and may be stated under way."""

    instruction: Instruction  # leaves [1, …], with room for more
    words: Words
    truth: Merged
    falsehood: Merged


@pytree
class Exchange:
    """How an episode with a person ended."""

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
class _Numbers:
    """What the decisions of a conversation are taken by."""

    navigator: NavigatorParams
    person: PersonParams
    sentence: Sentence


def sentence_with(text: str, truth: str, falsehood: str) -> Sentence:
    """Ground a command, joined to a statement that holds in its worlds and one that does not."""
    model = load_shipped()
    first = understand(text, model)
    told = replace(first.instruction, readings=widen(first.instruction.readings, Capacity()))
    words = first_words(told, first.spoken)

    def joined(statement: str) -> Merged:
        said = understand(statement, model)
        new = said.instruction, said.spoken
        return join(told.readings, words, *new, is_new_task=False, is_asked=False)

    return Sentence(
        instruction=jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], told),
        words=words,
        truth=joined(truth),
        falsehood=joined(falsehood),
    )


def _hear(state: NavigatorState, said: Array, slot: Array, sentence: Sentence) -> NavigatorState:
    pose, candidates = state.belief.last_pose, state.talk.candidate > 0.0
    bits = jnp.left_shift(1, jnp.arange(candidates.shape[0]))
    outcomes = {
        Says.OTHER: speech_acts.correct(state),
        Says.THIS: speech_acts.choose(state, slot),
        Says.NONE_OF_THEM: speech_acts.rule_out(state, jnp.sum(jnp.where(candidates, bits, 0))),
        Says.TRUTH: speech_acts.tell(state, sentence.truth, pose, how=How.INFORM),
        Says.FALSEHOOD: speech_acts.tell(state, sentence.falsehood, pose, how=How.INFORM),
    }
    for kind, after in outcomes.items():
        state = jax.tree.map(functools.partial(jnp.where, said == kind), after, state)
    return state


def _begin(task: Task, sentence: Sentence, *, config: NavigatorConfig) -> _Lane:
    progress = episode.begin(task, sentence.instruction, config=config)
    navigator = progress.navigator
    talk = replace(navigator.talk, words=sentence.words)
    nothing, no = jnp.float32(jnp.nan), jnp.asarray(False)
    lane = _Lane(
        progress=replace(progress, navigator=replace(navigator, talk=talk)),
        person=unspoken(),
        is_done=no,
        said_at=nothing,
        straight=nothing,
        is_known=no,
    )
    return strong(lane)


def _advance(lane: _Lane, *, params: _Numbers, config: NavigatorConfig) -> tuple[_Lane, None]:
    """Let the person speak, run one cycle, and tell whether all is done and said."""
    progress, scenario = lane.progress, lane.progress.task.scenario
    person, said, slot = speak(progress, lane.person, params=params.person)
    is_first = (said == Says.OTHER) & jnp.isnan(lane.said_at)
    left = jnp.maximum(goal_distance(progress.world, scenario) - SUCCESS_RADIUS, 0.0)
    at = progress.navigator
    # Whether the robot takes a thing for being where the goal truly is.
    seen, weight = _seen_of(at, progress.steps), jnp.exp(at.belief.log_weight)[None]
    is_held = jnp.sum(weight * (at.belief.particles.object_type != NONE), axis=1) > 0.5
    away = jnp.hypot(seen.x - scenario.goal[0], seen.y - scenario.goal[1])
    is_known = jnp.any(is_held & (away <= SUCCESS_RADIUS))
    heard = replace(progress, navigator=_hear(progress.navigator, said, slot, params.sentence))
    after, _ = episode.advance(heard, params=params.navigator, config=config)
    is_waiting = speak(after, person, params=params.person)[0].intends
    lane = _Lane(
        progress=after,
        person=person,
        is_done=after.navigator.is_done & ~is_waiting,
        said_at=jnp.where(is_first, progress.world.distance, lane.said_at),
        straight=jnp.where(is_first, left, lane.straight),
        is_known=jnp.where(is_first, is_known, lane.is_known),
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


_TALK = EpisodeProgram(
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
    """Run episodes in which a person speaks; NumPy arrays, leaves [E, …], in the tasks' order."""
    numbers = _Numbers(navigator=params, person=person, sentence=sentence)
    return run_tasks(
        tasks, sentence, params=numbers, config=config, on_progress=on_progress, program=_TALK
    )


def speak(
    progress: EpisodeState, person: Person, *, params: PersonParams
) -> tuple[Person, Array, Array]:
    """Let a person say something before a decision: person, ``Says`` and slot, i32[] each."""
    key = jax.random.fold_in(jax.random.fold_in(progress.task.key, _SPEECH), _SPEECH)
    seen = _seen_of(progress.navigator, progress.steps)
    return say(key, person, seen, progress.task.scenario, params=params)


def _seen_of(state: NavigatorState, step: Array) -> RobotView:
    """Gather what the robot says of itself before a decision, i32[], to be shown to a person."""
    # A robot at an end without a goal goes up to nothing, whatever it went up to before.
    particles = state.belief.particles
    num_slots = particles.object_type.shape[0]
    weight = jnp.exp(state.belief.log_weight)[None] * (particles.object_type != NONE)
    total = jnp.maximum(jnp.sum(weight, axis=1), 1e-9)

    def mean(values: Array) -> Array:
        return jnp.sum(weight * values[:num_slots], axis=1) / total

    is_at = (state.status == Status.APPROACHING) | (state.status == Status.ARRIVED)
    return RobotView(
        step=step,
        aimed=jnp.where(is_at, state.talk.approached, NONE),
        is_asking=state.status == Status.WHICH_ONE,
        is_candidate=state.talk.candidate >= LEAST_SHARE,
        x=mean(particles.mean_x),
        y=mean(particles.mean_y),
    )
