"""The joint Gaussian against independent objects: the forms, and which knows the truth better."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from studies.joint_objects import STEPS, compare_forms, drop_covariances, log_places

from jaxlangnav.messages import default_sensor
from jaxlangnav.pytree import replace


def random_map(seed: int):
    """A particle with three objects and a dense Σ."""
    random = np.random.default_rng(seed)
    belief = by_hand.with_objects(by_hand.begin(), [(0, 1.0, 2.0), (1, -3.0, 0.5), (2, 4.0, 4.0)])
    one = jax.tree.map(lambda leaf: leaf[..., 0], belief.particles)
    size = one.covariance.shape[0]
    used = [0, 1, 2, size - 1]
    root = random.normal(size=(4, 4))
    matrix = np.zeros((size, size))
    matrix[np.ix_(used, used)] = root @ root.T + 2 * np.eye(4)
    return replace(one, covariance=jnp.asarray(matrix, jnp.float32)), matrix


def test_dropped_covariances_leave_the_marginals() -> None:
    one, matrix = random_map(0)
    plain = drop_covariances(one)
    np.testing.assert_allclose(plain.covariance, np.diag(np.diag(matrix)), rtol=1e-6)
    np.testing.assert_array_equal(plain.mean_x, one.mean_x)


def test_log_density_of_places_equals_dense_algebra() -> None:
    one, matrix = random_map(1)
    covariance = matrix[:2, :2]
    x, y = np.array([1.3, -2.6]), np.array([1.8, 0.9])
    off = np.stack([x - np.array([1.0, -3.0]), y - np.array([2.0, 0.5])])
    expected = sum(
        -0.5 * row @ np.linalg.solve(covariance, row)
        - 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
        for row in off
    )
    is_there = jnp.arange(one.object_type.shape[0]) < 2
    pad = jnp.zeros(one.object_type.shape[0])
    found = log_places(one, pad.at[:2].set(x), pad.at[:2].set(y), is_there)
    assert float(found) == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
def test_joint_form_knows_the_places_better_under_odometry_noise() -> None:
    """Paired: the interval of the difference lies above zero, and the errors are smaller."""
    found = compare_forms(episodes=64, seed=0, odometry_noise=0.1)
    assert found.nll_ci[0] > 0.0, found.nll_ci
    assert found.rmse[0] < found.rmse[1]
    assert (np.asarray(found.scores.num_seen)[:, -1] >= 6).all()
    # The joint form is calibrated: NLL per object at the end is the entropy of what it says.
    assert np.isfinite(np.asarray(found.scores.nll)[:, :, -1]).all()


@pytest.mark.slow
def test_without_odometry_noise_there_is_little_to_gain() -> None:
    noisy = compare_forms(episodes=64, seed=0, odometry_noise=0.1)
    exact = compare_forms(episodes=64, seed=0, odometry_noise=1e-4)
    assert abs(exact.nll_difference) < 0.1 * noisy.nll_difference


@pytest.mark.slow
def test_drives_are_twice_round_and_repeat_by_seed() -> None:
    sensor = replace(default_sensor(), detection_probability=jnp.float32(1.0))
    one = compare_forms(episodes=2, seed=4, sensor=sensor)
    again = compare_forms(episodes=2, seed=4, sensor=sensor)
    assert one.scores.nll.shape == (2, 2, STEPS)
    np.testing.assert_array_equal(one.scores.nll, again.scores.nll)


@pytest.mark.parametrize(
    ("changes", "message"), [({"episodes": 1}, "at least 2"), ({"odometry_noise": 0.0}, "positive")]
)
def test_bad_input_is_refused(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        compare_forms(**({"episodes": 4, "seed": 0} | changes))
