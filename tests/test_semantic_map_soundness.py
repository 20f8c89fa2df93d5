"""What cannot be is left out of the belief as a whole, said, and forgotten with the next look."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from hostile import MUTATIONS, looks
from test_semantic_map_robustness import assert_sound

from jaxlangnav.messages import BEHIND, NONE, Fault
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import gating
from jaxlangnav.semantic_map.predict import predict

HYDRANT, CONE = by_hand.HYDRANT, by_hand.CONE
POSE = np.array([5.0, 0.0, 0.0])
GOOD = by_hand.observation(POSE, [(CONE, 1.0, 0.1), (HYDRANT, 2.4, 0.2)])
BEHIND_CONE = by_hand.readings([[HYDRANT, CONE]], [[(0, BEHIND, 1, False)]])
SOUND = jax.jit(gating.gate_observation)
FAR = jnp.float32(1.5)


def judge(look, belief=None, farthest=FAR) -> gating.Look:
    return SOUND(belief or by_hand.begin((5.0, 0.0, 0.0)), look, farthest)


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
    belief = replace(belief, reported_pose=first.reported_pose)
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
def test_a_place_that_cannot_be_is_refused_and_in_a_batch_flagged_for_good(
    what: str, pose: tuple, area: tuple
) -> None:
    meant = {"area": r"\(x_min", "pose": r"\(x, y, heading\)"}[what]
    with pytest.raises(ValueError, match=f"{what} is .* but must be {meant}"):
        gating.check_place(pose, area)
    belief = by_hand.begin(pose, area=area)
    for leaf in jax.tree.leaves(replace(belief, log_weight=None)):
        assert np.isfinite(np.asarray(leaf, float)).all()
    for _ in range(2):
        found = judge(by_hand.observation(np.asarray(belief.last_pose), []), belief)
        assert int(found.fault) == Fault.PLACE


def test_places_of_the_wrong_shape_are_refused() -> None:
    gating.check_place((0.0, 0.0, 0.0), by_hand.AREA)
    gating.check_place((-3.0, 0.0, 100.0), by_hand.AREA)
    with pytest.raises(ValueError, match="area is"):
        gating.check_place((0.0, 0.0, 0.0), (0.0, 1.0))
    with pytest.raises(ValueError, match="pose is"):
        gating.check_place((0.0, 0.0), by_hand.AREA)


def test_ten_thousand_hostile_looks_leave_a_belief_that_heals() -> None:
    """All lanes get looks of their own; not one number that is not finite gets into any of them."""
    beliefs, rounds = by_hand.repeat(by_hand.begin((5.0, 0.0, 0.0)), by_hand.SEEDS), 10
    sentences = by_hand.repeat(BEHIND_CONE, by_hand.SEEDS)

    def run(call: int, beliefs, observations):
        keys = jax.random.split(jax.random.key(call), by_hand.SEEDS)
        return by_hand.run_many(keys, beliefs, sentences, observations, by_hand.params())

    number = by_hand.SEEDS * by_hand.STEPS
    for call in range(rounds):
        drawn = looks(GOOD, number, seed=call)
        stacked = jax.tree.map(
            lambda leaf: leaf.reshape(by_hand.SEEDS, by_hand.STEPS, *leaf.shape[1:]),
            by_hand.stack([look for look, _ in drawn]),
        )
        beliefs, info = run(call, beliefs, stacked)
        flags = np.array([int(flag) for _, flag in drawn]).reshape(by_hand.SEEDS, by_hand.STEPS)
        assert ((np.asarray(info.fault) & flags) == flags).all()
        assert_sound(beliefs)
        for leaf in (beliefs.coverage.log_miss, beliefs.last_pose, beliefs.reported_pose):
            assert np.isfinite(np.asarray(leaf)).all()
    # Nothing of them is believed: not an object, not a place looked at.
    assert (np.asarray(beliefs.particles.object_type) == NONE).all()
    assert (np.asarray(beliefs.coverage.log_miss) == 0.0).all()
    good = by_hand.repeat(by_hand.stack([GOOD] * by_hand.STEPS), by_hand.SEEDS)
    beliefs, info = run(rounds, beliefs, good)
    assert (np.asarray(info.fault) == 0).all()
    assert_sound(beliefs)
    weight = np.exp(np.asarray(beliefs.log_weight))
    is_found = np.asarray(beliefs.particles.referent[:, 0]) >= 0
    assert ((weight * is_found).sum(-1) > 0.9).all()
