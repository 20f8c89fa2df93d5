"""When to ask which one is meant, in place of a guess (ours; the paper knows no questions).

Success is worth 1 and a question costs c, both in probability. With p_s the probability that the
goal is the observed thing s, and u that it is none seen yet, the robot

    guesses     max_s p_s
    asks        Σ_s p_s − c       the answer tells which of those seen it is, and no other
    looks on    if u > c          as much may still be gained by looking as a question costs

So it asks where what it would lose by guessing, Σ_s p_s − max_s p_s, is more than c, once looking
can gain no more than that; c = ∞, the default, never asks.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner.goals import Goals
from jaxlangnav.pytree import pytree


@pytree
class Doubt:
    """What there is to be asked, or to be looked at before that."""

    looks_on: Array  # bool[] what has not been seen may still be the goal: nothing is accepted yet
    asks: Array  # bool[] several things may be meant, and a question is worth it
    gain: Array  # f32[] probability of success that an answer would add to a guess


def doubt_of(goals: Goals, question_cost: Array, has_looked: Array | bool, may_ask: Array) -> Doubt:
    """Weigh a question against a guess.

    Limits: at c = ∞ there is neither a question nor any reason to look on; with one candidate there
    is nothing to be asked.

    Args:
        goals: weighed goals.
        question_cost: f32[], c.
        has_looked: bool[], nothing is left to be found.
        may_ask: bool[], the robot has not been told to choose by itself.

    Returns:
        What to do about the doubt.
    """
    is_seen = goals.is_object[:-1]
    mass = jnp.where(is_seen, goals.object_mass[:-1], 0.0)
    unseen = jnp.sum(goals.hypothesis_mass)
    seen, best = jnp.sum(mass), jnp.max(mass, initial=0.0)
    total = jnp.maximum(seen + unseen + goals.object_mass[-1], 1e-9)
    gain = (seen - best) / total
    is_allowed = may_ask & jnp.isfinite(question_cost)
    looks_on = is_allowed & (unseen > question_cost * total) & ~jnp.asarray(has_looked)
    return Doubt(
        looks_on=looks_on & (seen > 0.0),
        asks=is_allowed & ~looks_on & (gain > question_cost),
        gain=gain,
    )
