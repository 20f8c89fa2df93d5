"""A policy of one's own decides like the shipped ones: same machinery, same worlds."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from situations import CHOOSE, nodes_at, seen_goal, situation
from test_planner_policy import CONFIG

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.experiments.policies import navigator_config, run_policy
from jaxlangnav.experiments.tasks import SENTENCES, cell, ground_sentences, make_tasks
from jaxlangnav.planner import qmdp
from jaxlangnav.planner.config import PlannerConfig, as_policy
from jaxlangnav.planner.faithful import no_waypoint
from jaxlangnav.planner.graph import VISITED
from jaxlangnav.planner.policy import Decision, Policy, Situation, Valuation


def twin(situation: Situation) -> Valuation:
    """The paper's policy (eq. 11, 12), written as somebody's own."""
    nodes, goals, params = situation.nodes, situation.goals, situation.params
    everything, _ = qmdp.mass_within(situation.robot_x, situation.robot_y, goals, params.reach)
    value = qmdp.values(nodes.x, nodes.y, goals, params.discount)
    return Valuation(
        goal_value=value, information_value=jnp.zeros_like(value), stop_mass=everything
    )


def nearest(situation: Situation) -> Valuation:
    nothing = jnp.zeros_like(situation.distance)
    return Valuation(
        goal_value=nothing, information_value=-situation.distance, stop_mass=jnp.float32(0.0)
    )


def far_away(situation: Situation) -> Valuation:
    valuation = nearest(situation)
    return dataclasses.replace(valuation, goal_value=3.0 * situation.distance)


def choose(own, *, stop_mass: float | None = None, goal: float = 0.5) -> Decision:
    """At (0, 0), all explored; the way to (4, 0) passes what half of the maps forbid."""

    def decide(shown: Situation) -> Valuation:
        valuation = own(shown)
        if stop_mass is None:
            return valuation
        return dataclasses.replace(valuation, stop_mass=jnp.float32(stop_mass))

    return CHOOSE(as_policy(decide), jax.random.key(0), no_waypoint(), show(goal))[1]


def show(goal: float) -> Situation:
    belief = by_hand.with_objects(by_hand.begin(config=CONFIG), [(by_hand.CONE, 5.0, 0.0)])
    nodes = nodes_at([1.0, 4.0, 2.0], [0.0, 0.0, 3.0], [VISITED] * 3)
    return situation(belief, nodes, seen_goal(goal), is_news=True, forbidden=0.5)


def test_the_most_valuable_waypoint_is_taken_and_costs_count() -> None:
    chosen = choose(nearest)
    assert (float(chosen.waypoint_x), float(chosen.waypoint_y)) == (1.0, 0.0)
    np.testing.assert_allclose(chosen.cost[1:] > 0.5, [False, True, False])
    expected = np.array([-1.0, -4.0, -np.sqrt(13.0)]) - np.asarray(chosen.cost[1:])
    np.testing.assert_allclose(chosen.value[1:], expected, atol=1e-5)
    assert not bool(chosen.is_stop)
    chosen = choose(far_away)  # (4, 0) is worth more, but for the way past the cone
    assert (float(chosen.waypoint_x), float(chosen.waypoint_y)) == (2.0, 3.0)


@pytest.mark.parametrize(("mass", "stops"), [(0.69, False), (0.71, True)])
def test_it_stops_from_tau_on(mass: float, stops: bool) -> None:
    assert bool(choose(nearest, stop_mass=mass).is_stop) is stops


@pytest.mark.parametrize(("mass", "goal"), [(1.0, 0.0), (np.inf, 0.5), (np.nan, 0.5)])
def test_whatever_it_says_there_is_no_stop_without_a_goal(mass: float, goal: float) -> None:
    assert not bool(choose(nearest, stop_mass=mass, goal=goal).is_stop)


@dataclasses.dataclass(frozen=True)
class Hasty(Policy):
    """Makes its decision without ``decide``: stops wherever it is."""

    def init(self, belief):
        return no_waypoint()

    def step(self, key, memory, situation):
        memory, decision = as_policy(nearest).step(key, memory, situation)
        return memory, dataclasses.replace(decision, is_stop=jnp.asarray(True))


@pytest.mark.parametrize(("goal", "stops"), [(0.0, False), (0.5, True)])
def test_a_decision_of_its_own_stops_only_where_a_stop_is_heard(goal: float, stops: bool) -> None:
    _, decision = CHOOSE(Hasty(), jax.random.key(0), no_waypoint(), show(goal))
    assert bool(decision.is_stop) is stops


def nothing(situation: Situation) -> Valuation:
    valuation = nearest(situation)
    return dataclasses.replace(valuation, goal_value=jnp.nan * situation.distance)


def test_values_that_are_no_numbers_leave_it_where_it_is() -> None:
    chosen = choose(nothing)
    assert (float(chosen.waypoint_x), float(chosen.waypoint_y)) == (0.0, 0.0)
    assert not bool(chosen.is_stop)


def test_it_carries_its_function_s_name() -> None:
    assert PlannerConfig(policy=nearest).chosen.name == "nearest"
    assert navigator_config(nearest) == navigator_config(nearest)
    assert navigator_config(nearest) != navigator_config(far_away)
    with pytest.raises(ValueError, match="must be one of"):
        PlannerConfig(policy="neerest")


@pytest.mark.slow
def test_the_paper_s_policy_as_one_s_own_behaves_like_the_shipped_one() -> None:
    """Same worlds, same keys, episode by episode."""
    instructions = ground_sentences([SENTENCES["behind"]]).instructions
    tasks = make_tasks(cell("1H1C", "behind", 0, 3.0, 96, 5))

    def run(one) -> EpisodeResult:
        return run_policy(one, tasks, instructions)

    own, shipped = run(twin), run("faithful")
    # Two compiled programs may round differently; an episode or two then takes another way.
    is_same = np.abs(np.asarray(own.distance) - np.asarray(shipped.distance)) < 1e-3
    assert np.mean(is_same) > 0.9
    assert np.mean(np.asarray(own.is_success) == np.asarray(shipped.is_success)) > 0.9
