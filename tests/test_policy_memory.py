"""Policies of one's own: with a memory, randomness and waypoints, or a function alone."""

import dataclasses

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from jax import Array
from situations import CHOOSE, nodes_at, seen_goal, situation
from test_planner_policy import CONFIG, under_way

from jaxlangnav import Navigator
from jaxlangnav.messages import default_sensor
from jaxlangnav.planner import qmdp
from jaxlangnav.planner.config import PlannerConfig, as_policy
from jaxlangnav.planner.graph import FRONTIER, OBJECT_NODE, VISITED
from jaxlangnav.planner.policy import Decision, Policy, Situation, Valuation, ahead, decide
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.coverage import log_miss_at


@dataclasses.dataclass(frozen=True)
class Wanderer(Policy):
    """Goes to random places not looked at, one after the other; then to what it has met thrice."""

    times: int = 3

    def init(self, belief):
        x, y, _ = belief.last_pose
        return {"x": x, "y": y, "met": jnp.zeros(belief.particles.object_type.shape[0] + 1)}

    def step(self, key, memory, situation: Situation):
        goals, area = situation.goals, situation.belief.coverage.area
        x, y = area[::2, None] + (area[1::2] - area[::2])[:, None] * jax.random.uniform(key, (2, 9))
        best = jnp.argmax(log_miss_at(situation.belief.coverage, x, y))
        way = jnp.hypot(memory["x"] - situation.robot_x, memory["y"] - situation.robot_y)
        x = jnp.where(way < 0.5, x[best], memory["x"])
        y = jnp.where(way < 0.5, y[best], memory["y"])
        met = memory["met"] + (goals.object_confirmed > 0.5)
        situation = ahead(situation, x[None], y[None])
        is_own = jnp.arange(situation.nodes.x.shape[0]) == 0
        known = jnp.zeros(is_own.shape[0] - met.shape[0])
        here = situation.robot_x, situation.robot_y
        _, mass = qmdp.mass_within(*here, goals, situation.params.reach)
        valuation = Valuation(
            goal_value=jnp.concatenate([known, 1.0 + (met >= self.times)]),
            information_value=jnp.where(is_own, 1.5, 0.0),
            stop_mass=jnp.where(jnp.max(met) >= self.times, mass, 0.0),
        )
        return {"x": x, "y": y, "met": met}, decide(situation, valuation)


def shown(robot=(0.0, 0.0), goal: float = 0.9, **kwargs) -> Situation:
    log_miss = np.full((24, 24), -3.0)
    log_miss[:, 12:] = 0.0
    belief = by_hand.with_coverage(by_hand.begin(config=CONFIG), log_miss)
    goals = seen_goal(goal, 2.0, 3.0)
    goals = jax.tree.map(lambda leaf: jnp.pad(leaf, (0, CONFIG.num_objects)), goals)
    nodes = nodes_at(goals.object_x, goals.object_y, [OBJECT_NODE] * (CONFIG.num_objects + 1))
    return situation(belief, replace(nodes, is_node=goals.is_object), goals, robot, **kwargs)


def test_it_goes_to_a_place_of_its_own_and_keeps_it_until_it_is_there() -> None:
    policy, now, drawn = Wanderer(), shown(), []
    for seed in range(5):
        memory, first = CHOOSE(policy, jax.random.key(seed), policy.init(now.belief), now)
        place = (float(first.waypoint_x), float(first.waypoint_y))
        assert int(first.kind) == FRONTIER
        assert 5.0 <= place[0] <= 10.0, "half of the area has been looked at"
        drawn.append(place)
        memory, second = CHOOSE(policy, jax.random.key(seed + 100), memory, now)
        assert (float(second.waypoint_x), float(second.waypoint_y)) == place
        memory, third = CHOOSE(policy, jax.random.key(seed + 200), memory, shown(place))
        # Met three times by now: that is worth more than another place.
        assert int(third.kind) == OBJECT_NODE
        np.testing.assert_allclose(memory["met"], [3.0, *[0.0] * CONFIG.num_objects])
        assert (float(memory["x"]), float(memory["y"])) != place
    assert len(set(drawn)) == 5


def test_lanes_of_a_batch_decide_as_they_would_alone() -> None:
    policy, robots = Wanderer(), [(0.0, 0.0), (2.5, 3.0), (7.0, -4.0)]
    situations = [shown(robot, is_find=0.0) for robot in robots]
    memories = [policy.init(one.belief) for one in situations]
    memories[1] = memories[1] | {"met": memories[1]["met"].at[0].set(2.0)}
    keys = jax.random.split(jax.random.key(5), 3)
    alone = [CHOOSE(policy, *one) for one in zip(keys, memories, situations, strict=True)]
    many = map(by_hand.stack, (memories, situations))
    together = jax.vmap(lambda *one: CHOOSE(policy, *one))(keys, *many)
    assert [bool(decision.is_stop) for _, decision in alone] == [False, True, False]
    for lane, one in enumerate(alone):
        own = jax.tree.map(lambda leaf, n=lane: leaf[n], together)
        chex.assert_trees_all_close(one, own, rtol=1e-5, atol=1e-5)


class Half:
    def step(self, key, memory, situation):
        return memory, None


@pytree
class Weighted(Policy):
    weight: Array

    def init(self, belief):
        return jnp.zeros(self.weight.shape)

    def step(self, key, memory, situation):
        value = self.weight * nearest(situation).information_value
        return memory, decide(situation, replace(nearest(situation), information_value=value))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("neerest", "policy is 'neerest', but must be one of faithful, informed"),
        (Half(), "a Half without check, init, map_params, name, portrayal"),
        (7, "a int without .* write init and step"),
        (None, "a NoneType without"),
        (Wanderer, r"is the class Wanderer, but must be an object: write Wanderer\(\.\.\.\)"),
        (Weighted(weight=jnp.zeros(1)), "a Weighted, but must be hashable.*a pytree for split_arr"),
    ],
)
def test_what_is_no_policy_is_refused(given, said: str) -> None:
    with pytest.raises(ValueError, match=said) as refused:
        PlannerConfig(policy=given)
    assert "\n" not in str(refused.value)


@dataclasses.dataclass(frozen=True)
class Answers(Policy):
    """Answers what it is told to, wrong as it may be."""

    what: str

    def init(self, belief):
        return jnp.zeros(2)

    def step(self, key, memory, situation):
        values = jnp.zeros(3 if self.what == "values" else situation.nodes.x.shape)
        valuation = Valuation(goal_value=values, information_value=values, stop_mass=jnp.zeros(()))
        decision = decide(situation, valuation)
        if self.what == "memory":
            memory = memory.astype(int)
        if self.what == "stop":
            decision = replace(decision, is_stop=jnp.asarray(True), is_not_found=jnp.asarray(True))
        return memory, valuation if self.what == "decision" else decision


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("values", r"goal_value has shape \(3,\), but must have \(4,\): one value for each"),
        ("memory", r"a memory of float32\[2\] and returns one of int32\[2\]"),
        ("decision", "decides Valuation: its step must return its memory and a Decision"),
    ],
)
def test_an_answer_that_is_none_is_refused(what: str, said: str) -> None:
    policy = as_policy(Answers(what))
    with pytest.raises(ValueError, match=said):
        policy_step(policy, shown())


def policy_step(policy: Policy, now: Situation):
    return CHOOSE(policy, jax.random.key(0), policy.init(now.belief), now)


@pytest.mark.parametrize(
    ("robot", "goal", "is_still", "stops"),
    [((0.0, 0.0), 0.9, False, False), ((2.5, 3.0), 0.9, False, True),
     ((2.5, 3.0), 0.9, True, False), ((2.5, 3.0), 0.0, False, False)],
)  # fmt: skip
def test_it_stops_only_where_a_stop_is_heard(robot, goal, is_still: bool, stops: bool) -> None:
    """A decision made without ``decide``: stop, and give up, at once and everywhere."""
    _, decision = policy_step(Answers("stop"), shown(robot, goal, is_still=is_still))
    assert bool(decision.is_stop) is stops
    assert bool(decision.is_not_found) is (not stops and not is_still)


def test_places_that_are_no_numbers_are_no_waypoints() -> None:
    x, y = jnp.array([np.nan, 1.0, 2.0, np.inf]), jnp.array([0.0, -np.inf, 1.0, 0.0])
    nodes = ahead(shown(), x, y).nodes
    np.testing.assert_array_equal(nodes.is_node[:4], [False, False, True, False])


def test_an_active_waypoint_is_gone_on_to_whatever_else_is_worth() -> None:
    now = shown()
    worth = jnp.ones(now.nodes.x.shape)
    valuation = Valuation(goal_value=worth, information_value=worth, stop_mass=jnp.float32(0.0))
    for is_active in (True, False):
        kept = replace(under_way(3.0, 1.0, FRONTIER), is_active=jnp.asarray(is_active))
        decision = jax.jit(decide)(now, valuation, kept)
        assert bool(decision.is_kept) is is_active
        assert (float(decision.waypoint_x) == 3.0) is is_active
        assert bool(decision.is_approach) is not is_active


def nearest(situation: Situation) -> Valuation:
    nothing = jnp.zeros_like(situation.distance)
    return Valuation(
        goal_value=nothing, information_value=-situation.distance, stop_mass=jnp.float32(0.0)
    )


def doubtful(situation: Situation) -> Valuation:
    """Take the mass of what is unseen for that of stopping: data, so that one program does."""
    return dataclasses.replace(nearest(situation), stop_mass=situation.goals.hypothesis_mass[0])


def choose(own, *, goal: float = 0.5, unseen: float = 0.0) -> Decision:
    """At (0, 0), all explored; the way to (4, 0) passes what half of the maps forbid."""
    belief = by_hand.with_objects(by_hand.begin(config=CONFIG), [(by_hand.CONE, 5.0, 0.0)])
    nodes = nodes_at([1.0, 4.0, 2.0], [0.0, 0.0, 3.0], [VISITED] * 3)
    goals = seen_goal(goal, hypothesis=(unseen, 0.0, 0.0))
    now = situation(belief, nodes, goals, is_news=True, forbidden=0.5)
    return policy_step(as_policy(own), now)[1]


def test_the_most_valuable_waypoint_is_taken_and_costs_count() -> None:
    chosen = choose(nearest)
    assert (float(chosen.waypoint_x), float(chosen.waypoint_y)) == (1.0, 0.0)
    np.testing.assert_allclose(chosen.cost[1:] > 0.5, [False, True, False])
    expected = np.array([-1.0, -4.0, -np.sqrt(13.0)]) - np.asarray(chosen.cost[1:])
    np.testing.assert_allclose(chosen.value[1:], expected, atol=1e-5)
    assert not bool(chosen.is_stop)
    chosen = choose(lambda now: dataclasses.replace(nearest(now), goal_value=3.0 * now.distance))
    # (4, 0) is worth more, but for the way past the cone
    assert (float(chosen.waypoint_x), float(chosen.waypoint_y)) == (2.0, 3.0)


@pytest.mark.parametrize(
    ("mass", "goal", "stops"),
    [(0.69, 0.5, False), (0.71, 0.5, True), (1.0, 0.0, False), (np.inf, 0.5, False),
     (np.nan, 0.5, False)],
)  # fmt: skip
def test_it_stops_from_tau_on_and_only_at_a_goal(mass: float, goal: float, stops: bool) -> None:
    assert bool(choose(doubtful, goal=goal, unseen=mass).is_stop) is stops


def nothing(situation: Situation) -> Valuation:
    valuation = nearest(situation)
    return dataclasses.replace(valuation, goal_value=jnp.nan * situation.distance)


def test_values_that_are_no_numbers_leave_it_where_it_is() -> None:
    chosen = choose(nothing)
    assert (float(chosen.waypoint_x), float(chosen.waypoint_y)) == (0.0, 0.0)
    assert not bool(chosen.is_stop)


@pytest.mark.slow
def test_a_policy_may_hold_arrays_which_are_traced() -> None:
    near, far = (Navigator.pretrained(Weighted(weight=jnp.float32(sign))) for sign in (1, -1))
    assert near.config == far.config
    state = near.start("go to the hydrant")
    look = near.observation((0.0, 0.0, 0.0), [("hydrant", 2.0, 0.5), ("hydrant", 2.5, -2.0)])
    ways = [one.step(jax.random.key(0), state, look)[1].waypoint for one in (near, far)]
    assert float(jnp.linalg.norm(ways[0])) < float(jnp.linalg.norm(ways[1]))


@pytest.mark.slow
def test_a_policy_is_shown_the_sensor_of_the_observation() -> None:
    def detecting(situation: Situation) -> Valuation:
        probability = situation.sensor.detection_probability
        return dataclasses.replace(nearest(situation), stop_mass=probability)

    robot = Navigator.pretrained(detecting)
    look = robot.observation((0.0, 0.0, 0.0), (), default_sensor(detection_probability=0.5))
    _, _, info = robot.step(jax.random.key(0), robot.start("go to the hydrant"), look)
    assert float(info.choice.stop_mass) == 0.5
