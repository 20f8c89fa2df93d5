"""Things nobody has spoken of: remembered once, and in every particle once somebody does."""

import jax
import jax.numpy as jnp
import numpy as np
import readings as by_hand

from jaxlangnav.messages import NONE
from jaxlangnav.semantic_map import unreferenced_objects as objects

HYDRANT, CONE, CAR = by_hand.HYDRANT, by_hand.CONE, by_hand.CAR
REMEMBER, PROMOTE = jax.jit(objects.remember_bystanders), jax.jit(objects.promote)
HERE = (jnp.float32(0.0), jnp.float32(0.0), jnp.float32(1e-4))


def spoken(*kinds: int) -> jax.Array:
    return jnp.isin(jnp.arange(16), jnp.array(kinds))


def see(known, *things):
    look = by_hand.observation(np.zeros(3), list(things))
    return REMEMBER(known, jax.tree.map(jnp.asarray, look), HERE)


def test_one_thing_seen_often_is_one_thing_placed_better() -> None:
    known, lost = see(objects.nobody(4), (CAR, 1.0, 0.0), (CAR, 2.5, 0.0), (CONE, 1.0, 0.1))
    first = known.variance[0]
    for _ in range(3):
        known, lost = see(known, (CAR, 1.2, 0.0))
    assert int(lost) == 0
    np.testing.assert_array_equal(known.object_type, [CAR, CAR, CONE, NONE])
    assert 1.1 < known.x[0] < 1.2
    np.testing.assert_allclose(known.variance[0], first / 4, rtol=1e-5)


def test_what_finds_no_room_is_counted() -> None:
    things = [(CAR, 1.0, 0.0), (CAR, -1.0, 0.0), (CAR, 0.0, 2.0)]
    known, lost = see(objects.nobody(2), *things)
    assert int(lost) == 1
    np.testing.assert_array_equal(known.object_type, [CAR, CAR])


def test_observation_is_parted_by_what_the_task_speaks_of() -> None:
    look = by_hand.observation(np.zeros(3), [(CAR, 1.0, 0.0), (CONE, 1.0, 1.0)])
    ours, others = objects.part(jax.tree.map(jnp.asarray, look), spoken(CONE))
    np.testing.assert_array_equal(ours.is_detection[:2], [False, True])
    np.testing.assert_array_equal(others.is_detection[:2], [True, False])


def test_another_sentence_exchanges_what_is_spoken_of() -> None:
    belief = by_hand.with_objects(by_hand.begin(), [(HYDRANT, 3.0, 1.0), (CONE, 2.0, 0.0)])
    known, _ = see(objects.nobody(4), (CAR, 1.0, 1.0), (CAR, -1.0, 0.0))
    told = spoken(CAR, CONE)
    after, listed = PROMOTE(belief.particles, known, told, belief.log_weight, True)
    np.testing.assert_array_equal(after.object_type[:3, 0], [CAR, CONE, CAR])
    np.testing.assert_allclose(after.mean_x[:3, 5], [1.0, 2.0, -1.0], atol=1e-5)
    assert after.covariance[0, 0, 0] > 1e-3
    assert float(jnp.abs(after.covariance[0, 1:]).max()) == 0.0
    assert sorted(np.asarray(listed.object_type).tolist()) == [NONE, NONE, NONE, HYDRANT]
    back, listed = PROMOTE(after, listed, spoken(HYDRANT), belief.log_weight, True)
    np.testing.assert_array_equal(back.object_type[:3, 0], [HYDRANT, NONE, NONE])
    np.testing.assert_allclose(back.mean_x[0], 3.0)
    assert int(jnp.sum(listed.is_held)) == 3


def test_nothing_is_exchanged_until_something_is_said() -> None:
    belief = by_hand.with_objects(by_hand.begin(), [(HYDRANT, 3.0, 1.0)])
    known, _ = see(objects.nobody(4), (CAR, 1.0, 1.0))
    after, listed = PROMOTE(belief.particles, known, spoken(CAR), belief.log_weight, False)
    for ours, theirs in zip(
        jax.tree.leaves((after, listed)), jax.tree.leaves((belief.particles, known)), strict=True
    ):
        np.testing.assert_array_equal(ours, theirs)
