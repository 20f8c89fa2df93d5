"""Padding laws, batch laws, trace counts and gradients of the filter."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from readings import central
from test_semantic_map_enumeration import CASES, OBJECTS, VIEWER, by_category

from jaxlangnav.messages import BEHIND, NEAR, NONE
from jaxlangnav.pytree import replace
from jaxlangnav.relations import RelationParams, default_params, prepare
from jaxlangnav.semantic_map.params import MapConfig
from jaxlangnav.semantic_map.proposal.utterance import ground_words

HYDRANT, CONE, CAR = by_hand.HYDRANT, by_hand.CONE, by_hand.CAR
KINDS, EDGES = [HYDRANT, CONE], [(0, BEHIND, 1, False)]
PLACES = [(CONE, 3.5, 0.8), (HYDRANT, 5.9, 1.0), (CONE, 4.0, -2.4), (HYDRANT, 1.8, 2.6)]


def looks(places=PLACES, number: int = by_hand.STEPS, seed: int = 0, size: int = by_hand.D):
    """Drive ahead and see what is within 2.8 m, with noise."""
    random, result = np.random.default_rng(seed), []
    for step in range(number):
        pose = np.array([0.7 * step, 0.1 * step, 0.1])
        found = [
            (name, x - pose[0] + random.normal(0, 0.1), y - pose[1] + random.normal(0, 0.1))
            for name, x, y in places
            if np.hypot(x - pose[0], y - pose[1]) < 2.8
        ]
        result.append(by_hand.observation(pose, found, size=size))
    return result


NUMBERS = by_hand.params(concentration=1.0)


def run(beliefs, sentence, observations, seed: int = 0):
    return by_hand.run_lanes(observations, sentence, NUMBERS, beliefs, seed=seed)[0]


def in_a_loop(key, belief, sentence, observations):
    """One lane of ``run``, a step at a time: its end, and the sample sizes on the way."""
    sizes = []
    for one, look in zip(jax.random.split(key, len(observations)), observations, strict=True):
        belief, info = by_hand.step_one(one, belief, sentence, look, params=NUMBERS)
        sizes.append(float(info.effective_sample_size))
    return belief, sizes


def share_alike(ours, theirs, **slots: int) -> float:
    """Measure in which share of the particles weights, and so many slots of each field, agree."""
    same = np.isclose(ours.log_weight, theirs.log_weight, rtol=1e-3, atol=1e-3)
    for name, number in slots.items():
        one, other = (np.asarray(getattr(of.particles, name))[:number] for of in (ours, theirs))
        same &= np.isclose(one, other, rtol=1e-3, atol=1e-3).all(0)
    return same.mean()


@pytest.mark.slow
def test_more_slots_change_nothing() -> None:
    """Half the object and fewer mention, reading and relation slots: the same beliefs."""
    config = MapConfig(num_particles=64, num_objects=3, num_cells=32)
    assert 2 * config.num_objects == by_hand.CONFIG.num_objects
    tight = by_hand.readings([KINDS], [EDGES], sizes=(1, 2, 1))
    shares = []
    for seed in range(12):
        seen, key = looks(PLACES[:3], seed=seed), jax.random.key(seed)
        large, _ = in_a_loop(key, by_hand.begin(), by_hand.readings([KINDS], [EDGES]), seen)
        small, _ = in_a_loop(key, by_hand.begin(config=config, num_mentions=2), tight, seen)
        shares.append(share_alike(small, large, mean_x=3, mean_y=3, hypothesis_x=2, referent=2))
        np.testing.assert_allclose(small.log_evidence, large.log_evidence, rtol=1e-3)
        assert (np.asarray(large.particles.object_type)[3:] == NONE).all()
    # Two compiled programs round differently: a draw in a thousand may fall to the other side.
    assert np.mean(shares) > 0.98, shares


@pytest.mark.slow
def test_more_detection_slots_change_nothing_but_chance() -> None:
    sentence = by_hand.readings([KINDS], [EDGES])
    small = run(by_hand.begin(), sentence, looks())
    large = run(by_hand.begin(), sentence, looks(size=2 * by_hand.D), seed=1)
    shares = []
    for belief in (small, large):
        known = np.asarray(belief.particles.referent[:, :2]) >= 0
        shares.append((np.exp(np.asarray(belief.log_weight))[:, None] * known).sum(-1))
    gap = shares[0].mean(0) - shares[1].mean(0)
    error = np.sqrt((shares[0].var(0) + shares[1].var(0)) / by_hand.SEEDS)
    assert (np.abs(gap) <= 5 * error + 1e-3).all()
    np.testing.assert_allclose(small.log_evidence.mean(), large.log_evidence.mean(), atol=0.05)


def test_garbage_in_empty_slots_changes_nothing() -> None:
    """Places of empty slots, and of mentions that the reading has not, are never read."""
    clean = by_hand.with_objects(by_hand.begin(), PLACES[:2])
    noise = jax.random.normal(jax.random.key(9), clean.particles.covariance.shape)
    is_empty = (jnp.arange(7) >= 2) & (jnp.arange(7) < 6)
    is_garbled = (is_empty[:, None] | is_empty[None])[..., None]
    garbled = jnp.where(is_garbled, noise, clean.particles.covariance)
    dirty_particles = replace(
        clean.particles,
        mean_x=clean.particles.mean_x.at[2:6].set(3.3),
        mean_y=clean.particles.mean_y.at[2:6].set(0.5),
        covariance=garbled,
        hypothesis_x=clean.particles.hypothesis_x.at[2].set(-4.0),
        referent=clean.particles.referent.at[2].set(1),
        root=clean.particles.root.at[2].set(1),
    )
    sentence, dirty_sentence = (by_hand.readings([KINDS], [EDGES]) for _ in range(2))
    dirty_sentence = replace(
        dirty_sentence,
        landmark=dirty_sentence.landmark.at[0, 1].set(1),
        relation=dirty_sentence.relation.at[0, 1].set(NEAR),
        rank=dirty_sentence.rank.at[0, 1].set(1),
        figure=dirty_sentence.figure.at[1, 0].set(2),
    )
    ours = run(clean, sentence, looks())
    theirs = run(replace(clean, particles=dirty_particles), dirty_sentence, looks())
    np.testing.assert_array_equal(ours.log_weight, theirs.log_weight)
    np.testing.assert_array_equal(ours.particles.object_type, theirs.particles.object_type)
    filled = np.asarray(ours.particles.object_type) != NONE
    filled = np.concatenate([filled, np.ones_like(filled[:, :1])], axis=1)
    both = filled[:, :, None] & filled[:, None]
    for name, mask in (("mean_x", filled), ("mean_y", filled), ("covariance", both)):
        left, right = getattr(ours.particles, name), getattr(theirs.particles, name)
        np.testing.assert_array_equal(np.asarray(left)[mask], np.asarray(right)[mask])
    np.testing.assert_array_equal(ours.particles.referent[:, :2], theirs.particles.referent[:, :2])


def test_permuted_slots_permute_the_result() -> None:
    """The Gaussian exactly, what the words mean up to chance."""
    order = [2, 0, 3, 1]
    sentence, prior = by_hand.readings([KINDS], [EDGES]), by_hand.begin(VIEWER)
    known = [PLACES, [PLACES[index] for index in order]]
    still = looks()[:1] * by_hand.STEPS
    beliefs = [run(by_hand.with_objects(prior, places), sentence, still) for places in known]
    shares = []
    for belief, places in zip(beliefs, known, strict=True):
        weight = np.exp(np.asarray(belief.log_weight, float))
        particles = jax.tree.map(np.asarray, belief.particles)
        shares.append(by_category(particles, weight * weight.shape[-1], 5, 2).reshape(-1, 5, 5))
        assert (particles.object_type[:, :4, 0] == [name for name, _, _ in places]).all()
    for name in ("mean_x", "mean_y"):
        ours = np.asarray(getattr(beliefs[0].particles, name))[:, order]
        theirs = np.asarray(getattr(beliefs[1].particles, name))[:, :4]
        np.testing.assert_allclose(ours, theirs, atol=1e-3)
    rows = [*order, 4]
    first = shares[0][:, rows][:, :, rows]
    gap = first.mean(0) - shares[1].mean(0)
    error = np.sqrt((first.var(0) + shares[1].var(0)) / by_hand.SEEDS)
    assert (np.abs(gap) <= 5 * error + 2e-3).all()


def test_lanes_equal_a_python_loop() -> None:
    """``vmap`` and ``scan`` against one compiled step called in a loop, lanes made different."""
    lanes, compared = by_hand.SEEDS, 3
    names = list(CASES)[:compared]
    sentences = [by_hand.readings([CASES[n][0]], [CASES[n][1]]) for n in names]
    worlds = [looks(PLACES[: 2 + lane], seed=lane) for lane in range(compared)]
    keys = jax.random.split(jax.random.key(5), lanes)
    batched, info = by_hand.run_many(
        keys,
        by_hand.repeat(by_hand.begin(), lanes),
        by_hand.stack([sentences[lane % compared] for lane in range(lanes)]),
        by_hand.stack([by_hand.stack(worlds[lane % compared]) for lane in range(lanes)]),
        NUMBERS,
    )
    for lane in range(compared):
        alone, sizes = in_a_loop(keys[lane], by_hand.begin(), sentences[lane], worlds[lane])
        own = jax.tree.map(lambda leaf, lane=lane: leaf[lane], batched)
        assert share_alike(alone, own, mean_x=7, hypothesis_x=3, referent=3) > 0.95
        np.testing.assert_allclose(sizes, info.effective_sample_size[lane], rtol=0.02)


def log_evidence(params: RelationParams, key: jax.Array, belief, sentence) -> jax.Array:
    numbers = replace(by_hand.params(concentration=3.0), relations=prepare(params))
    _, log_weight = ground_words(key, belief, sentence, params=numbers)
    return jax.nn.logsumexp(log_weight) - jnp.log(log_weight.shape[0])


@jax.jit
def evidence_and_slope(start, tangent, key, belief, sentence):
    return jax.jvp(lambda params: log_evidence(params, key, belief, sentence), (start,), (tangent,))


@pytest.mark.parametrize("name", ["behind", "nearest"])
def test_gradient_of_the_evidence_equals_finite_differences(name: str) -> None:
    """Common random numbers; in few keys a draw crosses an edge, where there is no derivative."""
    wide = by_hand.begin(VIEWER, area=(-20.0, 30.0, -25.0, 25.0))
    belief = by_hand.with_objects(wide, OBJECTS)
    sentence = by_hand.readings([CASES[name][0]], [CASES[name][1]])
    start, relation = default_params(), CASES[name][1][0][1]
    unit = jnp.zeros(6).at[relation].set(1.0)
    for field in ("log_distance", "log_distance_sd", "axis", "concentration"):
        tangent = replace(jax.tree.map(jnp.zeros_like, start), **{field: unit})

        def moved(by: float, key: jax.Array, field: str = field, tangent=tangent) -> tuple:
            numbers = replace(start, **{field: getattr(start, field) + by * unit})
            return evidence_and_slope(numbers, tangent, key, belief, sentence)

        found = []
        for key in jax.random.split(jax.random.key(3), 8):
            slope = float(moved(0.0, key)[1])
            assert np.isfinite(slope)
            difference, error = central(lambda by, moved=moved, key=key: moved(by, key)[0], 5e-3)
            found.append((difference, slope, error))
        if field == "concentration" and name == "nearest":
            continue  # κ = 0 is the edge of what is allowed
        agree = [abs(near - slope) < error + 0.01 * abs(slope) for near, slope, error in found]
        assert sum(agree) >= 6, (field, found)
        assert any(slope for _, slope, _ in found)
