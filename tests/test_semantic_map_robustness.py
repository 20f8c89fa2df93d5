"""No silent death: contradictions, overflow, NaN, no noise, everything refuted."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand

from jaxlangnav.messages import BEHIND, FRONT, NONE, ROBOT, Fault
from jaxlangnav.pytree import replace

HYDRANT, CONE = by_hand.HYDRANT, by_hand.CONE
BEHIND_CONE = by_hand.readings([[HYDRANT, CONE]], [[(0, BEHIND, 1, False)]])


def follow(looks: list, sentence=BEHIND_CONE, numbers=None, belief=None, seed: int = 0):
    """Run looks (a multiple of STEPS) in all lanes; return beliefs and stacked infos."""
    beliefs, infos = by_hand.repeat(belief or by_hand.begin(), by_hand.SEEDS), []
    assert len(looks) % by_hand.STEPS == 0
    for call in range(len(looks) // by_hand.STEPS):
        part = by_hand.stack(looks[call * by_hand.STEPS : (call + 1) * by_hand.STEPS])
        beliefs, info = by_hand.run_many(
            jax.random.split(jax.random.key(seed + call), by_hand.SEEDS),
            beliefs,
            by_hand.repeat(sentence, by_hand.SEEDS),
            by_hand.repeat(part, by_hand.SEEDS),
            numbers or by_hand.params(),
        )
        infos.append(jax.tree.map(np.asarray, info))
    return beliefs, jax.tree.map(lambda *leaves: np.concatenate(leaves, 1), *infos)


def sweep(rounds: int) -> list[tuple[float, float]]:
    """Places from which a robot with 3 m of sight sees all of the area, 24 a round."""
    places = []
    for index, x in enumerate(np.linspace(1, 9, 6)):
        ys = np.linspace(-4, 4, 4) if index % 2 == 0 else np.linspace(4, -4, 4)
        places += [(x, y) for y in ys]
    return places * rounds


def assert_sound(beliefs) -> None:
    """Weights sum to one, everything is finite, referents are objects that exist."""
    weight = np.exp(np.asarray(beliefs.log_weight, float))
    np.testing.assert_allclose(weight.sum(-1), 1.0, rtol=1e-3)
    particles = jax.tree.map(np.asarray, beliefs.particles)
    for leaf in jax.tree.leaves(particles):
        if leaf.dtype.kind == "f":
            assert np.isfinite(leaf).all()
    exists = particles.is_observed
    for mention in range(particles.referent.shape[1]):
        slot = particles.referent[:, mention]
        is_there = np.take_along_axis(exists, np.maximum(slot, 0)[:, None], 1)[:, 0]
        assert ((slot == NONE) | is_there | (weight < 1e-9)).all()


def test_refuted_hypotheses_revive_where_they_may_still_be() -> None:
    """An empty area looked at twice over: hypotheses live on, inside, and no ghost is believed."""
    looks = [by_hand.observation(np.array([x, y, 0.0]), []) for x, y in sweep(2)]
    beliefs, info = follow(looks)
    assert_sound(beliefs)
    assert not info.fault.any()
    weight = np.exp(np.asarray(beliefs.log_weight))
    particles = beliefs.particles
    open_mass = (weight * np.asarray(particles.is_hypothesised[:, 0])).sum(-1)
    np.testing.assert_allclose(open_mass, 1.0, rtol=1e-3)
    x, y = np.asarray(particles.hypothesis_x[:, 0]), np.asarray(particles.hypothesis_y[:, 0])
    inside = (x >= 0) & (x <= 10) & (np.abs(y) <= 5)
    assert ((weight * inside).sum(-1) > 0.99).all()
    # They keep being many: no particle takes everything. (12 to 15 here, in a look that refutes two
    # thirds of them: they lie all over what is unseen and not in the few places last drawn.)
    assert np.median(info.effective_sample_size[:, -1]) > 8
    # However little is left unseen, what the words weigh there is known to within a factor.
    assert info.log_language_evidence[:, -1].std() < 1.0


def test_figure_is_found_after_everything_was_refuted() -> None:
    """The hydrant was missed all along: when it is seen at last, it is believed."""
    looks = [by_hand.observation(np.array([x, y, 0.0]), []) for x, y in sweep(1)]
    pose = np.array([5.0, 0.0, 0.0])
    looks += [by_hand.observation(pose, [(CONE, 1.0, 0.1), (HYDRANT, 2.5, 0.2)])] * 8
    beliefs, info = follow(looks)
    assert_sound(beliefs)
    assert info.surprise[:, 24].min() > 5.0, "it was looked for there before"
    assert info.surprise[:, 25:].max() < 5.0
    weight = np.exp(np.asarray(beliefs.log_weight))
    hydrant = np.asarray(beliefs.particles.object_type) == HYDRANT
    referent = np.asarray(beliefs.particles.referent[:, 0])
    is_it = np.take_along_axis(hydrant, np.maximum(referent, 0)[:, None], 1)[:, 0]
    assert ((weight * (is_it & (referent >= 0))).sum(-1) > 0.9).all()


def test_detections_that_contradict_each_other() -> None:
    """Objects that jump about and vanish in plain view: counted, finite, never dead."""
    random = np.random.default_rng(0)
    pose = np.array([5.0, 0.0, 0.0])
    looks = [
        by_hand.observation(
            pose,
            [(int(random.integers(3)), *random.uniform(-2.0, 2.0, 2)) for _ in range(step % 4)],
            by_hand.sensor(noise=0.02, probability=1.0),
        )
        for step in range(4 * by_hand.STEPS)
    ]
    beliefs, info = follow(looks)
    assert_sound(beliefs)
    # They contradict what was seen before, and soon there are more "objects" than slots: both
    # are said, every step by one of them once the place is well known.
    assert info.overflow.sum() > 0
    is_said = info.is_contradiction | (info.overflow > 0)
    assert is_said[:, by_hand.STEPS :].mean() > 0.8
    assert info.is_contradiction.any(axis=1).all()


def test_more_objects_than_slots_are_counted() -> None:
    places = [(HYDRANT, 0.9 * np.cos(turn), 0.9 * np.sin(turn)) for turn in np.arange(6)]
    more = [(CONE, 2.2 * np.cos(turn), 2.2 * np.sin(turn)) for turn in np.arange(6)]
    pose, specification = np.array([5.0, 0.0, 0.0]), by_hand.sensor(noise=0.02)
    looks = [by_hand.observation(pose, part, specification) for part in (places, more)] * 4
    beliefs, info = follow(looks)
    assert_sound(beliefs)
    assert (info.overflow[:, 0] == 0).all()
    assert (info.overflow[:, 1] == 6).all()
    # No slot was overwritten.
    assert (np.asarray(beliefs.particles.object_type) == HYDRANT).all()


@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_no_noise_at_all(noise: float) -> None:
    """Neither sensor nor odometry errs, everything is always detected."""
    specification = by_hand.sensor(noise=noise, probability=1.0)
    objects, looks = [(CONE, 4.0, 0.5), (HYDRANT, 6.0, 0.8)], []
    for step in range(2 * by_hand.STEPS):
        x = 0.3 * step
        found = [(name, there - x, y) for name, there, y in objects if np.hypot(there - x, y) < 3.0]
        looks.append(by_hand.observation(np.array([x, 0.0, 0.0]), found, specification))
    beliefs, info = follow(looks, numbers=by_hand.params(odometry_noise=0.0))
    assert_sound(beliefs)
    assert not info.fault.any()
    assert not info.is_contradiction.any()
    particles = jax.tree.map(np.asarray, beliefs.particles)
    for slot, (name, x, y) in enumerate(objects):
        assert (particles.object_type[:, slot] == name).all()
        np.testing.assert_allclose(particles.mean_x[:, slot], x, atol=0.02)
        np.testing.assert_allclose(particles.mean_y[:, slot], y, atol=0.02)
    weight = np.exp(np.asarray(beliefs.log_weight))
    assert ((weight * (particles.referent[:, 0] == 1)).sum(-1) > 0.9).all()


def test_certain_detection_and_a_vanished_object() -> None:
    """p_d = 1 and an object that is gone: log(1 − p_d) is kept finite."""
    specification = by_hand.sensor(probability=1.0)
    pose = np.array([5.0, 0.0, 0.0])
    looks = [by_hand.observation(pose, [(CONE, 1.0, 0.0)], specification)]
    looks += [by_hand.observation(pose, [], specification)] * 7
    beliefs, info = follow(looks)
    assert_sound(beliefs)
    assert not info.fault.any()


def test_garbage_where_there_is_no_detection_changes_nothing() -> None:
    pose = np.array([5.0, 0.0, 0.0])
    good = by_hand.observation(pose, [(CONE, 1.0, 0.1), (HYDRANT, 2.4, 0.2)])
    names, ranges = np.array(good.detection_type), np.array(good.detection_range)
    bearings = np.array(good.detection_bearing)
    names[2:], ranges[2:], bearings[2:] = HYDRANT, np.nan, np.inf
    bad = replace(good, detection_type=names, detection_range=ranges, detection_bearing=bearings)
    clean, _ = follow([good] * 8)
    dirty, _ = follow([bad] * 8)
    for ours, theirs in zip(jax.tree.leaves(clean), jax.tree.leaves(dirty), strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("dead", [-np.inf, np.nan])
def test_dead_weights_are_counted_and_made_alive(dead: float) -> None:
    belief = replace(
        by_hand.begin(),
        log_weight=jnp.full(by_hand.CONFIG.num_particles, dead),
        must_ground=jnp.asarray(False),
    )
    looks = [by_hand.observation(np.array([5.0, 0.0, 0.0]), [])] * 8
    beliefs, info = follow(looks, belief=belief)
    assert_sound(beliefs)
    assert (info.fault[:, 0] == Fault.WEIGHTS).all()
    assert not info.fault[:, 1:].any()
    assert np.isfinite(np.asarray(beliefs.coverage.log_miss)).all()


def test_one_dead_weight_among_good_ones() -> None:
    number = by_hand.CONFIG.num_particles
    log_weight = jnp.full(number, -jnp.log(number - 1.0)).at[0].set(-jnp.inf)
    belief = replace(by_hand.begin(), log_weight=log_weight)
    looks = [by_hand.observation(np.array([5.0, 0.0, 0.0]), [])] * 8
    beliefs, info = follow(looks, belief=belief)
    assert_sound(beliefs)
    assert not info.fault.any()


def test_words_that_nothing_can_satisfy() -> None:
    """ "In front of you", told at the edge of the area facing out: nowhere is possible."""
    sentence = by_hand.readings([[HYDRANT, ROBOT]], [[(0, FRONT, 1, False)]])
    looks = [by_hand.observation(np.array([0.0, 0.0, np.pi]), [(HYDRANT, 1.0, 0.0)])] * 8
    beliefs, _ = follow(looks, sentence, belief=by_hand.begin((0.0, 0.0, np.pi)))
    assert_sound(beliefs)


def test_no_words() -> None:
    """A reading that mentions nothing leaves a plain map."""
    looks = [by_hand.observation(np.array([5.0, 0.0, 0.0]), [(CONE, 1.0, 0.1)])] * 8
    beliefs, _ = follow(looks, by_hand.readings([[]], [[]]))
    assert_sound(beliefs)
    assert not np.asarray(beliefs.particles.is_mentioned).any()
    assert (np.asarray(beliefs.particles.object_type)[:, 0] == CONE).all()
