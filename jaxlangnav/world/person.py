"""Simulated person who observes the robot, and corrects, states and answers (not in the paper).

The person knows the goal and the true positions of objects. The robot reports which object it
approaches, and the candidates where it asks. The model:

    association    an object that the robot names is the true object nearest to its position
    errors         with probability ε, sampled once per object, a judgement is inverted
    corrections    "no, the other one": the object approached, or stopped at, is judged not to be
                   the goal for more than ``delay`` cycles; at most ``num_corrections`` times
    answers        the candidate nearest to the goal; "none of them" where none is judged to be
                   it; with probability ε another candidate, uniformly
    statements     once, before the decision ``states_at``; with probability ε a false one

The person knows nothing of the belief except what the robot reports. Limits: ε = 0 never corrects a
robot that is at the goal, and always one that is not, up to the number allowed.
"""

import enum
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.limits import bounded, check_minimum
from jaxlangnav.messages import NONE
from jaxlangnav.pytree import field, pytree, strong_types
from jaxlangnav.world.state import Scenario


class Says(enum.IntEnum):
    """Speech acts of the person."""

    NOTHING = 0
    OTHER = 1  # correction: "no, the other one"
    THIS = 2  # an answer that names a candidate
    NONE_OF_THEM = 3  # an answer that names none
    TRUTH = 4  # a true statement
    FALSEHOOD = 5  # a false statement


@pytree
class PersonParams:
    """Parameters of the simulated person; traced."""

    error_rate: Array = field("probability that a judgement or statement is wrong", default=0.0)
    delay: Array = field("decision cycles before a correction", default=1)
    num_corrections: Array = field("maximum number of corrections", default=1)
    states_at: Array = field("decision before which a statement is made; NONE: none", default=NONE)
    answers: Array = field("whether questions are answered", default=True)


@pytree
class RobotView:
    """State of the robot as shown to the person; O slots of objects in its map."""

    step: Array  # i32[] decision
    target: Array  # i32[] slot that it approaches or has stopped at; NONE
    is_asking: Array  # bool[] it asks which one
    is_candidate: Array  # bool[O] candidates of the question
    x: Array  # f32[O] metres, map frame, reported positions
    y: Array  # f32[O]


@pytree
class Person:
    """State of the simulated person."""

    target: Array = field("slot that the robot approached in the last cycle", default=NONE)
    cycles: Array = field("cycles since then", default=0)
    num_corrections: Array = field("corrections made", default=0)
    num_answers: Array = field("answers given", default=0)
    will_speak: Array = field("will speak if nothing changes", default=False)


def params_of(**fields: Any) -> PersonParams:
    """Build the parameters of a person from fields of ``PersonParams``.

    Raises:
        ValueError: a rate outside [0, 1], or a negative delay or count.
    """
    params = PersonParams(**fields)
    bounded(params.error_rate, 0.0, 1.0, "error_rate", "give a share")
    check_minimum(0, delay=params.delay, num_corrections=params.num_corrections)
    return strong_types(params)


PERSONS: dict[str, dict[str, Any]] = {
    "attentive": {},
    "slow": {"delay": 5},
    "careless": {"error_rate": 0.1},
    "patient": {"num_corrections": 5},
}
"""Named persons: arguments of ``params_of``."""


def new_person() -> Person:
    """Build the initial state of a person."""
    return strong_types(Person())


def utter(
    key: Array, person: Person, view: RobotView, scenario: Scenario, *, params: PersonParams
) -> tuple[Person, Array, Array]:
    """Sample the person's speech act before the robot's next decision.

    Args:
        key: the episode's, the same in every cycle, so that errors about an object persist.
        person: state after the last cycle.
        view: state of the robot.
        scenario: ground truth.
        params: parameters of the person.

    Returns:
        The person; i32[], a ``Says``; i32[], the slot that an answer names, NONE without one.
    """
    key_judgement, key_answer, key_choice, key_statement = jax.random.split(key, 4)
    # Associate each position with the nearest true object: is that the goal?
    distances = jnp.hypot(
        view.x[:, None] - scenario.object_x[None], view.y[:, None] - scenario.object_y[None]
    )
    nearest = jnp.argmin(jnp.where(scenario.is_object[None], distances, jnp.inf), axis=1)
    is_right = nearest == scenario.goal_index
    errors = jax.random.bernoulli(key_judgement, params.error_rate, view.x.shape)
    cycles = jnp.where(view.target == person.target, person.cycles + 1, 0)
    index = jnp.clip(view.target, 0, view.x.size - 1)
    is_wrong = (view.target != NONE) & (is_right[index] == errors[index])
    may_correct = is_wrong & ~view.is_asking & (person.num_corrections < params.num_corrections)
    corrects = may_correct & (cycles >= params.delay)
    is_answer = view.is_asking & params.answers
    # Of the candidates judged to be the goal, the nearest to it; by error any other.
    goal_distance = jnp.hypot(view.x - scenario.goal[0], view.y - scenario.goal[1])
    is_goal = is_right & view.is_candidate
    closest = jnp.argmin(jnp.where(is_goal, goal_distance, jnp.inf))
    goal_slot = jnp.where(jnp.any(is_goal), closest, NONE)
    is_other = view.is_candidate & (jnp.arange(goal_distance.size) != goal_slot)
    distractor = jax.random.categorical(key_choice, jnp.where(is_other, 0.0, -jnp.inf))
    is_error = jax.random.bernoulli(key_answer, params.error_rate) & jnp.any(is_other)
    slot = jnp.where(is_error, distractor, goal_slot).astype(jnp.int32)
    is_false = jax.random.bernoulli(key_statement, params.error_rate)
    states = view.step == params.states_at
    act = jnp.where(corrects, int(Says.OTHER), int(Says.NOTHING))
    act = jnp.where(is_answer, jnp.where(slot == NONE, Says.NONE_OF_THEM, Says.THIS), act)
    act = jnp.where(states, jnp.where(is_false, Says.FALSEHOOD, Says.TRUTH), act)
    next_person = Person(
        target=view.target,
        cycles=cycles,
        num_corrections=person.num_corrections + (act == Says.OTHER),
        num_answers=person.num_answers + ((act == Says.THIS) | (act == Says.NONE_OF_THEM)),
        will_speak=may_correct | is_answer | (view.step < params.states_at),
    )
    return next_person, act.astype(jnp.int32), jnp.where(act == Says.THIS, slot, NONE)
