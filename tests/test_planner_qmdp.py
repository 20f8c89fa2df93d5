"""Candidate waypoints by hand (eq. 9), and their values against the double sum (eq. 11-12)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from oracles import qmdp as oracle

from jaxlangnav.messages import AT, BEHIND, LEFT, NEAR, NONE, ROBOT, Behavior, Readings
from jaxlangnav.planner import qmdp
from jaxlangnav.planner.goals import gather, reassign_distractor_mass
from jaxlangnav.planner.graph import add_visited, empty_visited, frontiers, unexplored_cells
from jaxlangnav.planner.relevance import components, links_to_goal, links_to_unseen, particle_groups
from jaxlangnav.pytree import replace
from jaxlangnav.relations import default_params, prepare
from jaxlangnav.semantic_map import particle
from jaxlangnav.semantic_map.coverage import Coverage, cell_centres

OBJECTS = [(0, 6.0, 1.0), (1, 4.0, -2.0), (0, 3.0, 3.0)]
VIEWER = (1.0, -1.0, 0.4)
P, SLOTS, M = by_hand.CONFIG.num_particles, by_hand.CONFIG.num_objects, by_hand.M
DISTANCE = np.exp(np.asarray(default_params().log_distance, float))
WITHIN = jax.jit(qmdp.mass_within)
NODES = np.random.default_rng(5).uniform([0, -5], [10, 5], (40, 2))


@jax.jit
def value_of(belief, behavior, discount):
    has_unseen = jnp.zeros_like(belief.particles.is_mentioned)
    goals = gather(belief, behavior, prepare(default_params()), has_unseen, jnp.float32(0.0))
    x, y = jnp.asarray(NODES[:, 0], jnp.float32), jnp.asarray(NODES[:, 1], jnp.float32)
    return qmdp.values(x, y, goals, discount), goals


def believe(seed: int = 0):
    """Build particles that share three seen objects and differ in hypotheses and weights."""
    random = np.random.default_rng(seed)
    belief = by_hand.with_objects(by_hand.begin(VIEWER), OBJECTS)
    referent = np.where(random.uniform(size=(M, P)) < 0.5, NONE, 0)
    weight = random.dirichlet(np.ones(P))
    x, y = random.uniform(0, 10, (M, P)), random.uniform(-5, 5, (M, P))
    belief = replace(
        belief,
        log_weight=jnp.asarray(np.log(weight), jnp.float32),
        particles=replace(
            belief.particles,
            referent=jnp.asarray(referent, jnp.int32),
            is_mentioned=jnp.ones((M, P), bool),
            hypothesis_x=jnp.asarray(x, jnp.float32),
            hypothesis_y=jnp.asarray(y, jnp.float32),
        ),
    )
    places = np.zeros((P, SLOTS + M + 1, 2))
    for slot, (_, object_x, object_y) in enumerate(OBJECTS):
        places[:, slot] = object_x, object_y
    places[:, SLOTS : SLOTS + M, 0], places[:, SLOTS : SLOTS + M, 1] = x.T, y.T
    places[:, -1] = VIEWER[:2]
    return belief, places, weight, referent == NONE


def behave(goal: np.ndarray) -> Behavior:
    """Turn goals f64[P, 7, N + 1] into behaviors, the particle axis last."""
    return Behavior(
        action=jnp.tile(jnp.array([[1.0], [0.0]]), (1, P)),
        mode=jnp.tile(jnp.array([[1.0], [0.0], [0.0]]), (1, P)),
        goal=jnp.asarray(np.moveaxis(goal, 0, -1), jnp.float32),
        constraint=jnp.zeros((7, SLOTS + M + 1, P)),
    )


@pytest.mark.parametrize("region", range(7))
@pytest.mark.parametrize("discount", [0.8, 0.97])
def test_value_equals_the_double_sum(region: int, discount: float) -> None:
    belief, places, weight, is_open = believe()
    random, size = np.random.default_rng(1), SLOTS + M + 1
    goal = np.zeros((P, 7, size))
    # One region an object; in each particle seen objects and at most one hypothesis share the goal.
    goal[:, region, :3] = random.uniform(0, 0.3, (P, 3))
    first = np.where(is_open.any(0), is_open.argmax(0), 0)
    goal[np.arange(P), region, SLOTS + first] = np.where(is_open.any(0), 0.1, 0.0)
    is_referent = np.zeros((P, size), bool)
    is_referent[:, 0], is_referent[:, SLOTS : SLOTS + M] = ~is_open.all(0), is_open.T
    claimed = np.zeros_like(goal)
    claimed[:, region] = oracle.reassign_mass(goal[:, region], is_referent, SLOTS)
    truth = oracle.values(NODES, places, weight, claimed, np.array(VIEWER), DISTANCE, discount)
    ours, _ = value_of(belief, behave(goal), jnp.float32(discount))
    np.testing.assert_allclose(ours, truth, rtol=2e-4)


@pytest.mark.parametrize("region", range(7))
def test_value_of_a_goal_beside_the_robot_itself(region: int) -> None:
    """ "Move to your left": the robot's slot, in its own frame at the utterance."""
    belief, places, weight, _ = believe()
    goal = np.zeros((P, 7, SLOTS + M + 1))
    goal[:, region, -1] = 0.9
    truth = oracle.values(NODES, places, weight, goal, np.array(VIEWER), DISTANCE, 0.8)
    ours, goals = value_of(belief, behave(goal), jnp.float32(0.8))
    np.testing.assert_allclose(ours, truth, rtol=2e-4)
    assert bool(goals.is_object[-1])


def test_mass_within_reach() -> None:
    """A seen object that fits as well as any takes the whole goal, others only their share."""
    belief, places, weight, _ = believe()
    goal = np.zeros((P, 7, SLOTS + M + 1))
    goal[:, AT, 0], goal[:, AT, SLOTS + 1] = 0.5, 0.3
    _, goals = value_of(belief, behave(goal), jnp.float32(0.8))
    for x, y, radius in ((6.2, 1.1, 0.5), (6.0, 1.0, 2.0), (0.0, 0.0, 1.0), (5.0, 0.0, 20.0)):
        everything, confirmed = WITHIN(jnp.float32(x), jnp.float32(y), goals, jnp.float32(radius))
        is_object_near = np.hypot(x - 6.0, y - 1.0) <= radius
        near = np.hypot(places[:, SLOTS + 1, 0] - x, places[:, SLOTS + 1, 1] - y) <= radius
        shared = 0.5 * is_object_near + (0.3 * weight * near).sum()
        expected = max(0.8 * is_object_near, shared)
        assert abs(float(everything) - expected) < 1e-5
        assert float(confirmed) <= 0.8 * is_object_near + 1e-5


def test_objects_that_fit_equally_are_equally_good() -> None:
    """Either of two hydrants is "the hydrant", a cone is not; each particle says which is meant."""
    belief, _, weight, is_open = believe()
    goal = np.zeros((P, 7, SLOTS + M + 1))
    goal[:, AT, 0] = goal[:, AT, 2] = 0.45
    goal[:, AT, 1] = 0.01
    _, goals = value_of(belief, behave(goal), jnp.float32(0.8))
    meant = weight[~is_open.all(0)].sum()
    assert 0.1 < meant < 0.999
    # Where it is not meant it has its own share, as the others have theirs.
    expected = [0.45 + 0.46 * meant, 0.01 * (1.0 - meant), 0.45 * (1.0 - meant)]
    np.testing.assert_allclose(goals.object_mass[:3], expected, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(goals.object_accepted[:3], [0.91, 0.91 / 45, 0.91], rtol=1e-3)


def claimed_by(referent: list[int], mass: list[float]) -> list[float]:
    """Claim in one particle of three seen objects, two mentions and the robot."""
    particles = replace(
        by_hand.begin(VIEWER).particles,
        object_type=jnp.array([[0], [1], [0]]),
        referent=jnp.array(referent)[:, None],
        is_mentioned=jnp.ones((2, 1), bool),
    )
    return reassign_distractor_mass(jnp.array(mass)[:, None], particles)[:, 0].tolist()


@pytest.mark.parametrize(
    ("referent", "mass", "expected"),
    [
        # The hydrant meant is still to be found: the two in sight yield to it.
        ([NONE, 1], [0.3, 0.0, 0.3, 0.3, 0.0, 0.0], [0.0, 0.0, 0.0, 0.9, 0.0, 0.0]),
        # It is one of those in sight.
        ([2, NONE], [0.45, 0.0, 0.45, 0.0, 0.05, 0.0], [0.0, 0.0, 0.9, 0.0, 0.05, 0.0]),
        # Both are spoken of, so neither is a bystander.
        ([0, 2], [0.6, 0.0, 0.3, 0.0, 0.0, 0.0], [0.6, 0.0, 0.3, 0.0, 0.0, 0.0]),
        # "The other cone": what is referred to is hardly the goal, and claims hardly anything.
        ([0, 1], [0.02, 0.0, 0.9, 0.0, 0.0, 0.0], [0.04, 0.0, 0.88, 0.0, 0.0, 0.0]),
        # The robot's own side is no bystander.
        ([0, NONE], [0.4, 0.0, 0.0, 0.0, 0.0, 0.5], [0.4, 0.0, 0.0, 0.0, 0.0, 0.5]),
    ],
)
def test_bystanders_yield_to_what_is_meant(referent, mass, expected) -> None:
    np.testing.assert_allclose(claimed_by(referent, mass), expected, atol=1e-6)


def test_garbage_in_empty_slots_changes_no_value() -> None:
    belief, _, _, _ = believe()
    goal = np.zeros((P, 7, SLOTS + M + 1))
    goal[:, AT, 0], goal[:, AT, SLOTS] = 0.5, 0.3
    ours, _ = value_of(belief, behave(goal), jnp.float32(0.8))
    particles = belief.particles
    dirty = replace(
        belief,
        particles=replace(
            particles,
            mean_x=particles.mean_x.at[3:SLOTS].set(77.0),
            mean_y=particles.mean_y.at[3:SLOTS].set(-77.0),
        ),
    )
    theirs, goals = value_of(dirty, behave(goal), jnp.float32(0.8))
    np.testing.assert_array_equal(ours, theirs)
    assert goals.is_object.tolist() == [True] * 3 + [False] * (SLOTS + 1 - 3)


# ---------------------------------------------------------------- candidate waypoints (eq. 9)

AREA = jnp.array([0.0, 8.0, -4.0, 4.0])
CELLS, BLOCKS = 16, 4
FRONTIERS = jax.jit(frontiers, static_argnames="num_blocks")


def coverage(log_miss: np.ndarray) -> Coverage:
    return Coverage(log_miss=jnp.asarray(log_miss, jnp.float32), area=AREA)


def test_everything_seen_once_leaves_what_was_seen_least() -> None:
    """Unexplored is relative: nothing is written off for good."""
    log_miss = np.full((CELLS, CELLS), -6.0)
    log_miss[4:8, 4:8] = -3.0
    cells = np.asarray(unexplored_cells(coverage(log_miss), jnp.float32(0.5)))
    assert cells[4:8, 4:8].all()
    assert cells.sum() == 16
    _, _, is_frontier = FRONTIERS(coverage(log_miss), BLOCKS, 0.5)
    assert np.asarray(is_frontier).reshape(BLOCKS, BLOCKS)[1, 1]
    assert is_frontier.sum() == 1


LEFT_HALF = np.where(np.arange(CELLS) < 8, -3.0, 0.0)[None].repeat(CELLS, 0)
RANDOM = np.where(np.random.default_rng(0).uniform(size=(CELLS, CELLS)) < 0.5, -3.0, 0.0)


@pytest.mark.parametrize("log_miss", [0.0 * RANDOM, LEFT_HALF, RANDOM], ids=["no", "half", "some"])
def test_every_frontier_node_is_a_mean_of_frontier_cells(log_miss: np.ndarray) -> None:
    """Against a plain loop over cells."""
    x, y, is_frontier = FRONTIERS(coverage(log_miss), BLOCKS, 0.5)
    centre_x, centre_y = (np.asarray(axis) for axis in cell_centres(coverage(log_miss)))
    places: dict[int, list] = {}
    for row in range(CELLS):
        for column in range(CELLS):
            beside = [(row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)]
            inside = [one for one in beside if min(one) >= 0 and max(one) < CELLS]
            if log_miss[row, column] == 0.0 and any(log_miss[one] < 0.0 for one in inside):
                block = (row // 4) * BLOCKS + column // 4
                places.setdefault(block, []).append((centre_x[column], centre_y[row]))
    for block in range(BLOCKS**2):
        assert bool(is_frontier[block]) == (block in places)
        if block in places:
            np.testing.assert_allclose([x[block], y[block]], np.mean(places[block], 0), rtol=1e-5)
    # Half of the area seen: the first unexplored column, in every row of blocks.
    assert len(places) == {0.0: 0, 0.5: BLOCKS}.get((log_miss < 0.0).mean(), BLOCKS**2)


def test_visited_places_are_kept_apart_and_the_oldest_goes() -> None:
    step, visited = jax.jit(add_visited), empty_visited(3)
    for x in (0.0, 0.5, 1.2, 1.3, 2.4):
        visited = step(visited, jnp.float32(x), jnp.float32(0.0), jnp.float32(1.0))
    np.testing.assert_allclose(visited.x, [0.0, 1.2, 2.4])
    assert visited.is_node.all()
    assert int(visited.count) == 3
    visited = step(visited, jnp.float32(9.0), jnp.float32(0.0), jnp.float32(1.0))
    np.testing.assert_allclose(visited.x, [9.0, 1.2, 2.4])


HYDRANT, CONE, CAR, BENCH, TREE = range(5)


def reading_of(types: list[int], relations: list[tuple[int, int, int]]) -> Readings:
    """One reading: types of its mentions; figure, relation and landmark of its relations."""
    edges = [(*one, False) for one in relations]
    return by_hand.readings([types], [edges], sizes=(1, 6, 4))


def sets(readings: Readings) -> list[set[int]]:
    found = np.asarray(components(readings))[:, 0]
    return [{m for m in range(len(found)) if bits >> m & 1} for bits in found]


def test_relations_tie_directly_and_along_chains_and_the_robot_ties_nothing() -> None:
    told = reading_of([HYDRANT, CONE, CAR, BENCH], [(0, BEHIND, 1), (1, NEAR, 2), (3, NONE, NONE)])
    assert sets(told)[:4] == [{0, 1, 2}, {0, 1, 2}, {0, 1, 2}, {3}]
    told = reading_of([HYDRANT] * 6, [(0, NEAR, 1), (2, NEAR, 1), (2, NEAR, 3), (4, NEAR, 3)])
    assert sets(told) == [{0, 1, 2, 3, 4}] * 5 + [{5}]
    told = reading_of([ROBOT, CONE, CAR], [(1, LEFT, 0), (2, LEFT, 0)])
    assert sets(told)[1:3] == [{1}, {2}]


def map_with(seen: dict[int, int]) -> particle.SemanticMap:
    """One particle, trailing axis P = 1: four mentions, those in ``seen`` in observed slots."""
    one = particle.empty(3, 6, jnp.float32(0), jnp.float32(0))
    referent = np.full(6, NONE, np.int32)
    for mention, slot in seen.items():
        referent[mention] = slot
    one = replace(one, referent=jnp.asarray(referent), is_mentioned=jnp.asarray(np.arange(6) < 4))
    return jax.tree.map(lambda leaf: leaf[..., None], one)


def goal_at(slot: int) -> Behavior:
    goal = np.zeros((7, 10, 1), np.float32)
    goal[6, slot] = 1.0
    nothing = jnp.zeros((2, 1))
    return Behavior(
        action=nothing, mode=nothing, goal=jnp.asarray(goal), constraint=jnp.zeros((7, 10, 1))
    )


TOLD = reading_of([HYDRANT, CONE, CAR, BENCH], [(0, BEHIND, 1), (2, NONE, NONE), (3, NONE, NONE)])


def test_what_was_said_of_other_things_keeps_no_goal_from_being_confirmed() -> None:
    """The hydrant and its cone are seen; the car to avoid and the next command's bench are not."""
    belief = map_with({0: 0, 1: 1})
    group = particle_groups(TOLD, belief)
    assert np.asarray(links_to_unseen(group, belief))[:4, 0].tolist() == [False, False, True, True]
    half = map_with({0: 0})
    group = particle_groups(TOLD, half)
    assert np.asarray(links_to_unseen(group, half))[:2, 0].tolist() == [True, True]


def test_only_what_the_goal_is_placed_against_is_looked_for() -> None:
    belief = map_with({0: 0})
    group = particle_groups(TOLD, belief)
    seen = np.asarray(links_to_goal(group, belief, goal_at(0)))[:4, 0]
    assert seen.tolist() == [True, True, False, False]
    hypothesised = np.asarray(links_to_goal(group, belief, goal_at(3 + 3)))[:4, 0]
    assert hypothesised.tolist() == [False, False, False, True]


def test_where_no_mention_is_the_goal_all_of_them_count() -> None:
    """ "The other cone" is none that has been named."""
    belief = map_with({0: 0})
    group = particle_groups(TOLD, belief)
    assert np.asarray(links_to_goal(group, belief, goal_at(2)))[:4, 0].all()
