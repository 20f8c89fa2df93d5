"""A person who watches the robot, simulated: corrects, states and answers (truth side; ours).

The person has the scenario's goal in mind, sees where things truly stand, and is told by the robot
what it goes up to, and what it takes for possible where it asks. The law:

    takes for      a thing that the robot names is the true object nearest to the place it names
    errs           with probability ε, drawn once for each thing, a judgement is turned round
    corrects       "no, the other one": what is gone up to, or was stopped at, is judged not to be
                   the goal for more than ``delay`` cycles; at most ``num_corrections`` times
    answers        names the candidate nearest to the goal; "none of them" where none is taken for
                   it; with probability ε another candidate, as likely each
    states         once, before the decision ``states_at``; with probability ε what is false

Nothing here knows what the robot believes beyond what it says. Limits: ε = 0 never corrects a robot
that is at the goal, and always one that is not, up to the number allowed.
"""

import enum
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.limits import refuse_below
from jaxlangnav.messages import NONE
from jaxlangnav.pytree import field, pytree, strong
from jaxlangnav.world.state import Scenario


class Says(enum.IntEnum):
    """What the person says."""

    NOTHING = 0
    OTHER = 1  # "no, the other one"
    THIS = 2  # an answer that names a candidate
    NONE_OF_THEM = 3  # an answer that names none
    TRUTH = 4  # the statement, as it is
    FALSEHOOD = 5  # the statement, turned round


@pytree
class PersonParams:
    """Numbers of the law; traced."""

    error_rate: Array = field("probability that a judgement or statement is wrong", default=0.0)
    delay: Array = field("decision cycles until something wrong is spoken of", default=1)
    num_corrections: Array = field("corrections that are made at most", default=1)
    states_at: Array = field("decision before which a statement is made; NONE: none", default=NONE)
    answers: Array = field("whether questions are answered", default=True)


@pytree
class RobotView:
    """What the person is shown of the robot; O slots of things that it speaks of."""

    step: Array  # i32[] decision
    aimed: Array  # i32[] slot that it goes up to or has stopped at; NONE
    is_asking: Array  # bool[] it has asked which one
    is_candidate: Array  # bool[O] what the question is about
    x: Array  # f32[O] metres, map frame, where it says that they are
    y: Array  # f32[O]


@pytree
class Person:
    """What the person remembers."""

    aimed: Array = field("slot that the robot went up to when last seen", default=NONE)
    since: Array = field("cycles for which it has", default=0)
    num_corrections: Array = field("made", default=0)
    num_answers: Array = field("given", default=0)
    intends: Array = field("will speak, if things stay as they are", default=False)


def params_of(**numbers: Any) -> PersonParams:
    """Build the numbers of a person, of fields of ``PersonParams``.

    Raises:
        ValueError: a rate that is none, or a negative delay or number.
    """
    params = PersonParams(**numbers)
    if not 0.0 <= params.error_rate <= 1.0:
        raise ValueError(f"error_rate is {params.error_rate:g}, but must be between 0 and 1")
    refuse_below(0, delay=params.delay, num_corrections=params.num_corrections)
    return strong(params)


PERSONS: dict[str, dict[str, Any]] = {
    "attentive": {},
    "slow": {"delay": 5},
    "careless": {"error_rate": 0.1},
    "patient": {"num_corrections": 5},
}
"""Persons by their names: how their numbers differ from those of ``params_of``."""


def unspoken() -> Person:
    """Build a person who has seen and said nothing yet."""
    return strong(Person())


def say(
    key: Array, person: Person, seen: RobotView, scenario: Scenario, *, params: PersonParams
) -> tuple[Person, Array, Array]:
    """Decide what to say before the robot's next decision.

    Args:
        key: the episode's, the same in every cycle: a person who errs in a thing keeps to it.
        person: after the last cycle.
        seen: of the robot.
        scenario: the truth.
        params: the law's numbers.

    Returns:
        The person; i32[], a ``Says``; i32[], the slot that an answer names, NONE without one.
    """
    of_things, of_answer, of_choice, of_words = jax.random.split(key, 4)
    # Each place is taken for the true object nearest to it: is that the goal?
    to_objects = jnp.hypot(
        seen.x[:, None] - scenario.object_x[None], seen.y[:, None] - scenario.object_y[None]
    )
    nearest = jnp.argmin(jnp.where(scenario.is_object[None], to_objects, jnp.inf), axis=1)
    is_right = nearest == scenario.goal_index
    errs = jax.random.bernoulli(of_things, params.error_rate, seen.x.shape)
    is_same = seen.aimed == person.aimed
    since = jnp.where(is_same, person.since + 1, 0)
    at = jnp.clip(seen.aimed, 0, seen.x.size - 1)
    is_wrong = (seen.aimed != NONE) & (is_right[at] == errs[at])
    may_correct = is_wrong & ~seen.is_asking & (person.num_corrections < params.num_corrections)
    corrects = may_correct & (since >= params.delay)
    is_answer = seen.is_asking & params.answers
    # A candidate that is taken for the goal, the nearest to it; by error any other.
    away = jnp.hypot(seen.x - scenario.goal[0], seen.y - scenario.goal[1])
    is_meant = is_right & seen.is_candidate
    best = jnp.argmin(jnp.where(is_meant, away, jnp.inf))
    meant = jnp.where(jnp.any(is_meant), best, NONE)
    is_other = seen.is_candidate & (jnp.arange(away.size) != meant)
    other = jax.random.categorical(of_choice, jnp.where(is_other, 0.0, -jnp.inf))
    is_slip = jax.random.bernoulli(of_answer, params.error_rate) & jnp.any(is_other)
    slot = jnp.where(is_slip, other, meant).astype(jnp.int32)
    is_false = jax.random.bernoulli(of_words, params.error_rate)
    states = seen.step == params.states_at
    said = jnp.where(corrects, int(Says.OTHER), int(Says.NOTHING))
    said = jnp.where(is_answer, jnp.where(slot == NONE, Says.NONE_OF_THEM, Says.THIS), said)
    said = jnp.where(states, jnp.where(is_false, Says.FALSEHOOD, Says.TRUTH), said)
    after = Person(
        aimed=seen.aimed,
        since=since,
        num_corrections=person.num_corrections + (said == Says.OTHER),
        num_answers=person.num_answers + ((said == Says.THIS) | (said == Says.NONE_OF_THEM)),
        intends=may_correct | is_answer | (seen.step < params.states_at),
    )
    return after, said.astype(jnp.int32), jnp.where(said == Says.THIS, slot, NONE)
