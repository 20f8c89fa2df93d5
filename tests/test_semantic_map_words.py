"""Grounding only the particles that need it equals grounding all; doubt is weighed, not drawn."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand

from jaxlangnav.messages import BEHIND, FAR, LEFT, NEAR, NONE
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.proposal.utterance import ground_words

HYDRANT, CONE, CAR = by_hand.HYDRANT, by_hand.CONE, by_hand.CAR
NUMBER = by_hand.CONFIG.num_particles
SENTENCES = [
    by_hand.readings([[HYDRANT]], [[(0, NONE, NONE, False)]]),
    by_hand.readings([[HYDRANT, CONE]], [[(0, BEHIND, 1, False)]]),
    by_hand.readings([[HYDRANT, CONE, CAR]], [[(0, BEHIND, 1, False), (0, LEFT, 2, False)]]),
    by_hand.readings(
        [[HYDRANT, CONE], [HYDRANT, CAR]], [[(0, NEAR, 1, True)], [(0, NEAR, 1, False)]], [0.4, 0.6]
    ),
    by_hand.readings([[HYDRANT, CONE]], [[(0, NEAR, 1, False)]]),
]
"""One for each lane."""


def lanes():
    """Beliefs of unlike viewers, areas, coverage and objects; sentences, keys, who is asked."""
    random = np.random.default_rng(4)
    beliefs = []
    for index in range(len(SENTENCES)):
        belief = by_hand.begin((0.3 * index, 0.2, 0.1 * index), area=(0.0, 8.0 + index, -4.0, 4.0))
        objects = [(HYDRANT, 4.0, 1.0), (CONE, 3.0, -1.0), (CAR, 2.0, 2.0)][: index % 4]
        belief = by_hand.with_coverage(
            by_hand.with_objects(belief, objects), np.log(random.uniform(0.05, 1.0, (32, 32)))
        )
        beliefs.append(belief)
    asked = random.random((len(SENTENCES), NUMBER)) < np.array([[0.0], [0.1], [1.0], [0.5], [0.3]])
    keys = jax.random.split(jax.random.key(1), len(SENTENCES))
    return keys, by_hand.stack(beliefs), by_hand.stack(SENTENCES), jnp.asarray(asked)


@jax.jit
def ground_lane(key, belief, sentence, is_asked, params):
    return ground_words(key, belief, sentence, params=params, is_asked=is_asked)


@functools.partial(jax.jit, static_argnames=("params_axis",))
def ground_lanes(*given, params_axis=None):
    return jax.vmap(ground_lane, in_axes=(0, 0, 0, 0, params_axis))(*given)


def assert_same(found, expected, asked: np.ndarray) -> None:
    """Draws alike, weights to a few ulps (programs round differently), −∞ for who is not asked."""
    np.testing.assert_array_equal(np.asarray(found[1]) == -np.inf, ~asked)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        one, other = np.asarray(one), np.asarray(other)
        shape = len(asked), *(1,) * (one.ndim - 2), NUMBER
        shown = np.broadcast_to(asked.reshape(shape), one.shape)
        if np.issubdtype(one.dtype, np.floating):
            np.testing.assert_allclose(one[shown], other[shown], rtol=2e-6, atol=2e-6)
        else:
            np.testing.assert_array_equal(one[shown], other[shown])


@pytest.mark.slow
def test_grounding_those_asked_equals_grounding_all() -> None:
    given = lanes()
    each = [jax.tree.map(lambda leaf, n=n: leaf[n], given) for n in range(len(SENTENCES))]
    every = by_hand.stack([ground_lane(*one, by_hand.params()) for one in each])
    assert_same(ground_lanes(*given, by_hand.params()), every, np.asarray(given[3]))
    nobody = ground_lanes(*given[:3], given[3] & False, by_hand.params())
    assert (np.asarray(nobody[1]) == -np.inf).all()


def test_lanes_with_numbers_of_their_own() -> None:
    """Parameters that differ from lane to lane are heard: the plain way, and the same result."""
    keys, beliefs, sentences, asked = lanes()
    everyone = jnp.ones_like(asked)
    params = by_hand.stack([by_hand.params(concentration=0.3)] * len(SENTENCES))
    given = (keys, beliefs, sentences, everyone)
    _, apart = ground_lanes(*given, params, params_axis=0)
    _, shared = ground_lanes(*given, by_hand.params(concentration=0.3))
    np.testing.assert_allclose(apart, shared, rtol=1e-4, atol=1e-4)
    rising = 0.3 + 0.5 * np.arange(len(SENTENCES), dtype=np.float32)
    params = replace(params, concentration=rising)
    _, moved = ground_lanes(*given, params, params_axis=0)
    differs = (np.abs(np.asarray(moved - apart)) > 1e-3).any(1)
    # Without anything seen there is nothing that a density of bystanders could weigh against.
    assert not differs[0]
    assert differs[[1, 2, 3]].all()


def test_what_only_misleading_words_explain_is_in_every_particle() -> None:
    """A hydrant stands where no cone can be in front of it: is it meant all the same?

    All but the far end has been seen: the sentence misleads, or hydrant and cone are to be found.
    Drawn by each particle, the share of the first varied by 0.30 of itself; weighed, by 0.16.
    """
    sentence = SENTENCES[1]
    belief = by_hand.with_objects(by_hand.begin(), [(HYDRANT, 3.0, 0.0)])
    miss = np.full((32, 32), 1e-9)
    miss[:, 24:] = 1.0  # x > 7.5 m
    belief = by_hand.with_coverage(belief, np.log(miss))
    keys = jax.random.split(jax.random.key(5), by_hand.SEEDS)
    params = by_hand.params(concentration=0.3)
    particles, log_weight = by_hand.ground_many(keys, belief, sentence, params)
    weight = np.exp(np.asarray(log_weight, float))
    is_it = np.asarray(particles.referent[:, 0]) == 0
    share = (is_it * weight).sum(1) / weight.sum(1)
    # ε u / α against (1 − ε) u E[m] + ε u², with u = 1/4 and E[m] between 0 and 1, in part outside.
    epsilon, unseen = float(params.misleading), 0.25
    low = epsilon / 0.3 / (epsilon / 0.3 + 1 - epsilon + epsilon * unseen)
    assert low < share.mean() < 1.0
    assert share.std() < 0.25 * share.mean()


def test_misleading_words_are_never_certain() -> None:
    """The paper's own policy takes every word to be true: ε = 0, and nothing breaks."""
    belief = by_hand.with_objects(by_hand.begin(), [(HYDRANT, 3.0, 0.0)])
    params = replace(by_hand.params(), misleading=jnp.float32(0.0))
    keys = jax.random.split(jax.random.key(6), by_hand.SEEDS)
    particles, log_weight = by_hand.ground_many(keys, belief, SENTENCES[1], params)
    assert not np.isnan(np.asarray(log_weight)).any()
    # Whatever is only hypothesised hangs on what it was placed against.
    hung = np.asarray(particles.anchor[:, 0] != NONE) | np.asarray(particles.referent[:, 0] == 0)
    weight = np.exp(np.asarray(log_weight, float))
    assert (weight * hung).sum() == pytest.approx(weight.sum(), rel=1e-5)


@pytest.mark.parametrize(("objects", "low", "high"), [(1, 0.0, 0.3), (2, 0.3, 1.0)])
def test_the_farthest_is_not_the_only_one_beside_its_landmark(objects, low, high) -> None:
    """Hardly anything seen but a car, a hydrant beside it, and one that stands far off or not."""
    things = [(HYDRANT, 6.0, 0.0), (HYDRANT, 1.0, -4.0)][:objects]
    belief = by_hand.with_objects(by_hand.begin(), [*things, (CAR, 5.0, 0.5)])
    sentence = by_hand.readings([[HYDRANT, CAR]], [[(0, FAR, 1, True)]])
    keys = jax.random.split(jax.random.key(7), by_hand.SEEDS)
    particles, log_weight = by_hand.ground_many(keys, belief, sentence, by_hand.params())
    weight = np.exp(np.asarray(log_weight, float))
    referent = np.asarray(particles.referent[:, 0])
    shares = [((referent == slot) * weight).sum() / weight.sum() for slot in range(objects)]
    assert low < shares[-1] < high, shares
    assert sum(shares[:-1]) < 0.1, shares
    # One that is unseen is anywhere, and not looked for beside the car alone.
    assert (np.asarray(particles.anchor[:, 0]) == NONE).all()
