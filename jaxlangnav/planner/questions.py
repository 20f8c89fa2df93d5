"""When to ask which object is meant: the value of asking against looking on and guessing (ours).

Success is worth 1; a question costs c of it, a metre of looking on λ. With p_s the probability that
the goal is the observed thing s, p the largest of them, u that the goal has not been seen, and L
metres until what is missing is found, if it is there,

    guess       p
    ask         1 − c − u (λ L + m)                   "none of them" sends it on
    look on     1 − (1 − e) h(n, 0) − e h(n + 1, b) − λ L (2 − e)

Here n = Σ_s p_s / p is the number of candidates, each as good as the best; a = u / p the number of
others to be expected, taken for Poisson, of which there are some with probability e = 1 − exp(−a);
b = a / 2 of them are left when the first is found, on the average; the way on is L where there is
one and 2 L where there is none. What is lost at n candidates with b others unseen, and at the first
thing found after "none of them", is the least of

    h(n, b) = min(1 − 1 / (n + b),  c + λ L b / (n + b))      a guess, a question
    m       = min(1 − 1 / (1 + b),  c b + 2 λ L)              a guess, looking on to the end

The robot does what is worth most. On small worlds it asks where the exact value says so
(``tests/test_planner_asking.py``). c = ∞, the default, never asks.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner.goals import Goals
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.pytree import pytree

_OPEN = 0.5  # share of the candidates' fit that hangs on things unseen, which may then tell which


@pytree
class AskDecision:
    """What there is to be asked, or to be looked at before that."""

    looks_on: Array  # bool[] what has not been seen may still be the goal: nothing is accepted yet
    asks: Array  # bool[] several things may be meant, and a question is worth it


def _values(mass: Array, walk: Array, cost: Array) -> tuple[Array, Array, Array]:
    """Compute what guessing, asking and looking on are worth, f32[] each, costs taken off.

    ``mass`` f32[3] is the probability that the goal has been seen, that it is the likeliest of the
    things seen, and that it has not been seen; ``walk`` is λ L and ``cost`` c.
    """
    seen, best, unseen = mass
    number, others = seen / jnp.maximum(best, 1e-9), unseen / jnp.maximum(best, 1e-9)
    number = jnp.maximum(number, 1.0)
    rest, exists = 0.5 * others, -jnp.expm1(-others)
    after_none = jnp.minimum(rest / (1.0 + rest), cost * rest + 2.0 * walk)

    def lost(number: Array, rest: Array) -> Array:
        guess = 1.0 - 1.0 / (number + rest)
        return jnp.minimum(guess, cost + walk * rest / (number + rest))

    alone = (1.0 - exists) * lost(number, jnp.zeros_like(rest))
    ask = 1.0 - cost - unseen * jnp.minimum(walk + after_none, 1.0)
    look = 1.0 - alone - exists * lost(number + 1.0, rest) - walk * (2.0 - exists)
    return best, ask, look


def value_of_asking(
    goals: Goals, metres: Array, *, params: PlannerParams, has_looked: Array | bool, may_ask: Array
) -> AskDecision:
    """Weigh a question against a guess, and against looking on.

    Where the candidates are meant in relation to something not seen, it is looked for first if that
    is cheaper than a question: it may tell which.

    Limits: at c = ∞ there is neither a question nor any reason to look on; with one candidate and
    nothing unseen there is nothing to be asked.

    Args:
        goals: weighed goals.
        metres: f32[], L, the way until what is missing is found, if it is there.
        params: c and λ.
        has_looked: bool[], nothing is left to be found, or it has been decided that enough has been
            looked for: decided anew at every step, it would go to and fro between two places.
        may_ask: bool[], the robot has not been told to choose by itself.
    """
    cost, walk = params.question_cost, params.look_cost * metres
    is_seen = goals.is_object[:-1]
    seen = jnp.where(is_seen, goals.object_mass[:-1], 0.0)
    fits = jnp.where(is_seen, goals.object_accepted[:-1], 0.0)
    confirmed = jnp.where(is_seen, goals.object_confirmed[:-1], 0.0)
    best = jnp.max(seen, initial=0.0)
    unseen = jnp.where(has_looked, 0.0, jnp.sum(goals.hypothesis_mass))
    total = jnp.maximum(jnp.sum(seen) + unseen, 1e-9)
    guess, ask, look = _values(jnp.stack([jnp.sum(seen), best, unseen]) / total, walk, cost)
    is_open = jnp.sum(confirmed) < _OPEN * jnp.sum(fits)
    waits = is_open & (walk < cost) & ~jnp.asarray(has_looked)
    is_allowed = may_ask & jnp.isfinite(cost) & (best > 0.0)
    is_worth = ask > guess
    asks = is_worth & (ask >= look) & ~waits
    looks_on = ((unseen > 0.0) & (look > guess) & ~asks) | (is_worth & waits)
    return AskDecision(looks_on=is_allowed & looks_on, asks=is_allowed & asks)
