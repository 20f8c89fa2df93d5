"""Value of a clarification question, versus guessing and searching on (ours).

Success has value 1; a question costs c, a metre of search λ. With p_s the probability that the
goal is the observed object s, p the largest of them, u that the goal has not been observed, and L
metres until a missing object is found, if it exists,

    guess       p
    ask         1 − c − u (λ L + m)                   "none of them" sends it on
    search on   1 − (1 − e) h(n, 0) − e h(n + 1, b) − λ L (2 − e)

Here n = Σ_s p_s / p is the effective number of candidates; a = u / p the expected number of unseen
ones, assumed Poisson, so that some exist with probability e = 1 − exp(−a); b = a / 2 of them are
left on average when the first is found; the search takes L metres if there is one and 2 L if there
is none. The loss with n candidates and b others unseen, and at the first object found after "none
of them", is the minimum of

    h(n, b) = min(1 − 1 / (n + b),  c + λ L b / (n + b))      a guess, a question
    m       = min(1 − 1 / (1 + b),  c b + 2 λ L)              a guess, searching to the end

The robot takes the option of highest value. On small worlds it asks where the exact value function
does (``tests/test_planner_asking.py``). c = ∞, the default, never asks.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner.goals import Goals
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.pytree import pytree

_MIN_CONFIRMED = 0.5  # fraction of the candidates' mass whose landmarks have been observed


@pytree
class AskDecision:
    """Decision to ask which object is meant, or to search on first."""

    searches_on: Array  # bool[] the goal may be unseen: no observed object is accepted yet
    asks: Array  # bool[] several objects may be meant, and a question is worth its cost


def _values(mass: Array, walk: Array, cost: Array) -> tuple[Array, Array, Array]:
    """Compute the values of guessing, asking and searching on, f32[] each, net of costs.

    ``mass`` f32[3] is the probability that the goal has been observed, that it is the likeliest
    observed object, and that it is unseen; ``walk`` is λ L and ``cost`` c.
    """
    observed, best, unseen = mass
    count, others = observed / jnp.maximum(best, 1e-9), unseen / jnp.maximum(best, 1e-9)
    count = jnp.maximum(count, 1.0)
    rest, exists = 0.5 * others, -jnp.expm1(-others)
    after_none = jnp.minimum(rest / (1.0 + rest), cost * rest + 2.0 * walk)

    def loss(n: Array, b: Array) -> Array:
        guess = 1.0 - 1.0 / (n + b)
        return jnp.minimum(guess, cost + walk * b / (n + b))

    loss_if_none = (1.0 - exists) * loss(count, jnp.zeros_like(rest))
    ask = 1.0 - cost - unseen * jnp.minimum(walk + after_none, 1.0)
    search = 1.0 - loss_if_none - exists * loss(count + 1.0, rest) - walk * (2.0 - exists)
    return best, ask, search


def decide_question(
    goals: Goals, metres: Array, *, params: PlannerParams, no_search: Array | bool, may_ask: Array
) -> AskDecision:
    """Decide between asking, guessing and searching on by their values.

    If the candidates have unseen landmarks, these are searched for first if that is cheaper than a
    question: they may resolve the ambiguity.

    Limits: at c = ∞ there is neither a question nor any reason to search on; with one candidate
    and no unseen mass there is nothing to ask.

    Args:
        goals: goal distribution.
        metres: f32[], L, expected search distance to a missing object, if it exists.
        params: c and λ.
        no_search: bool[], the search is exhausted, or was ended earlier: decided anew at every
            step, the robot could oscillate between two waypoints.
        may_ask: bool[], the user has not asked the robot to choose by itself.
    """
    cost, walk = params.question_cost, params.look_cost * metres
    is_object = goals.is_object[:-1]
    mass = jnp.where(is_object, goals.object_mass[:-1], 0.0)
    accepted = jnp.where(is_object, goals.object_accepted[:-1], 0.0)
    confirmed = jnp.where(is_object, goals.object_confirmed[:-1], 0.0)
    best = jnp.max(mass, initial=0.0)
    unseen = jnp.where(no_search, 0.0, jnp.sum(goals.hypothesis_mass))
    total = jnp.maximum(jnp.sum(mass) + unseen, 1e-9)
    guess, ask, search = _values(jnp.stack([jnp.sum(mass), best, unseen]) / total, walk, cost)
    is_unresolved = jnp.sum(confirmed) < _MIN_CONFIRMED * jnp.sum(accepted)
    resolves_first = is_unresolved & (walk < cost) & ~jnp.asarray(no_search)
    is_allowed = may_ask & jnp.isfinite(cost) & (best > 0.0)
    is_worth = ask > guess
    asks = is_worth & (ask >= search) & ~resolves_first
    searches_on = ((unseen > 0.0) & (search > guess) & ~asks) | (is_worth & resolves_first)
    return AskDecision(searches_on=is_allowed & searches_on, asks=is_allowed & asks)
