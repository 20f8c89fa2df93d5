"""Choosing waypoints by hand: search map, commitment, stop (eq. 9-10)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from situations import CHOOSE, RANGE, goals_with, nodes_at, seen_goal, situation

from jaxlangnav.messages import NONE, RIGHT, ROBOT
from jaxlangnav.planner import policy, tours
from jaxlangnav.planner.config import SHIPPED
from jaxlangnav.planner.goals import Goals
from jaxlangnav.planner.graph import FRONTIER, OBJECT_NODE, VISITED, Nodes
from jaxlangnav.planner.informed import decide_tour
from jaxlangnav.planner.latency import Tour
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.planner.policy import Decision, Waypoint
from jaxlangnav.planner.search import CELLS, LATTICE, grid, search_map, visibility
from jaxlangnav.planner.termination import Presence, presence, prob_exists
from jaxlangnav.pytree import replace
from jaxlangnav.relations.density import SIDE_CONCENTRATION
from jaxlangnav.semantic_map.params import MapConfig, default_map_params
from jaxlangnav.semantic_map.proposal.relation_query import Utterances, current_context

P, SLOTS, KEY = 16, 3, jax.random.key(0)
CONFIG = MapConfig(num_particles=P, num_objects=SLOTS, num_cells=24)
NOT = jnp.float32(0.0)
SEARCH_MAP = jax.jit(lambda belief, heard=None: search_map(belief, NOT, NOT, heard))
DECIDE_ON = jax.jit(decide_tour)
MISLEADING = replace(default_map_params(), misleading=jnp.float32(0.2))


def believe(hypotheses, *, is_hung: bool, log_miss=None):
    """Build a belief whose first mention is hypothesised at f64[P, 2] in each particle."""
    belief = by_hand.begin(config=CONFIG)
    x, y = (jnp.asarray(np.asarray(hypotheses)[:, axis], jnp.float32) for axis in (0, 1))
    particles = belief.particles
    particles = replace(
        particles,
        is_mentioned=particles.is_mentioned.at[0].set(True),
        hypothesis_x=particles.hypothesis_x.at[0].set(x),
        hypothesis_y=particles.hypothesis_y.at[0].set(y),
        root=particles.root.at[0].set(0 if is_hung else NONE),
    )
    belief = replace(belief, particles=particles)
    return belief if log_miss is None else by_hand.with_coverage(belief, log_miss)


def random_places() -> np.ndarray:
    return np.random.default_rng(0).uniform([0.0, -5.0], [10.0, 5.0], (P, 2))


def hear(words, belief) -> Utterances:
    context = current_context(words, belief.viewer)
    return Utterances(readings=words, context=context, params=MISLEADING)


def test_hung_hypotheses_count_where_they_are_and_outside_the_area_nowhere() -> None:
    places = random_places()
    places[:4] = [[-0.3, 0.0], [10.2, 0.0], [5.0, 5.3], [5.0, -5.2]]
    search = SEARCH_MAP(believe(places, is_hung=True))
    expected = np.zeros((CELLS, CELLS))
    for x, y in places[4:]:
        expected[int((y + 5.0) / 10.0 * CELLS), int(x / 10.0 * CELLS)] += 1.0 / P
    np.testing.assert_allclose(np.asarray(search.mass).reshape(CELLS, CELLS), expected, atol=1e-5)


def test_free_hypotheses_are_where_words_place_them_against_the_robot() -> None:
    """Two readings, "on your right" in a quarter of the particles, and each word may mislead."""
    log_miss = -np.random.default_rng(1).exponential(1.0, (24, 24))
    belief = believe(random_places(), is_hung=False, log_miss=log_miss)
    reading = jnp.asarray(np.arange(P) % 4 == 0, jnp.int32)
    belief = replace(belief, particles=replace(belief.particles, reading=reading))
    words = by_hand.readings([[0], [0, ROBOT]], [[(0, NONE, NONE, False)], [(0, RIGHT, 1, False)]])
    found = SEARCH_MAP(belief, hear(words, belief))
    blocks = np.exp(log_miss).reshape(CELLS, 2, CELLS, 2).sum((1, 3)).reshape(-1)
    steps = (np.arange(CELLS) + 0.5) / CELLS * 10.0
    x, y = np.tile(steps, CELLS), np.repeat(steps - 5.0, CELLS)
    toward = -y / np.hypot(x, y)
    right = 0.8 * np.exp(SIDE_CONCENTRATION * toward) / np.i0(SIDE_CONCENTRATION) + 0.2
    expected = 0.75 * blocks / blocks.sum() + 0.25 * blocks * right / (blocks * right).sum()
    np.testing.assert_allclose(found.mass, expected, rtol=5e-3)
    # Of a rank it may be before all that are observed.
    ranked = replace(words, rank=jnp.asarray(words.relation == RIGHT, jnp.int32))
    first = SEARCH_MAP(belief, hear(ranked, belief))
    assert (float(found.ordered), float(first.ordered)) == (0.0, pytest.approx(0.25))


def test_visibility_is_a_disc() -> None:
    belief = believe(random_places(), is_hung=False)
    search = SEARCH_MAP(belief)
    x, y = grid(belief.coverage.area, LATTICE)
    sees = np.asarray(visibility(x, y, search, jnp.float32(3.0), belief.coverage.area))
    distance = np.hypot(
        np.subtract.outer(np.asarray(x), np.asarray(search.x)),
        np.subtract.outer(np.asarray(y), np.asarray(search.y)),
    )
    assert (sees[distance < 3.0 - 0.45] == 1.0).all()
    assert (sees[distance > 3.0 + 0.45] == 0.0).all()


# The faithful policy on one frontier, one visited place and one seen object, all set by hand.

CELL = 10.0 / 24
FRONT = (9.5 * CELL, 19.5 * CELL - 5.0)  # the only cell that nobody has looked at, near (4, 3)


def nodes() -> Nodes:
    """What every policy is shown; the paper's puts its frontier before."""
    return nodes_at([1.0, 6.0], [0.0, 0.0], [VISITED, OBJECT_NODE])


def goals(mass: float, hypothesis: float = 0.0) -> Goals:
    return seen_goal(mass, 6.0, 0.0, (hypothesis, 4.0, 3.5))


def choose(aims: Goals, robot=(0.0, 0.0), *, waypoint=None, places=(), **kwargs) -> Decision:
    log_miss = np.full((24, 24), -3.0)
    log_miss[19, 9] = 0.0
    belief = by_hand.with_objects(by_hand.begin(config=CONFIG), list(places))
    shown = situation(by_hand.with_coverage(belief, log_miss), nodes(), aims, robot, **kwargs)
    faithful = SHIPPED["faithful"]
    after, decision = CHOOSE(faithful, KEY, waypoint or faithful.init(shown.belief), shown)
    assert bool(after.is_active) is not bool(decision.is_stop)
    np.testing.assert_array_equal(after.x, decision.waypoint_x)
    return decision


def under_way(x: float, y: float, kind: int) -> Waypoint:
    return Waypoint(
        x=jnp.float32(x), y=jnp.float32(y), kind=jnp.int32(kind), is_active=jnp.asarray(True)
    )


def test_faithful_takes_the_node_of_highest_value() -> None:
    gamma = float(PlannerParams().discount)
    choice = choose(goals(0.6, hypothesis=0.3))
    x, y = [FRONT[0], 1.0, 6.0], [FRONT[1], 0.0, 0.0]
    way = np.hypot(np.subtract.outer(x, [6.0, 4.0]), np.subtract.outer(y, [0.0, 3.5]))
    np.testing.assert_allclose(choice.goal_value, (gamma**way) @ [0.6, 0.3], rtol=1e-4)
    assert int(choice.kind) == OBJECT_NODE
    assert not bool(choice.is_stop)
    choice = choose(goals(0.1, hypothesis=0.8))
    assert int(choice.kind) == FRONTIER


def test_what_is_to_be_avoided_costs_and_is_gone_round() -> None:
    """A cone beside the object, in a quarter of the maps and then in all."""
    aims, cone = goals(0.4, hypothesis=0.3), [(by_hand.CONE, 5.0, -1.0)]
    shares = 0.0, 0.25, 1.0
    freely, doubted, surely = (choose(aims, places=cone, forbidden=share) for share in shares)
    np.testing.assert_array_equal(freely.cost, 0.0)
    assert 0.0 == float(surely.cost[0]) < float(doubted.cost[2]) <= float(surely.cost[2])
    assert int(freely.kind) == int(surely.kind) == OBJECT_NODE
    assert float(doubted.value[2]) < float(freely.value[2])
    assert float(freely.next_y) == 0.0 < 0.5 < float(surely.next_y)
    # A corner is no arrival: it is on its way to the same place.
    assert (float(surely.waypoint_x), float(surely.waypoint_y)) == (6.0, 0.0)
    assert [bool(one.turns) for one in (freely, surely)] == [False, True]
    assert bool(surely.is_approach)
    assert not bool(surely.is_stop)


@pytest.mark.parametrize(
    ("mass", "robot", "stops"),
    [(0.9, (5.5, 0.0), True), (0.9, (3.0, 0.0), False), (0.4, (5.5, 0.0), False)],
)
def test_stop_needs_enough_mass_within_reach(mass: float, robot: tuple, stops: bool) -> None:
    choice = choose(goals(mass), robot)
    assert bool(choice.is_stop) == stops
    assert bool(choose(goals(mass), robot, is_find=1.0).is_stop) == (mass > 0.7)


def test_nothing_stops_at_random_goals_out_of_reach() -> None:
    """Some are no numbers, and what is unseen is underfoot: it stops for what is seen and near."""
    draw, reaches, stops = np.random.default_rng(0), (PlannerParams().reach, RANGE), 0
    for _ in range(120):
        values = draw.choice([0.0, 0.005, 0.3, 1.0, np.nan, np.inf], 3)
        robot, is_find = draw.uniform([3.0, -2.0], [7.0, 4.0]), int(draw.integers(2))
        aims = replace(
            goals(values[0], hypothesis=values[1]),
            object_accepted=jnp.asarray(values[2:], jnp.float32),
            hypothesis_x=jnp.float32(robot[:1]),
            hypothesis_y=jnp.float32(robot[1:]),
        )
        choice = choose(aims, tuple(robot), is_find=float(is_find))
        assert np.isfinite([choice.waypoint_x, choice.waypoint_y]).all()
        stops += bool(choice.is_stop)
        if bool(choice.is_stop):
            assert policy.MIN_GOAL_PROB <= values[2] <= 1.0
            assert np.hypot(robot[0] - 6.0, robot[1]) <= float(reaches[is_find])
    assert stops > 5


def test_a_robot_that_stands_does_not_stop_and_keeps_its_waypoint() -> None:
    aims, waypoint = goals(0.9), under_way(1.0, 0.0, VISITED)
    assert bool(choose(aims, (5.5, 0.0), waypoint=waypoint).is_stop)
    halted = choose(aims, (5.5, 0.0), waypoint=waypoint, is_still=True)
    assert not bool(halted.is_stop)
    assert bool(halted.is_kept)


def test_a_waypoint_is_kept_until_something_changes() -> None:
    aims = goals(0.6, hypothesis=0.3)
    kept = choose(aims, waypoint=under_way(1.0, 0.0, VISITED))
    assert bool(kept.is_kept)
    np.testing.assert_allclose([kept.waypoint_x, kept.waypoint_y], [1.0, 0.0])
    # News, arrival, and a frontier that is none any more each release it.
    assert not bool(choose(aims, waypoint=under_way(1.0, 0.0, VISITED), is_news=True).is_kept)
    assert not bool(choose(aims, (1.0, 0.1), waypoint=under_way(1.0, 0.0, VISITED)).is_kept)
    assert not bool(choose(aims, waypoint=under_way(1.0, 1.0, FRONTIER)).is_kept)
    assert bool(choose(aims, waypoint=under_way(4.0, 3.0, FRONTIER)).is_kept)


# The end of a search: what is missing may not be there at all.


def test_the_chance_that_something_is_left_by_hand() -> None:
    """Against the sum over how many there are; nothing unseen leaves nothing to be found."""
    alpha, epsilon = 0.3, 0.05
    number = np.arange(1, 20)
    factorial = np.cumprod(number)
    for unseen in (1.0, 0.4, 0.02):
        there = np.sum(np.exp(-alpha) * (alpha * unseen) ** number / factorial) * (1 - epsilon)
        expected = there / (there + np.exp(-alpha) * epsilon)
        found = prob_exists(*(jnp.float32(one) for one in (unseen, alpha, epsilon, 0.0)))
        assert float(found) == pytest.approx(expected, rel=1e-4)
        # … and where the number is negative binomial, by its recursion.
        clumping, shape = 2.0, alpha / 2.0
        nobody = (1.0 + clumping) ** -shape
        steps = (shape + np.arange(60)) / (1.0 + np.arange(60)) * clumping / (1.0 + clumping)
        there = np.sum(nobody * np.cumprod(steps * unseen)) * (1 - epsilon)
        found = prob_exists(*(jnp.float32(one) for one in (unseen, alpha, epsilon, clumping)))
        assert float(found) == pytest.approx(there / (there + nobody * epsilon), rel=1e-4)
    for unseen, doubt, expected in ((0.0, 0.05, 0.0), (0.1, 0.0, 1.0), (0.0, 0.0, 0.0)):
        found = prob_exists(*(jnp.float32(one) for one in (unseen, alpha, doubt, 0.0)))
        assert float(found) == pytest.approx(expected, abs=1e-6)


def both(chance: float) -> Presence:
    return Presence(jnp.float32(chance), jnp.float32(chance), jnp.float32(0.0))


def test_what_is_nowhere_ends_a_search_sooner_by_hand() -> None:
    """Three cases: it is there, the sentence is wrong of where, and it is nowhere at all."""
    maps = replace(default_map_params(), misleading=jnp.float32(0.01), clumping=jnp.float32(0.0))
    epsilon, nu = 0.01, 0.2
    for unseen in (1.0, 0.1, 0.01):
        odds = np.expm1(float(maps.concentration) * unseen)
        cases = np.array([(1 - epsilon) * (1 - nu) * odds, epsilon, (1 - epsilon) * nu])
        found = presence(jnp.float32(unseen), jnp.float32(nu), maps, jnp.float32(0.5))
        share = cases / cases.sum()
        np.testing.assert_allclose([found.prob_any, found.prob_absent], share[[0, 2]], rtol=1e-4)
        assert float(found.prob_elsewhere) == pytest.approx(1 / (1 + 199 * odds), rel=1e-3)
        assert float(found.prob_fitting) > float(found.prob_any)
        none = presence(jnp.float32(unseen), jnp.float32(0.0), maps, jnp.float32(0.0))
        assert [float(one) for one in none[:3]] == [float(found.prob_fitting)] * 2 + [0.0]


def test_what_is_unseen_by_hand() -> None:
    log_miss = -np.random.default_rng(1).exponential(1.0, (24, 24))
    missed = np.exp(log_miss)
    free = SEARCH_MAP(believe(random_places(), is_hung=False, log_miss=log_miss))
    np.testing.assert_allclose([free.unseen, free.mean_miss], missed.mean(), rtol=1e-4)
    doubted, cells = free.relocated(0.4, 0.0), missed.reshape(12, 2, 12, 2).sum(axis=(1, 3)).ravel()
    elsewhere = 0.4 * free.mass.sum() * cells / cells.sum()
    np.testing.assert_allclose(doubted.anchored, elsewhere, rtol=1e-2)
    np.testing.assert_allclose(doubted.unanchored, 0.6 * free.unanchored, rtol=1e-5)
    assert float(free.relocated(0.4, 1.5).mass.sum()) == pytest.approx(1.5, rel=1e-4)
    # Where it is said to be nobody has looked, however well the rest is known.
    log_miss = np.full((24, 24), -8.0)
    log_miss[12:14, 12:14] = 0.0
    there = np.full((P, 2), 5.2)
    there[:, 1] = 0.3
    assert float(SEARCH_MAP(believe(there, is_hung=True, log_miss=log_miss)).unseen) > 0.99
    assert float(SEARCH_MAP(believe(there, is_hung=False, log_miss=log_miss)).unseen) < 0.02


def plan_to(x: float, y: float, metres: float, mass: float, anchored: float) -> tours.Plan:
    tour = Tour(x=jnp.full((1, 1), x), y=jnp.full((1, 1), y))
    mass_left, left = jnp.float32(mass), jnp.float32(anchored)
    return tours.Plan(tours=tour, latency=jnp.full(1, metres), mass=mass_left, anchored=left)


@pytest.mark.parametrize(
    ("mass", "robot", "chance", "stops", "ends"),
    [
        (0.4, (5.5, 0.0), 0.5, False, False),  # unconfirmed, and there may be more
        (0.4, (5.5, 0.0), 0.01, True, False),  # the rest has been looked at
        (0.4, (1.0, 0.0), 0.01, False, False),  # … and it is gone up to
        (0.0, (5.5, 0.0), 0.01, False, True),  # there is none
        (0.0, (5.5, 0.0), 0.5, False, False),
        (np.nan, (5.5, 0.0), 0.01, False, False),
        (0.4, (5.5, 0.0), np.nan, False, False),
    ],
)
def test_informed_ends_once_the_rest_has_been_looked_at(mass, robot, chance, stops, ends) -> None:
    unconfirmed = replace(goals(mass, hypothesis=0.6), object_confirmed=jnp.zeros(1))
    plan = plan_to(4.0, 3.0, 9.0, 0.6, 0.6)
    shown = situation(by_hand.begin(config=CONFIG), nodes(), unconfirmed, robot)
    choice = DECIDE_ON(shown, plan, both(chance))
    assert (bool(choice.is_stop), bool(choice.is_not_found)) == (stops, ends)
    assert not DECIDE_ON(shown, replace(plan, ordered=jnp.float32(0.3)), both(chance)).is_stop
    if mass == 0.4 and chance < 0.1 and not stops:
        assert int(choice.kind) == OBJECT_NODE
        assert bool(choice.is_approach)
    # That it is nowhere ends a search that has shown nothing, and nothing is taken for it.
    choice = DECIDE_ON(shown, plan, Presence(jnp.float32(0.5), jnp.float32(chance), jnp.float32(0)))
    assert (bool(choice.is_stop), bool(choice.is_not_found)) == (False, ends)


@pytest.mark.parametrize(("unlooked", "ends"), [(0.03, False), (0.015, True)])
def test_a_thorough_search_ends_when_hardly_anything_is_unlooked(unlooked, ends) -> None:
    """However likely it is thought that what is spoken of is nowhere."""
    plan = plan_to(4.0, 3.0, 9.0, 0.6, 0.0)
    shown = situation(by_hand.begin(config=CONFIG), nodes(), goals(0.0), (5.5, 0.0))
    low = Presence(*(jnp.float32(share) for share in (0.01, 0.01, 0.4, unlooked)))
    doubting = replace(shown.params, absent=jnp.float32(0.05))
    assert bool(DECIDE_ON(replace(shown, params=doubting), plan, low).is_not_found) is ends
    assert bool(DECIDE_ON(shown, plan, low).is_not_found)


def test_nowhere_ends_no_search_that_has_shown_something() -> None:
    """What does not fit now may have to do: the sentence is rather false than of nothing there."""
    plan = plan_to(4.0, 3.0, 9.0, 0.6, 0.6)
    for is_seen in (True, False):
        # The robot's own entry comes last, and is nothing that has been seen.
        aims = replace(goals(0.0, hypothesis=0.6), is_object=jnp.array([is_seen, True]))
        shown = situation(by_hand.begin(config=CONFIG), nodes(), aims, (5.5, 0.0))
        low = Presence(jnp.float32(0.5), jnp.float32(0.01), jnp.float32(0.4))
        assert bool(DECIDE_ON(shown, plan, low).is_not_found) is not is_seen
        assert bool(DECIDE_ON(shown, plan, both(0.01)).is_not_found)


@pytest.mark.parametrize(("likelier", "stops"), [(0.8, False), (0.2, False), (0.15, True)])
def test_what_hangs_on_the_unseen_and_is_likelier_is_not_passed_over(likelier, stops) -> None:
    """The robot stands at what alone can be confirmed; another thing is likelier, or is not."""
    plan = plan_to(-3.0, 4.0, 2.0, 0.6, 0.6)
    aims = goals_with(
        [6.0, 0.0], [0.0, 0.0], [likelier, 0.16], confirmed=[0.08, 0.16],
        hypothesis=(0.01, 0.0, 0.0),
    )  # fmt: skip
    around = nodes_at([5.0, 6.0, 0.0], [0.0] * 3, [VISITED, OBJECT_NODE, OBJECT_NODE])
    shown = situation(by_hand.begin(config=CONFIG), around, aims)
    choice = DECIDE_ON(shown, plan, both(0.5))
    assert bool(choice.is_stop) is stops
    # Once nothing is left to look for, the likeliest of all is gone to.
    choice = DECIDE_ON(shown, plan, both(0.01))
    assert bool(choice.is_stop) is (likelier < 0.16)
    assert stops or float(choice.waypoint_x) == 6.0


def test_who_looks_on_is_not_drawn_back_to_what_has_been_seen() -> None:
    """What is left to be found is little and far, what has been seen is near and likely."""
    plan = plan_to(-3.0, 4.0, 2.0, 0.1, 0.0)
    aims = goals(0.9, hypothesis=0.1)
    with_robot = {
        name: jnp.append(getattr(aims, name), 0).astype(getattr(aims, name).dtype)
        for name in ("object_x", "object_y", "object_mass", "object_accepted", "is_object")
    }
    aims = replace(aims, **with_robot, object_confirmed=with_robot["object_accepted"])
    around = nodes_at([5.0, 6.0, 0.0], [0.0] * 3, [VISITED, OBJECT_NODE, OBJECT_NODE])
    around = replace(around, is_node=jnp.array([True, True, False]))
    shown = situation(by_hand.begin(config=CONFIG), around, aims, (2.0, 0.0))
    asking = replace(shown.params, question_cost=jnp.float32(0.1), look_cost=jnp.float32(5e-4))
    for params, searches_on in ((shown.params, False), (asking, True)):
        choice = DECIDE_ON(replace(shown, params=params), plan, both(0.5))
        assert bool(choice.question.searches_on) == searches_on
        at_stop = (float(choice.waypoint_x), float(choice.waypoint_y)) == (-3.0, 4.0)
        assert at_stop == searches_on
