"""No silent death: contradictions, overflow, NaN; what cannot be is left out, said, forgotten."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from hostile import MUTATIONS

from jaxlangnav.messages import BEHIND, FRONT, NONE, ROBOT, Fault
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import gating
from jaxlangnav.semantic_map.motion import predict

HYDRANT, CONE = by_hand.HYDRANT, by_hand.CONE
BEHIND_CONE = by_hand.readings([[HYDRANT, CONE]], [[(0, BEHIND, 1, False)]])


POSE = np.array([5.0, 0.0, 0.0])


def look(*found: tuple[int, float, float], pose: np.ndarray = POSE, **sensor: float):
    return by_hand.observation(pose, list(found), by_hand.sensor(**sensor))


def follow(looks: list, sentence=BEHIND_CONE, belief=None, **numbers: float):
    """Look on, a multiple of STEPS times, in all lanes: sound beliefs, and stacked infos."""
    beliefs, infos = by_hand.run_lanes(looks, sentence, by_hand.params(**numbers), belief)
    assert_sound(beliefs)
    return beliefs, infos


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
    beliefs, info = follow([look(pose=np.array([x, y, 0.0])) for x, y in sweep(2)])
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
    looks = [look(pose=np.array([x, y, 0.0])) for x, y in sweep(1)]
    beliefs, info = follow([*looks, *[look((CONE, 1.0, 0.1), (HYDRANT, 2.5, 0.2))] * 8])
    assert info.surprise[:, 24].min() > 5.0, "it was looked for there before"
    assert info.surprise[:, 25:].max() < 5.0
    weight = np.exp(np.asarray(beliefs.log_weight))
    hydrant = np.asarray(beliefs.particles.object_type) == HYDRANT
    referent = np.asarray(beliefs.particles.referent[:, 0])
    is_it = np.take_along_axis(hydrant, np.maximum(referent, 0)[:, None], 1)[:, 0]
    assert ((weight * (is_it & (referent >= 0))).sum(-1) > 0.9).all()


def test_detections_that_contradict_each_other() -> None:
    """Objects that jump about and vanish in plain view: counted, finite, never dead."""
    random, looks = np.random.default_rng(0), []
    for step in range(4 * by_hand.STEPS):
        kinds = [int(random.integers(3)) for _ in range(step % 4)]
        found = [(kind, *random.uniform(-2.0, 2.0, 2)) for kind in kinds]
        looks.append(look(*found, noise=0.02, probability=1.0))
    _, info = follow(looks)
    # They contradict what was seen before, and soon there are more "objects" than slots: both
    # are said, every step by one of them once the place is well known.
    assert info.overflow.sum() > 0
    is_said = info.is_contradiction | (info.overflow > 0)
    assert is_said[:, by_hand.STEPS :].mean() > 0.8
    assert info.is_contradiction.any(axis=1).all()


def test_more_objects_than_slots_are_counted() -> None:
    places = [(HYDRANT, 0.9 * np.cos(turn), 0.9 * np.sin(turn)) for turn in np.arange(6)]
    more = [(CONE, 2.2 * np.cos(turn), 2.2 * np.sin(turn)) for turn in np.arange(6)]
    beliefs, info = follow([look(*part, noise=0.02) for part in (places, more)] * 4)
    assert (info.overflow[:, 0] == 0).all()
    assert (info.overflow[:, 1] == 6).all()
    # No slot was overwritten.
    assert (np.asarray(beliefs.particles.object_type) == HYDRANT).all()


@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_no_noise_at_all(noise: float) -> None:
    """Neither sensor nor odometry errs, everything is always detected."""
    objects, looks = [(CONE, 4.0, 0.5), (HYDRANT, 6.0, 0.8)], []
    for step in range(2 * by_hand.STEPS):
        x = 0.3 * step
        found = [(name, there - x, y) for name, there, y in objects if np.hypot(there - x, y) < 3.0]
        looks.append(look(*found, pose=np.array([x, 0.0, 0.0]), noise=noise, probability=1.0))
    beliefs, info = follow(looks, odometry_noise=0.0)
    assert not info.fault.any()
    assert not info.is_contradiction.any()
    particles = jax.tree.map(np.asarray, beliefs.particles)
    for slot, (name, x, y) in enumerate(objects):
        assert (particles.object_type[:, slot] == name).all()
        np.testing.assert_allclose(particles.mean_x[:, slot], x, atol=0.02)
        np.testing.assert_allclose(particles.mean_y[:, slot], y, atol=0.02)
    weight = np.exp(np.asarray(beliefs.log_weight))
    assert ((weight * (particles.referent[:, 0] == 1)).sum(-1) > 0.9).all()


def test_garbage_where_there_is_no_detection_changes_nothing() -> None:
    good = look((CONE, 1.0, 0.1), (HYDRANT, 2.4, 0.2))
    names, ranges = np.array(good.detection_type), np.array(good.detection_range)
    bearings = np.array(good.detection_bearing)
    names[2:], ranges[2:], bearings[2:] = HYDRANT, np.nan, np.inf
    bad = replace(good, detection_type=names, detection_range=ranges, detection_bearing=bearings)
    clean, _ = follow([good] * 8)
    dirty, _ = follow([bad] * 8)
    for ours, theirs in zip(jax.tree.leaves(clean), jax.tree.leaves(dirty), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_one_dead_weight_among_good_ones() -> None:
    number = by_hand.CONFIG.num_particles
    log_weight = jnp.full(number, -jnp.log(number - 1.0)).at[0].set(-jnp.inf)
    belief = replace(by_hand.begin(), log_weight=log_weight)
    _, info = follow([look()] * 8, belief=belief)
    assert not info.fault.any()


def test_words_that_nothing_can_satisfy() -> None:
    """ "In front of you", told at the edge of the area facing out: nowhere is possible."""
    sentence = by_hand.readings([[HYDRANT, ROBOT]], [[(0, FRONT, 1, False)]])
    looks = [look((HYDRANT, 1.0, 0.0), pose=np.array([0.0, 0.0, np.pi]))] * 8
    follow(looks, sentence, by_hand.begin((0.0, 0.0, np.pi)))


def test_no_words() -> None:
    """A reading that mentions nothing leaves a plain map."""
    beliefs, _ = follow([look((CONE, 1.0, 0.1))] * 8, by_hand.readings([[]], [[]]))
    assert not np.asarray(beliefs.particles.is_mentioned).any()
    assert (np.asarray(beliefs.particles.object_type)[:, 0] == CONE).all()


GOOD = by_hand.observation(POSE, [(CONE, 1.0, 0.1), (HYDRANT, 2.4, 0.2)])
SOUND = jax.jit(lambda belief, look, far: gating.gate(belief, gating.GatedStep(look, far)))
FAR = jnp.float32(1.5)


def judge(look, belief=None, farthest=FAR) -> gating.GatedStep:
    return SOUND(belief or by_hand.begin((5.0, 0.0, 0.0)), look, farthest)[1]


def test_a_sound_look_is_believed_as_it_is() -> None:
    found = judge(GOOD)
    assert int(found.fault) == 0
    assert not bool(found.is_jump)
    for ours, given in zip(jax.tree.leaves(found.observation), jax.tree.leaves(GOOD), strict=True):
        np.testing.assert_array_equal(ours, given)


@pytest.mark.parametrize("name", MUTATIONS)
def test_every_field_has_a_flag_of_its_own(name: str) -> None:
    mutate, flag = MUTATIONS[name]
    draw = np.random.default_rng(0)
    shut = judge(by_hand.observation(POSE, [])).observation
    for _ in range(40):
        found = judge(mutate(draw, GOOD))
        raised = Fault(int(found.fault))
        assert flag in raised
        # Nothing else is said, but that of many false detections two may be of one place.
        assert raised == flag or (name == "is_detection" and raised == flag | Fault.CONTRADICTION)
        # Nothing of the look is believed, and nothing is taken to be absent.
        assert not np.asarray(found.observation.is_detection).any()
        np.testing.assert_array_equal(found.observation.pose, POSE.astype(np.float32))
        np.testing.assert_array_equal(found.observation.detection_type, shut.detection_type)
        assert float(found.observation.sensor.detection_probability) == 0.0
        for leaf in jax.tree.leaves(found):
            assert np.isfinite(np.asarray(leaf, float)).all()


@pytest.mark.parametrize(
    ("offset", "view", "noise", "is_sound"),
    [
        ((3.0, 0.0), 2 * np.pi, 0.1, True),
        ((3.5, 0.0), 2 * np.pi, 0.1, True),  # five standard deviations out of range
        ((3.7, 0.0), 2 * np.pi, 0.1, False),
        ((-2.0, 0.0), np.pi, 0.1, False),
        ((-0.3, 2.0), np.pi, 0.1, True),
        ((-0.8, 2.0), np.pi, 0.1, False),
        ((-0.3, 0.1), 1.0, 0.1, True),  # so near that the noise alone may put it behind
        ((0.0, 0.0), 2 * np.pi, 0.0, True),
    ],
)
def test_what_noise_may_do_is_no_fault(offset, view, noise: float, is_sound: bool) -> None:
    sensor = by_hand.sensor(3.0, view=view, noise=noise)
    found = judge(by_hand.observation(POSE, [(CONE, *offset)], sensor))
    assert (int(found.fault) == 0) is is_sound


def test_two_things_side_by_side_are_no_contradiction() -> None:
    side_by_side = [(CONE, 1.0, 0.0), (HYDRANT, 1.0, 0.05)]
    assert int(judge(by_hand.observation(POSE, side_by_side)).fault) == 0
    for second in (HYDRANT, CONE):
        at_one = [(CONE, 1.0, 0.0), (second, 1.0, 0.004)]
        found = judge(by_hand.observation(POSE, at_one))
        assert int(found.fault) == Fault.CONTRADICTION
    # Of what cannot be at all it is not asked where it is.
    garbage = by_hand.observation(POSE, [(99, 1.0, 0.0), (99, 1.0, 0.0)])
    assert int(judge(garbage).fault) == Fault.DETECTION


def test_types_are_known_up_to_the_number_told() -> None:
    belief = replace(by_hand.begin((5.0, 0.0, 0.0)), num_types=jnp.int32(2))
    assert int(judge(GOOD, belief).fault) == 0
    car = by_hand.observation(POSE, [(by_hand.CAR, 1.0, 0.0)])
    assert int(judge(car, belief).fault) == Fault.DETECTION
    assert int(judge(car).fault) == 0


def test_a_jump_is_doubted_once_and_taken_over_when_it_stands() -> None:
    belief = by_hand.begin((5.0, 0.0, 0.0))
    away = by_hand.observation(np.array([1.0, 2.0, 0.0]), [])
    first = judge(away, belief)
    assert int(first.fault) == Fault.JUMP
    assert not bool(first.is_jump)
    np.testing.assert_array_equal(first.observation.pose, POSE)
    belief = SOUND(belief, away, FAR)[0]
    # Somewhere else again: doubted as before. Back where it was: as if nothing had been.
    other = by_hand.observation(np.array([9.0, 2.0, 0.0]), [])
    assert not bool(judge(other, belief).is_jump)
    assert int(judge(GOOD, belief).fault) == 0
    near = by_hand.observation(np.array([1.5, 2.5, 0.0]), [])
    second = judge(near, belief)
    assert int(second.fault) == Fault.JUMP
    assert bool(second.is_jump)
    np.testing.assert_array_equal(second.observation.pose, near.pose)
    # With anything else at fault it is not.
    broken = replace(near, sensor=replace(near.sensor, noise=np.float32(-1)))
    assert not bool(judge(broken, belief).is_jump)
    assert int(judge(away, by_hand.begin((5.0, 0.0, 0.0)), farthest=None).fault) == 0


def test_a_jump_taken_over_becomes_doubt_of_where_the_robot_is() -> None:
    belief = by_hand.with_objects(by_hand.begin((5.0, 0.0, 0.0)), [(CONE, 6.0, 0.0)])
    robot = by_hand.CONFIG.num_objects
    away = jnp.array([1.0, 0.0, 0.0])
    after = predict(belief, away, jnp.asarray(True), params=by_hand.params())
    np.testing.assert_allclose(after.particles.mean_x[robot], 1.0)
    # Four metres that nothing explains: the standard deviation of its place.
    np.testing.assert_allclose(np.sqrt(after.particles.covariance[robot, robot]), 4.0, rtol=1e-3)
    np.testing.assert_allclose(after.particles.mean_x[0], 6.0)


HERE, AREA = (0.0, 0.0, 0.0), by_hand.AREA
BAD_PLACES = [
    *(("area", HERE, one) for one in (
        (np.nan, 10.0, -5.0, 5.0), (0.0, np.inf, -5.0, 5.0), (10.0, 0.0, -5.0, 5.0),
        (0.0, 10.0, 5.0, 5.0), (0.0, 1e20, -5.0, 5.0), (0.0, 1e-30, -5.0, 5.0),
        (1e7, 2e7, 0.0, 9.0),
    )),
    *(("pose", one, AREA) for one in (
        (np.nan, 0.0, 0.0), (0.0, -np.inf, 0.0), (0.0, 0.0, np.nan), (1e20, 0.0, 0.0),
        (0.0, 0.0, 1e9), (500.0, 0.0, 0.0),
    )),
]  # fmt: skip


@pytest.mark.parametrize(("what", "pose", "area"), BAD_PLACES)
def test_a_place_that_cannot_be_is_refused_and_in_a_batch_flagged_for_good(what, pose, area):
    meant = {"area": r"\(x_min", "pose": r"\(x, y, heading\)"}[what]
    with pytest.raises(ValueError, match=f"{what} is .* but must be {meant}"):
        gating.check_start(pose, area)
    belief = by_hand.begin(pose, area=area)
    for leaf in jax.tree.leaves(replace(belief, log_weight=None)):
        assert np.isfinite(np.asarray(leaf, float)).all()
    for _ in range(2):
        found = judge(by_hand.observation(np.asarray(belief.last_pose), []), belief)
        assert int(found.fault) == Fault.PLACE


def test_a_place_that_may_be_is_taken() -> None:
    gating.check_start((0.0, 0.0, 0.0), by_hand.AREA)
    gating.check_start((-3.0, 0.0, 100.0), by_hand.AREA)
