"""Padding laws, batch laws, trace counts and gradients of the filter."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from differences import central
from test_semantic_map_enumeration import CASES, OBJECTS, VIEWER, by_category

from jaxlangnav.messages import BEHIND, NEAR, NONE
from jaxlangnav.pytree import replace
from jaxlangnav.relations import RelationParams, default_params, prepare
from jaxlangnav.semantic_map import particle as particle_module
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


def run(beliefs, sentence, observations, seed: int = 0):
    numbers = by_hand.params(concentration=1.0)
    return by_hand.run_lanes(observations, sentence, numbers, beliefs, seed=seed)[0]


def in_a_loop(belief, sentence, observations, seed: int):
    """One lane of ``run``, a step at a time."""
    keys = jax.random.split(jax.random.key(seed), len(observations))
    for key, look in zip(keys, observations, strict=True):
        belief, _ = by_hand.step_one(
            key, belief, sentence, look, params=by_hand.params(concentration=1.0)
        )
    return belief


def test_more_slots_change_nothing() -> None:
    """Half the object and fewer mention, reading and relation slots: the same beliefs."""
    config = MapConfig(num_particles=64, num_objects=3, num_cells=32)
    assert 2 * config.num_objects == by_hand.CONFIG.num_objects
    tight = by_hand.readings([KINDS], [EDGES], sizes=(1, 2, 1))
    shares = []
    for seed in range(12):
        seen = looks(PLACES[:3], seed=seed)
        large = in_a_loop(by_hand.begin(), by_hand.readings([KINDS], [EDGES]), seen, seed)
        small = in_a_loop(by_hand.begin(config=config, num_mentions=2), tight, seen, seed)
        same = np.isclose(small.log_weight, large.log_weight, rtol=1e-3, atol=1e-3)
        for name, slots in (("mean_x", 3), ("mean_y", 3), ("hypothesis_x", 2), ("referent", 2)):
            ours = np.asarray(getattr(small.particles, name))[:slots]
            theirs = np.asarray(getattr(large.particles, name))[:slots]
            same &= np.isclose(ours, theirs, rtol=1e-3, atol=1e-3).all(0)
        shares.append(same.mean())
        np.testing.assert_allclose(small.log_evidence, large.log_evidence, rtol=1e-3)
        assert (np.asarray(large.particles.object_type)[3:] == NONE).all()
    # Two compiled programs round differently: a draw in a thousand may fall to the other side.
    assert np.mean(shares) > 0.98, shares


@pytest.mark.slow
def test_more_detection_slots_change_nothing_but_chance() -> None:
    small = run(by_hand.begin(), by_hand.readings([KINDS], [EDGES]), looks())
    large = run(
        by_hand.begin(), by_hand.readings([KINDS], [EDGES]), looks(size=2 * by_hand.D), seed=1
    )
    shares = []
    for belief in (small, large):
        weight = np.exp(np.asarray(belief.log_weight))
        referent = np.asarray(belief.particles.referent[:, :2])
        known = (weight[:, None] * (referent >= 0)).sum(-1)
        shares.append(known)
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
        by_hand.params(),
    )
    for lane in range(compared):
        belief = by_hand.begin()
        sizes = []
        for key, look in zip(
            jax.random.split(keys[lane], by_hand.STEPS), worlds[lane], strict=True
        ):
            belief, one = by_hand.step_one(
                key, belief, sentences[lane], look, params=by_hand.params()
            )
            sizes.append(float(one.effective_sample_size))
        ours = np.asarray(belief.log_weight)
        same = np.isclose(ours, np.asarray(batched.log_weight)[lane], atol=1e-3)
        for name in ("mean_x", "hypothesis_x", "referent"):
            left = np.asarray(getattr(belief.particles, name))
            right = np.asarray(getattr(batched.particles, name))[lane]
            same &= np.isclose(left, right, rtol=1e-3, atol=1e-3).all(0)
        assert same.mean() > 0.95
        np.testing.assert_allclose(sizes, info.effective_sample_size[lane], rtol=0.02)


def test_new_words_leave_the_weights_of_the_maps_as_they_were() -> None:
    """All particles have to ground the words, and no map fits them better: what weighed stays."""
    belief, number = by_hand.begin(), by_hand.CONFIG.num_particles
    prior = np.linspace(1.0, 5.0, number) / np.linspace(1.0, 5.0, number).sum()
    belief = replace(belief, log_weight=jnp.log(jnp.asarray(prior, jnp.float32)))
    look = by_hand.observation(np.zeros(3), [])
    after, info = by_hand.step_one(
        jax.random.key(3), belief, by_hand.NULL, look, params=by_hand.params(threshold=0.0)
    )
    assert int(info.num_regrounded) == number
    np.testing.assert_allclose(np.exp(after.log_weight), prior, rtol=1e-3)


def test_step_is_compiled_once_for_any_numbers() -> None:
    """New sentences, ranges, noises and parameters are data."""
    belief, sizes = by_hand.begin(), []
    for index, name in enumerate(list(CASES)[:5]):
        look = by_hand.observation(
            np.array([0.5 * index, 0.0, 0.0]),
            [(index % 3, 1.0, 0.5)] * (index % 2),
            by_hand.sensor(range_max=2.0 + index, noise=0.05 * index, probability=0.9),
        )
        belief, _ = by_hand.step_one(
            jax.random.key(index),
            belief,
            by_hand.readings([CASES[name][0]], [CASES[name][1]]),
            look,
            params=by_hand.params(concentration=0.1 + index, odometry_noise=0.01 * index),
        )
        sizes.append(by_hand.step_one._cache_size())
    assert len(set(sizes)) == 1


def log_evidence(params: RelationParams, key: jax.Array, belief, sentence) -> jax.Array:
    numbers = replace(by_hand.params(concentration=3.0), relations=prepare(params))
    _, log_weight = ground_words(key, belief, sentence, params=numbers)
    return jax.nn.logsumexp(log_weight) - jnp.log(log_weight.shape[0])


@jax.jit
def evidence_and_slope(start, tangent, key, belief, sentence):
    return jax.jvp(lambda params: log_evidence(params, key, belief, sentence), (start,), (tangent,))


@pytest.mark.parametrize("name", ["behind", "nearest"])
def test_gradient_of_the_evidence_equals_finite_differences(name: str) -> None:
    """Forward mode through the loop over relations, common random numbers.

    The area is wide: what is drawn hardly ever leaves it or its cells, whose edges have no
    derivative. Where it does, in few of the keys, the difference is off.
    """
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


def test_joint_gaussian_holds_hypotheses_by_their_anchors() -> None:
    """Σ of the whole map: a hypothesis on a seen cone moves with it, plus the kernel; one that
    hangs on a hypothesis has the kernel twice, and shares the first."""
    belief = by_hand.with_objects(by_hand.begin(), PLACES[:1], variance=0.04)
    one = jax.tree.map(lambda leaf: leaf[..., 0], belief.particles)
    one = replace(
        one,
        is_mentioned=jnp.array([True, True, True]),
        referent=jnp.array([NONE, 0, NONE]),
        # The last hangs on the first, the first on the seen cone.
        anchor=jnp.array([0, NONE, by_hand.CONFIG.num_objects]),
        root=jnp.array([0, NONE, 0]),
        hypothesis_x=jnp.array([5.0, 0.0, 9.0]),
    )
    covariance, x, _ = jax.jit(particle_module.joint_gaussian)(one, jnp.float32(0.01))
    covariance = np.asarray(covariance)
    figure = by_hand.CONFIG.num_objects
    assert abs(covariance[0, 0] - 0.04) < 1e-4
    assert abs(covariance[figure, figure] - 0.05) < 1e-4
    assert abs(covariance[figure, 0] - 0.04) < 1e-4
    assert abs(float(x[figure]) - 5.0) < 1e-6
    child = figure + 2
    assert abs(covariance[child, child] - 0.06) < 1e-4
    assert abs(covariance[child, figure] - 0.05) < 1e-4
    assert abs(covariance[child, 0] - 0.04) < 1e-4
    # Slots of nothing stay apart.
    others = [index for index in range(len(x)) if index not in (0, figure, child)]
    assert np.abs(covariance[np.ix_([0, figure, child], others)]).max() == 0.0
    assert abs(covariance[-1, -1] - particle_module.START_VARIANCE) < 1e-9
    retracted = replace(one, referent=jnp.array([NONE, 0, 0]))
    covariance, _, _ = particle_module.joint_gaussian(retracted, jnp.float32(0.01))
    assert np.abs(np.asarray(covariance)[child]).max() == 0.0
    on_the_ground = replace(one, anchor=jnp.array([NONE] * 3), root=jnp.array([NONE] * 3))
    covariance, _, _ = particle_module.joint_gaussian(on_the_ground, jnp.float32(0.01))
    np.testing.assert_allclose(np.asarray(covariance)[figure, figure], 0.01, rtol=1e-5)
    assert np.count_nonzero(np.asarray(covariance)[figure]) == 1
