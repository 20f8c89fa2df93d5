"""Orders and sides ("the second cone", "on your left"): weights by hand, and limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand

from jaxlangnav import relations as rel
from jaxlangnav.messages import BEHIND, FAR, FRONT, LEFT, NEAR, NONE, RIGHT, ROBOT
from jaxlangnav.relations.density import SIDE_CONCENTRATION
from jaxlangnav.semantic_map.coverage import empty_coverage
from jaxlangnav.semantic_map.params import default_map_params
from jaxlangnav.semantic_map.proposal.candidates import Observed, Unexplored
from jaxlangnav.semantic_map.proposal.enumerate import Pairs
from jaxlangnav.semantic_map.proposal.ranks import log_rank, log_viewer_density
from jaxlangnav.semantic_map.proposal.relation_query import Query, Utterances, current_context

CONES = np.array([[4.0, 3.0], [7.0, -3.0], [10.0, 4.0], [0.0, 0.0]], np.float32)
"""Ranges 5, 7.6, 10.8; the third is the leftmost, the second the rightmost; an empty slot."""
UNSEEN = np.float32(0.8)
CONE = 1
MODEL, PARAMS = rel.prepare(rel.default_params()), default_map_params()


def order(relation: int, rank: int, *, known=(0, 1, 2), sides=(), unseen=((20.0, 0.0),) * 2):
    """Build the arguments of ``log_rank`` but for the places: an order among the known cones."""
    types = jnp.array([CONE, ROBOT])
    said = Query(
        mention=jnp.array([0, 1]),
        types=types,
        relation=jnp.int32(relation),
        rank=jnp.int32(rank),
        other=jnp.int32(NONE),
        is_ordinal=jnp.asarray(rank > 0),
        is_rangeless=jnp.asarray(rank > 0),
        sides=jnp.array([*sides, *[NONE] * (3 - len(sides))], jnp.int32),
        pdf=rel.density_of(MODEL, relation),
        viewer=jnp.zeros(3),
        excluded=jnp.zeros(2, jnp.int32),
    )
    is_known = jnp.isin(jnp.arange(4), jnp.array(known))
    seen = Observed(jnp.where(is_known, CONE, NONE), *jnp.asarray(CONES.T))
    scene = Unexplored(
        coverage=empty_coverage(jnp.array([-20.0, 20.0, -20.0, 20.0]), 4),
        first_row=jnp.int32(0),
        log_area=jnp.log(1600.0),
        log_unseen=jnp.log(UNSEEN),
        points=jnp.array(unseen, jnp.float32).T,
    )
    return said, seen, scene


def at(places) -> Pairs:
    zero = jnp.zeros(len(places), jnp.float32)
    x, y = jnp.asarray(places[:, 0]), jnp.asarray(places[:, 1])
    return Pairs(x, y, zero, zero)


@jax.jit
def weigh(one: tuple, places=CONES) -> jax.Array:
    return log_rank(one[0], at(places), *one[1:], params=PARAMS)


@pytest.mark.parametrize(
    ("relation", "rank", "sides", "best"),
    [
        (NEAR, 1, (), 0), (NEAR, 2, (), 1), (NEAR, 3, (), 2), (FAR, 1, (), 2), (FAR, 2, (), 1),
        (LEFT, 1, (), 2), (RIGHT, 1, (), 1), (NEAR, 2, (LEFT,), 2), (NEAR, 2, (LEFT, FRONT), 2),
        (NEAR, 1, (RIGHT,), 1),
    ],
)  # fmt: skip
def test_the_one_of_its_rank_is_free_of_charge(relation, rank, sides, best):
    said, seen, scene = order(relation, rank, sides=sides)
    weights = weigh((said, seen, scene._replace(log_unseen=jnp.float32(-jnp.inf))))[:3]
    assert weights[best] == 0.0
    assert (np.delete(weights, best) < -1.3).all()


def test_no_order_weighs_nothing():
    np.testing.assert_array_equal(weigh(order(NEAR, 0)), 0.0)


def test_what_comes_before_may_be_unseen():
    """e^{−α u q} that the q of the unseen area before the second of two cones has none."""
    nearer, farther = (2.0, 0.0), (20.0, 0.0)
    none = -PARAMS.concentration * UNSEEN
    for unseen, share in (((nearer, farther), 0.5), ((nearer, nearer), 1.0)):
        first, second = weigh(order(NEAR, 2, known=(0, 1), unseen=unseen))[:2]
        np.testing.assert_allclose(second, share * none, rtol=1e-5)
        assert first < -5.0
    one, new = order(NEAR, 2, known=(0,), unseen=(nearer, farther)), CONES[1:2]
    assert weigh(one)[0] < -30.0  # the second of one has not been seen
    np.testing.assert_allclose(weigh(one, new), 0.5 * none + np.log(10.0), rtol=1e-5)


def test_a_rank_is_sought_before_the_observed_one_of_it():
    belief = by_hand.with_objects(by_hand.begin((0.0, 0.0, 0.0)), [(CONE, 5.0, 2.0)])
    said = by_hand.readings([[CONE, ROBOT]], [[(0, LEFT, 1, 1)]])
    told = Utterances(readings=said, context=current_context(said, belief.viewer), params=PARAMS)
    density = log_viewer_density(told, belief, jnp.full(2, 5.0), jnp.array([4.0, -4.0]))[:, 0, 0]
    np.testing.assert_allclose(density, [0.0, np.log(PARAMS.misleading)], atol=1e-5)


def test_a_side_is_normalised_over_directions():
    """However far: 1 / A on average over directions, and by e^2κ likelier ahead than behind."""
    angle = np.linspace(0.0, 2 * np.pi, 720, endpoint=False, dtype=np.float32)
    yes, no = jnp.asarray(True), jnp.asarray(False)
    frame = rel.robot_frame(jnp.float32(0.0))
    for distance in (0.5, 20.0):
        x, y = distance * jnp.cos(angle), distance * jnp.sin(angle)
        for side, ahead in ((FRONT, 0), (LEFT, 180)):
            law = rel.without_range(rel.density_of(MODEL, side), yes, no, jnp.log(50.0))
            weight = 50.0 * np.exp(np.asarray(rel.log_density(law, x, y, frame)))
            np.testing.assert_allclose(weight.mean(), 1.0, rtol=1e-3)
            ratio = weight[ahead] / weight[ahead + 360]
            np.testing.assert_allclose(np.log(ratio), 2 * SIDE_CONCENTRATION, rtol=1e-3)
    # An order alone says nothing of the side, and what is neither stays as it was.
    for relation in (NEAR, LEFT):
        law = rel.without_range(rel.density_of(MODEL, relation), no, yes, jnp.log(50.0))
        np.testing.assert_allclose(rel.log_density(law, x, y, frame), -np.log(50.0), rtol=1e-5)
        same = rel.without_range(rel.density_of(MODEL, relation), no, no, jnp.log(50.0))
        jax.tree.map(np.testing.assert_array_equal, same, rel.density_of(MODEL, relation))


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_sides_turn_with_the_robot(heading):
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    frame = rel.robot_frame(jnp.float32(heading))
    sides = {FRONT: (2, 1), BEHIND: (-2, 1), LEFT: (1, 2), RIGHT: (1, -2)}
    for relation, offset in sides.items():
        x, y = jnp.asarray(turn @ np.array(offset), jnp.float32)
        assert rel.is_on_side(jnp.int32(relation), x, y, frame)
        assert not rel.is_on_side(jnp.int32(relation), -x, -y, frame)
        assert rel.is_on_side(jnp.int32(NONE), x, y, frame)
