"""Tours: first sight against brute force, latency by hand, improvement, the learned prior."""

import itertools

import jax
import jax.numpy as jnp
import learn_prior
import numpy as np
import pytest
import readings as by_hand
from situations import nodes_at, seen_goal, situation
from test_planner_policy import CONFIG, DECIDE_ON, NOT, P, believe, hear, random_places

from jaxlangnav.messages import BEHIND, NONE, default_sensor
from jaxlangnav.planner import prior, tours
from jaxlangnav.planner.graph import OBJECT_NODE
from jaxlangnav.planner.latency import (
    NUM_STOPS,
    SIGHT_MARGIN,
    Tour,
    _patch_travel,
    first_sight,
    latency,
)
from jaxlangnav.planner.policy import Decision
from jaxlangnav.planner.search import CELLS, SearchMap, grid, search_map
from jaxlangnav.planner.termination import Presence
from jaxlangnav.planner.tours import NUM_CHANGES
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.coverage import log_miss_at
from jaxlangnav.terrain.view import MIN_SIGHT

AREA = jnp.array([0.0, 10.0, -5.0, 5.0])
K, RANGE = NUM_STOPS, 3.0
SENSOR = default_sensor(RANGE)
SEARCH_MAP, PLAN, CHANGE = jax.jit(search_map), jax.jit(tours.plan), jax.jit(tours.random_moves)
FIRST_SIGHT, LATENCY = jax.jit(first_sight), jax.jit(latency)
DENSITY, ONE = jax.jit(prior.relative_density), jnp.float32(1.0)


def random_tours(number: int, seed: int = 0) -> Tour:
    random = np.random.default_rng(seed)
    return Tour(
        x=jnp.asarray(random.uniform(0.0, 10.0, (number, K)), jnp.float32),
        y=jnp.asarray(random.uniform(-5.0, 5.0, (number, K)), jnp.float32),
    )


def search_of(free, anchored=None) -> SearchMap:
    """Build a search map of given masses, f64[CELLS²]; pairs are alone."""
    steps = (np.arange(CELLS) + 0.5) / CELLS * 10.0
    x, y = np.tile(steps, CELLS), np.repeat(steps - 5.0, CELLS)
    anchored = np.zeros(CELLS**2) if anchored is None else anchored
    x, y, free, anchored = (jnp.asarray(one, jnp.float32) for one in (x, y, free, anchored))
    where = {"x": x, "y": y, "partner_x": x, "partner_y": y, "unseen": jnp.float32(1.0)}
    return SearchMap(**where, unanchored=free, anchored=anchored)


def brute_force(tour_x, tour_y, x: float, y: float, radius: float, opening=2 * np.pi) -> float:
    """Walk from (1, 0) by millimetres until (x, y) is near, and in view for ``MIN_SIGHT`` m."""
    walked, at = 0.0, np.array([1.0, 0.0])
    for stop in zip(np.asarray(tour_x, float), np.asarray(tour_y, float), strict=True):
        length = np.hypot(*(np.array(stop) - at))
        steps = np.linspace(0.0, 1.0, max(2, int(length / 0.001)))[:, None]
        way = at + steps * (np.array(stop) - at)
        near = np.hypot(*(way - [x, y]).T) <= radius
        if opening < 2 * np.pi:
            ahead = (np.array(stop) - at) / max(length, 1e-6)
            later = [x, y] - way - MIN_SIGHT * ahead
            near &= later @ ahead >= np.hypot(*later.T) * np.cos(0.5 * opening)
        if near.any():
            return walked + float(steps[near.argmax(), 0]) * length
        walked, at = walked + length, np.array(stop)
    return np.inf


def check_first_sight(lines: Tour, places: np.ndarray, *numbers: float) -> tuple:
    """Hold first sights, from (1, 0) within a radius and a view, against brute force."""
    x, y = jnp.asarray(places.T)
    first, length = FIRST_SIGHT(lines, x, y, HERE, *jnp.array(numbers))
    first = np.where(np.asarray(first) >= 1e8, np.inf, first)
    for index, found in enumerate(first):
        expected = [brute_force(lines.x[index], lines.y[index], *one, *numbers) for one in places]
        np.testing.assert_allclose(found, expected, atol=0.01)
    return first, length


def test_first_sight_against_brute_force() -> None:
    """All round, and in views ahead."""
    lines, unseen = random_tours(4, seed=3), []
    # A stop twice over is a stretch of no length: it must see nothing new.
    lines = Tour(x=lines.x.at[0, 2:].set(9.0), y=lines.y.at[0, 2:].set(4.0))
    places = np.random.default_rng(4).uniform([0, -5], [10, 5], (25, 2))
    stops = np.stack([np.asarray(lines.x), np.asarray(lines.y)], axis=-1)
    stops = np.concatenate([np.broadcast_to([1.0, 0.0], (4, 1, 2)), stops], axis=1)
    for opening in (0.6, 1.5, 2.5, 4.0, 2 * np.pi):
        first, length = check_first_sight(lines, places, 2.0, opening)
        unseen.append(np.isinf(first).sum())
        np.testing.assert_allclose(length, np.hypot(*np.diff(stops, axis=1).T).sum(0), rtol=1e-4)
    assert min(unseen[:2]) > unseen[-1] + 5


def test_what_a_narrow_view_passes_by_is_driven_up_to() -> None:
    """A camera that looks ahead: the thing beside the way is in no view along it."""
    mass = np.zeros((CELLS, CELLS))
    mass[CELLS // 2 + 1, 2] = 1.0  # at (2.1, 1.25)
    search = search_of(np.zeros(CELLS**2), mass.reshape(-1))
    narrow = default_sensor(RANGE, field_of_view=1.4)
    past = Tour(x=jnp.full((1, K), 9.0), y=jnp.zeros((1, K)))
    up_to = Tour(x=jnp.full((1, K), 1.7), y=jnp.full((1, K), 0.8))
    here = jnp.float32(1.4), jnp.float32(0.0)
    by, at = (float(LATENCY(one, search, here, narrow, AREA)[0]) for one in (past, up_to))
    assert at == pytest.approx(0.0, abs=1e-3)
    assert by > 9.0
    assert float(LATENCY(past, search, here, SENSOR, AREA)[0]) == pytest.approx(0.0, abs=1e-3)


def test_latency_is_the_mean_way_until_found() -> None:
    """Masses on cells that the tour sees: the mean of first sights; the rest lies beyond."""
    search = search_of(np.random.default_rng(2).dirichlet(np.ones(CELLS**2)))
    line = Tour(x=jnp.full((1, K), 6.0), y=jnp.zeros((1, K)))
    zero = jnp.float32(0.0), jnp.float32(0.0)
    first, _ = FIRST_SIGHT(line, search.x, search.y, zero, jnp.float32(RANGE) - SIGHT_MARGIN)
    first, mass = np.asarray(first)[0], np.asarray(search.mass)
    is_seen = first < 1e8
    away = np.hypot(np.asarray(search.x) - 6.0, np.asarray(search.y))
    sweep = (~is_seen & (mass > 0.1 * mass.mean())).sum() * 100.0 / CELLS**2 / (4 * RANGE)
    expected = (mass * np.where(is_seen, first, 6.0 + sweep + away)).sum()
    found = LATENCY(line, search, zero, SENSOR, AREA)
    np.testing.assert_allclose(found, [expected], rtol=1e-4)
    # It may be nowhere: the way until all has been looked at counts as much as that is likely.
    is_missed = ~is_seen & (mass > 0.1 * mass.mean())
    whole = 6.0 + away[is_missed].mean() + is_missed.sum() * 100.0 / CELLS**2 / (2 * RANGE)
    whole += float(_patch_travel(jnp.asarray(is_missed)[None], AREA)[0])
    search = replace(search, prob_absent=jnp.float32(0.3))
    found = LATENCY(line, search, zero, SENSOR, AREA)
    np.testing.assert_allclose(found, [0.7 * expected + 0.3 * whole], rtol=1e-4)


@pytest.mark.parametrize(("figure", "gap"), [(0, 2.0), (1, -2.0)])
def test_partner_is_where_the_relation_has_it(figure: int, gap: float) -> None:
    """Figures 2 m farther than their landmarks, or nearer; and neither has been seen."""
    log_miss = -np.random.default_rng(1).exponential(1.0, (24, 24))
    places = np.random.default_rng(3).uniform([4.0, -3.0], [9.0, 3.0], (P, 2))
    belief = believe(places, is_hung=False, log_miss=log_miss)
    x, y = (places * (1.0 - 2.0 / np.hypot(*places.T))[:, None]).T
    nearer = {"is_mentioned": True, "hypothesis_x": x, "hypothesis_y": y, "root": NONE}
    parts = {n: getattr(belief.particles, n).at[1].set(value) for n, value in nearer.items()}
    pair = replace(belief, particles=replace(belief.particles, **parts))
    words = by_hand.readings([[0, 1]], [[(figure, BEHIND, 1 - figure, False)]])
    search = SEARCH_MAP(pair, ONE, NOT, hear(words, pair))
    before = np.hypot(search.x, search.y) - np.hypot(search.partner_x, search.partner_y)
    far = np.hypot(search.x, search.y) > 2.1
    np.testing.assert_allclose(before[far], gap, atol=1e-3)
    alone = SEARCH_MAP(belief, NOT, NOT, hear(words, belief))
    np.testing.assert_allclose(alone.partner_x, alone.x, atol=1e-5)
    centres = np.stack(grid(belief.coverage.area, CELLS), axis=1)
    moved = (1.0 - np.outer([0.6, 1.0, 1.4], gap / np.hypot(*centres.T)))[..., None] * centres
    missed = np.exp(log_miss_at(belief.coverage, *moved.transpose(2, 0, 1))).mean(axis=0)
    learned = DENSITY(pair.coverage, pair.viewer, *centres.T, ONE, NOT, ONE)
    expected = alone.mass * (0.2 + 0.8 * missed) * learned
    np.testing.assert_allclose(search.mass, expected / expected.sum(), rtol=1e-3)


NUM_CELLS = 5
HERE = jnp.float32(1.0), jnp.float32(0.0)
START = Tour(x=jnp.full(K, HERE[0]), y=jnp.full(K, HERE[1]))


def plan(search: SearchMap, tour: Tour, seed: int = 0) -> tours.Plan:
    return PLAN(jax.random.key(seed), tour, search, HERE, SENSOR, AREA)


def exact(lines: Tour, search, cells: np.ndarray) -> np.ndarray:
    """Enumerate what may be true: the metres until one is seen, and its own, or all has been."""
    x, y = search.x[cells], search.y[cells]
    radius = jnp.float32(RANGE - SIGHT_MARGIN)
    own, other = (np.asarray(FIRST_SIGHT(lines, at, y, HERE, radius)[0]) for at in (x, x - 2.0))
    there = np.minimum(own, other + 1.0) @ np.asarray(search.mass)[cells]
    last = np.minimum(own, other).max(axis=1)
    return (1.0 - float(search.prob_absent)) * there + float(search.prob_absent) * last


def touching(search, cells: np.ndarray) -> Tour:
    """Build all orders in which the way just comes within sight of either of each pair."""
    orders = np.array(list(itertools.permutations(range(NUM_CELLS))))
    either = np.array(list(itertools.product([0.0, 2.0], repeat=NUM_CELLS)))
    order, nearer = np.repeat(orders, len(either), 0), np.tile(either, (len(orders), 1))
    stops, here = [], np.broadcast_to(np.array([HERE]).T, (2, len(order)))
    for step in range(NUM_CELLS):
        one = order[:, step]
        nearer_x = nearer[np.arange(len(one)), one]
        at = np.array([search.x[cells[one]] - nearer_x, search.y[cells[one]]])
        away = np.hypot(*(here - at))
        here = at + (here - at) * np.minimum(1.0, (RANGE - SIGHT_MARGIN - 0.01) / away)
        stops.append(here)
    stops += [here] * (K - NUM_CELLS)
    x, y = jnp.asarray(np.array(stops), jnp.float32).transpose(1, 2, 0)
    return Tour(x=x, y=y)


@pytest.mark.parametrize("nowhere", [0.0, 0.05, 0.5])
def test_tours_against_all_orders_of_viewpoints(nowhere: float) -> None:
    """A pair is in one of five cells, the other 2 m nearer in x, or nowhere."""
    random, regret = np.random.default_rng(0), []
    for seed in range(8):
        cells, mass = random.choice(CELLS**2, NUM_CELLS, replace=False), np.zeros(CELLS**2)
        mass[cells] = random.dirichlet(np.full(NUM_CELLS, 3.0))
        search = replace(search_of(mass), prob_absent=jnp.float32(nowhere))
        search = replace(search, partner_x=search.x - 2.0)
        lines = touching(search, cells)
        expected = exact(lines, search, cells)
        found = np.asarray(LATENCY(lines, search, HERE, SENSOR, AREA))
        is_exact = (expected < 1e3) & (found < 1e3)
        np.testing.assert_allclose(found[is_exact], expected[is_exact], rtol=1e-3)
        tour = START
        for step in range(20):
            now = plan(search, tour, 100 * seed + step)
            best = int(jnp.argmin(now.latency))
            tour = Tour(x=now.tours.x[best], y=now.tours.y[best])
        tour = jax.tree.map(lambda leaf: leaf[None], tour)
        regret.append(exact(tour, search, cells)[0] / expected.min() - 1.0)
    assert np.mean(regret) <= 0.05


def test_changes_stay_in_the_area_and_are_changes() -> None:
    search = search_of(np.full(CELLS**2, CELLS**-2.0))
    one = jax.tree.map(lambda leaf: leaf[0], random_tours(1))
    for seed in range(20):
        new = CHANGE(jax.random.key(seed), one, search, AREA)
        x, y = np.asarray(new.x), np.asarray(new.y)
        assert x.shape == (NUM_CHANGES, K)
        for low, value, high in ((0, x, 10), (-5, y, 5)):
            assert ((value >= low) & (value <= high)).all()
        # Moves touch one stop; a reversal keeps them all.
        assert ((x[:2] != np.asarray(one.x)).sum(1) <= 1).all()
        np.testing.assert_allclose(np.sort(x[3]), np.sort(one.x))
        assert (x[2] != np.asarray(one.x)).any()


@pytest.mark.parametrize(("rival", "stops"), [(0.3, False), (0.02, True)])
def test_a_goal_with_unseen_rivals_is_not_settled(rival: float, stops: bool) -> None:
    """Informed, in reach of a confirmed goal: it looks on while rivals beside things seen are."""
    search = search_of(np.full(CELLS**2, 0.05 / CELLS**2), np.eye(1, CELLS**2, 30)[0] * rival)
    now = plan(search, START)
    choice = decide(now, 0.9)
    assert bool(choice.is_stop) is stops
    assert (float(choice.goal_value[-1]) > 1.0) is stops
    value = np.asarray(choice.value)
    parts = np.asarray(choice.goal_value + choice.information_value - choice.cost)
    np.testing.assert_allclose(value[np.isfinite(value)], parts[np.isfinite(value)], atol=1e-6)
    if not stops:
        best = int(np.argmax(value))
        assert best < now.latency.shape[0]
        np.testing.assert_allclose(
            [choice.waypoint_x, choice.waypoint_y], [now.tours.x[best, 0], now.tours.y[best, 0]]
        )


@pytest.mark.parametrize("goal", [0.0, 1e-30, 5e-3, np.nan])
def test_with_nothing_left_to_find_it_settles_for_no_goal_that_is_none(goal: float) -> None:
    """Informed, all looked at, before an object that does not fit: 0 ≥ 0 is no arrival."""
    now = plan(search_of(np.zeros(CELLS**2)), START)
    choice = decide(now, goal)
    assert not bool(choice.is_stop)
    assert not float(choice.goal_value[-1]) > 1.0
    assert np.isfinite([choice.waypoint_x, choice.waypoint_y]).all()
    # An object that may well be it has to do.
    assert bool(decide(now, 0.2).is_stop)


def decide(now: tours.Plan, goal: float) -> Decision:
    """Let the informed policy choose half a metre from an object, the goal with a probability."""
    shown = situation(
        by_hand.begin(config=CONFIG), nodes_at([1.5], [0.0], [OBJECT_NODE]), seen_goal(goal, 1.5),
        (1.0, 0.0),
    )  # fmt: skip
    return DECIDE_ON(shown, now, Presence(jnp.float32(1.0), jnp.float32(1.0), NOT))


def test_prior_is_relative_to_uniform_and_can_be_left_out() -> None:
    belief = by_hand.begin(config=CONFIG)
    steps = (np.arange(80) + 0.5) / 80 * 10.0
    x, y = (jnp.asarray(one, jnp.float32) for one in (np.tile(steps, 80), np.repeat(steps - 5, 80)))

    def density(share: float, ahead: float = 0.0, pair: float = 0.0, turn: float = 0.0):
        numbers = jnp.array([share, ahead, pair], jnp.float32)
        return np.asarray(DENSITY(belief.coverage, jnp.array([0.0, 0.0, turn]), x, y, *numbers))

    np.testing.assert_array_equal(density(0.0), 1.0)
    # Of goals alone, of goals and landmarks, and of what may be either.
    alone, pairs = density(1.0), density(1.0, pair=1.0)
    place = np.array([np.hypot(x, y) / 12.5 * 15, np.abs(np.arctan2(y, x)) / (np.pi / 2) * 9])
    for table, found in zip(prior.load_table(), (alone, pairs), strict=True):
        inside = place[0] < 15
        np.testing.assert_allclose(found[inside], table[*place[:, inside].astype(int)], rtol=1e-5)
    np.testing.assert_allclose(density(1.0, pair=0.3), 0.7 * alone + 0.3 * pairs, rtol=1e-5)
    np.testing.assert_allclose(density(0.5), 0.5 * alone + 0.5, rtol=1e-5)
    assert alone.max() > 2.0
    # Behind the viewer nothing was ever learned.
    assert density(1.0, turn=np.pi).max() == 0.0
    # Of a robot that takes things to lie ahead, exp κ (cos b − 1), at any range.
    expected = np.exp(1.5 * (np.asarray(x) / np.hypot(x, y) - 1.0))
    np.testing.assert_allclose(density(0.0, 1.5), expected, rtol=1e-4)


def test_the_shipped_table_is_what_training_worlds_teach() -> None:
    learned = learn_prior.learn(learn_prior.training_worlds(60))
    assert np.corrcoef(learned.ravel(), prior.load_table().ravel())[0, 1] > 0.97


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_free_hypotheses_are_spread_over_what_is_unexplored_by_the_prior(share: float) -> None:
    log_miss = -np.random.default_rng(1).exponential(1.0, (24, 24))
    belief = believe(random_places(), is_hung=False, log_miss=log_miss)
    search = SEARCH_MAP(belief, jnp.float32(share), NOT)
    centres = search_of(np.zeros(CELLS**2))
    expected = np.exp(log_miss).reshape(CELLS, 2, CELLS, 2).sum((1, 3)).ravel() * np.asarray(
        DENSITY(belief.coverage, belief.viewer, centres.x, centres.y, jnp.float32(share), NOT, NOT)
    )
    # The map is tilted by 0.2 % from one end to the other.
    np.testing.assert_allclose(search.unanchored, expected / expected.sum(), rtol=2e-3)
    assert float(jnp.sum(search.anchored)) == 0.0


def test_ways_patch_travel_by_hand() -> None:
    """Blocks of two cells a side are 1.67 m wide; what lies no farther apart than 2.5 m is one."""

    def metres(*cells: tuple[int, int]) -> float:
        is_missed = np.zeros((1, CELLS, CELLS), bool)
        for row, column in cells:
            is_missed[0, row, column] = True
        return float(_patch_travel(jnp.asarray(is_missed.reshape(1, -1)), AREA)[0])

    block = 10.0 / 6.0
    assert metres() == metres((0, 0)) == metres((0, 0), (0, 3)) == 0.0
    assert metres((0, 0), (0, 11)) == pytest.approx(5 * block - 1.5 * block, rel=1e-5)
    expected = (5 * block - 1.5 * block) + (np.hypot(5, 5) * block - 1.5 * block)
    assert metres((0, 0), (0, 11), (11, 0)) == pytest.approx(expected, rel=1e-5)


def test_a_cell_stands_for_what_of_it_has_been_looked_at_least() -> None:
    log_miss = np.full((24, 24), -3.0)
    log_miss[1, 0] = 0.0
    belief, part = believe(random_places(), is_hung=False, log_miss=log_miss), 10.0 / 24
    found = SEARCH_MAP(belief, NOT, NOT)
    np.testing.assert_allclose([found.x[0], found.y[0]], [0.5 * part, 1.5 * part - 5.0], atol=1e-5)
