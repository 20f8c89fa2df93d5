"""When to ask, look on or guess: the rule against the exact value on worlds that are enumerated."""

import itertools
from functools import cache
from math import comb

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from readings import stack
from situations import goals_with

from jaxlangnav.navigator import default_params
from jaxlangnav.planner.goals import Goals
from jaxlangnav.planner.questions import AskDecision, decide_question
from jaxlangnav.pytree import replace

SEEN = [(1.0,), (1.0, 1.0), (1.0, 1.0, 1.0), (0.03, 1.0), (0.1, 1.0), (0.3, 1.0), (1.0, 3.0)]
"""How well the things seen fit; one that has not been seen would fit as 1 does."""
STEPS = (1.0, 4.0)
LOOK_COSTS = (0.0005, 0.002, 0.008)
QUESTION_COSTS = (0.02, 0.05, 0.1, 0.2, 0.4)
PLANNER = default_params().planner


class TinyWorld:
    """Places in a row, each holding a thing with one probability, all enumerated.

    The goal is drawn in proportion to how well things fit. The robot may guess, ask (it is named
    if it has been seen, or all that has is ruled out), or look at the next place.
    """

    def __init__(self, share: float, step: float, look_cost: float, question_cost: float) -> None:
        """Set the probability that a place holds a thing, metres between places, and the costs."""
        self.share, self.walk, self.cost = share, step * look_cost, question_cost
        self.worth = cache(self.worth)

    def others(self, out: float, seen: tuple[float, ...], left: int) -> np.ndarray:
        """Compute how many of the places left hold a thing, given that what is out is no goal."""
        count, fit = np.arange(left + 1), sum(seen)
        drawn = [comb(left, n) * self.share**n * (1.0 - self.share) ** (left - n) for n in count]
        chance = np.array(drawn) * (fit + count) / np.maximum(out + fit + count, 1e-12)
        return chance / max(chance.sum(), 1e-300)

    def unseen(self, seen: tuple[float, ...], left: int) -> float:
        """Compute the probability that the goal has not been seen."""
        count = np.arange(left + 1)
        return float(self.others(0.0, seen, left) @ (count / (sum(seen) + count)))

    def worth(self, out: float, seen: tuple[float, ...], left: int) -> dict[str, float]:
        """Compute the exact value of each act: by induction over places left."""
        count, chance, fit = np.arange(left + 1), self.others(out, seen, left), sum(seen)
        if not seen and not left:
            return {"guess": 0.0}
        among = float(chance @ (fit / np.maximum(fit + count, 1e-12)))
        values = {"guess": among * max(seen, default=0.0) / max(fit, 1e-12)}
        if seen:
            on = self.best(out + fit, (), left) if among < 1.0 - 1e-12 else 0.0
            values["ask"] = among + (1.0 - among) * on - self.cost
        if left:
            found = float(chance @ count) / left
            more = self.best(out, tuple(sorted((*seen, 1.0))), left - 1)
            values["look"] = found * more + (1.0 - found) * self.best(out, seen, left - 1)
            values["look"] -= self.walk
        return values

    def best(self, out: float, seen: tuple[float, ...], left: int) -> float:
        """Compute the value of the best act."""
        return max(self.worth(out, seen, left).values())


def goals_of(seen: tuple[float, ...], unseen: float) -> Goals:
    """Write a state as the goals that a robot would weigh, three slots and one hypothesis."""
    share = np.zeros(4, np.float32)
    share[: len(seen)] = (1.0 - unseen) * np.array(seen) / sum(seen)
    goals = goals_with(np.zeros(4), np.zeros(4), share, hypothesis=(unseen, 0.0, 0.0))
    return replace(goals, is_object=jnp.asarray(share > 0.0))


def decide(states: list[tuple[Goals, float, float, float]]) -> AskDecision:
    """Weigh many states at once: goals, metres left, cost of a metre and of a question."""
    goals = stack([state[0] for state in states])
    numbers = np.array([state[1:] for state in states], np.float32)

    @jax.jit
    @jax.vmap
    def weigh(goals: Goals, numbers: jax.Array) -> AskDecision:
        metres, look, question = numbers
        params = replace(PLANNER, look_cost=look, question_cost=question)
        free = jnp.asarray(True)
        return decide_question(goals, metres, params=params, no_search=False, may_ask=free)

    return jax.device_get(weigh(goals, numbers))


def compare(shares: tuple[float, ...], most: float) -> tuple[np.ndarray, np.ndarray]:
    """Hold the rule against the exact value: whether both or neither ask, and what it loses."""
    states, exact = [], []
    numbers = itertools.product(shares, STEPS, LOOK_COSTS, QUESTION_COSTS)
    for (share, step, look, question), seen in itertools.product(numbers, SEEN):
        world = TinyWorld(share, step, look, question)
        for left in range(8):
            if share * left <= most + 1e-9:
                goals = goals_of(seen, world.unseen(seen, left))
                states.append((goals, 0.5 * step * (left + 1) * (left > 0), look, question))
                exact.append(world.worth(0.0, seen, left))
    doubt = decide(states)
    agrees, lost = [], []
    for values, asks, looks in zip(exact, doubt.asks, doubt.searches_on, strict=True):
        best = max(values.values())
        agrees.append(bool(asks) == (values["ask"] >= best - 1e-9))
        chosen = "ask" if asks else "look" if looks else "guess"
        lost.append(best - values[chosen])
    return np.array(agrees), np.array(lost)


def test_the_robot_asks_where_the_exact_value_says_so() -> None:
    """As many others as the tables' belief expects, 0.3 of them, or fewer."""
    agrees, lost = compare((0.02, 0.04, 0.06, 0.1), 0.3)
    assert agrees.size > 5_000
    assert agrees.mean() >= 0.98
    assert lost.mean() < 2e-4


def test_where_many_others_are_expected_little_is_lost() -> None:
    agrees, lost = compare((0.2,), 1.4)
    assert agrees.mean() >= 0.9
    assert lost.mean() < 5e-4
    assert lost.max() < 0.05


def doubt(seen, unseen, *, metres=10.0, question=0.1, **changes) -> AskDecision:
    goals = replace(goals_of(seen, unseen), **changes.pop("goals", {}))
    params = replace(PLANNER, question_cost=jnp.float32(question), look_cost=jnp.float32(0.002))
    given = {"no_search": False, "may_ask": jnp.asarray(True)} | changes
    return decide_question(goals, jnp.float32(metres), params=params, **given)


ONE, TWO, FORBIDDEN = (1.0,), (1.0, 1.0), jnp.asarray(False)
UNPLACED = {"object_confirmed": jnp.zeros(4)}


@pytest.mark.parametrize(
    ("seen", "unseen", "given", "act"),
    [
        # However much is unseen: "neither of them" sends the robot on as well later as now.
        *((TWO, unseen, {}, "ask") for unseen in (0.0, 0.1, 0.2)),
        (ONE, 0.2, {}, "look"),
        (ONE, 0.2, {"metres": 100.0}, "ask or guess"),
        (ONE, 0.005, {}, "ask or guess"),
        (ONE, 0.2, {"no_search": True}, "ask or guess"),
        # Of one it asks where looking costs more than a question.
        (ONE, 0.2, {"metres": 60.0, "question": 0.05}, "ask"),
        (ONE, 0.2, {"metres": 5.0, "question": 0.05}, "look or guess"),
        # Who may not ask, or has seen nothing, has no doubt.
        *((seen, 0.2, {"question": np.inf}, "guess") for seen in (ONE, TWO)),
        *((seen, 0.2, {"may_ask": FORBIDDEN}, "guess") for seen in (ONE, TWO)),
        *((seen, 1.0, {}, "guess") for seen in (ONE, TWO)),
        # What they are placed against is looked for first if that is cheaper.
        (TWO, 0.0, {"goals": UNPLACED}, "look"),
        (TWO, 0.0, {"goals": UNPLACED, "metres": 80.0}, "ask"),
        (TWO, 0.0, {"goals": UNPLACED, "no_search": True}, "ask"),
    ],
)
def test_acts_by_hand(seen: tuple, unseen: float, given: dict, act: str) -> None:
    found = doubt(seen, unseen, **given)
    assert ("ask" if found.asks else "look" if found.searches_on else "guess") in act
    assert not bool(found.asks & found.searches_on)
