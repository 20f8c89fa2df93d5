"""Canonical form, draws and resampling, by hand and against NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.numerics import categorical, gaussian
from jaxlangnav.numerics.resampling import effective_sample_size, systematic

INVERT = jax.jit(jax.vmap(gaussian.invert))
NORMALIZE = jax.jit(categorical.log_normalize)
DRAW = jax.jit(jax.vmap(categorical.draw))
SYSTEMATIC = jax.jit(jax.vmap(systematic))


def spd(number: int, size: int, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    root = random.normal(size=(number, size, size))
    return root @ root.transpose(0, 2, 1) + 0.5 * np.eye(size)


def test_inverse_equals_numpy() -> None:
    matrices = spd(50, 7)
    ours = np.asarray(INVERT(matrices.astype(np.float32)), float)
    for matrix, inverse in zip(matrices, ours, strict=True):
        allowed = 20 * np.finfo(np.float32).eps * np.linalg.cond(matrix)
        truth = np.linalg.inv(matrix)
        assert np.abs(inverse - truth).max() <= allowed * np.abs(truth).max()


def test_inverse_of_a_number_and_of_a_diagonal() -> None:
    np.testing.assert_allclose(gaussian.invert(jnp.array([[4.0]])), [[0.25]])
    np.testing.assert_allclose(
        gaussian.invert(jnp.diag(jnp.array([2.0, 5.0]))), np.diag([0.5, 0.2]), rtol=1e-6
    )


@pytest.mark.parametrize("variance", [0.0, 0.3, 1e4])
def test_noise_adds_to_the_covariance_of_one_coordinate(variance: float) -> None:
    matrix = spd(1, 5, seed=2)[0]
    eta = np.random.default_rng(3).normal(size=(2, 5))
    precision, eta_x, eta_y = gaussian.add_noise(
        jnp.asarray(matrix, jnp.float32),
        jnp.asarray(eta[0], jnp.float32),
        jnp.asarray(eta[1], jnp.float32),
        3,
        jnp.float32(variance),
    )
    covariance = np.linalg.inv(matrix)
    mean = covariance @ eta[0], covariance @ eta[1]
    covariance[3, 3] += variance
    truth = np.linalg.inv(covariance)
    np.testing.assert_allclose(precision, truth, atol=2e-5 * np.abs(matrix).max())
    # Noise does not move the mean.
    for ours, old in ((eta_x, mean[0]), (eta_y, mean[1])):
        np.testing.assert_allclose(ours, truth @ old, atol=1e-4)


def test_shift_moves_the_mean_of_one_coordinate() -> None:
    matrix = spd(1, 4, seed=5)[0]
    mean = np.array([[1.0, -2.0, 0.5, 3.0], [0.0, 1.0, 2.0, -1.0]])
    eta_x, eta_y = gaussian.shift(
        jnp.asarray(matrix, jnp.float32),
        jnp.asarray(matrix @ mean[0], jnp.float32),
        jnp.asarray(matrix @ mean[1], jnp.float32),
        2,
        jnp.float32(0.7),
        jnp.float32(-0.4),
    )
    mean[:, 2] += (0.7, -0.4)
    np.testing.assert_allclose(
        np.linalg.solve(matrix, np.asarray(eta_x, float)), mean[0], atol=1e-4
    )
    np.testing.assert_allclose(
        np.linalg.solve(matrix, np.asarray(eta_y, float)), mean[1], atol=1e-4
    )


def test_isotropic_normal_by_hand() -> None:
    value = gaussian.log_normal_isotropic(jnp.float32(1.0), jnp.float32(-2.0), jnp.float32(0.5))
    assert abs(float(value) - (-5.0 - np.log(np.pi))) < 1e-5


def test_draws_are_in_proportion() -> None:
    weight = np.array([0.1, 0.0, 0.4, 0.5])
    with np.errstate(divide="ignore"):
        log_weight = np.log(weight) - 500.0
    number = 100_000
    uniform = jax.random.uniform(jax.random.key(0), (number,))
    choice, total = DRAW(jnp.broadcast_to(log_weight.astype(np.float32), (number, 4)), uniform)
    share = np.bincount(np.asarray(choice), minlength=4) / number
    assert share[1] == 0.0
    assert (np.abs(share - weight) <= 5 * np.sqrt(weight * (1 - weight) / number)).all()
    np.testing.assert_allclose(total, -500.0, atol=1e-3)


def test_draw_of_the_only_choice_and_of_none() -> None:
    log_weight = np.full((3, 5), -np.inf, np.float32)
    log_weight[0, 3], log_weight[1, 4] = -1e4, 1e4
    for uniform in (0.0, 0.5, 0.99999994):
        choice, total = DRAW(jnp.asarray(log_weight), jnp.full(3, uniform, jnp.float32))
        assert choice.tolist()[:2] == [3, 4]
        np.testing.assert_allclose(total[:2], [-1e4, 1e4])
        assert total[2] == -np.inf
        assert 0 <= int(choice[2]) < 5


def test_draw_far_apart_weights_is_finite() -> None:
    choice, total = DRAW(
        jnp.array([[0.0, -300.0, 300.0]], jnp.float32), jnp.array([0.5], jnp.float32)
    )
    assert int(choice[0]) == 2
    assert abs(float(total[0]) - 300.0) < 1e-3


def test_normalised_weights() -> None:
    rows = np.array(
        [
            [0.0, np.log(3.0), -np.inf, -np.inf],
            [-1e4, -1e4, -1e4 + np.log(2.0), -np.inf],
            [np.nan, 0.0, 0.0, -np.inf],
            [-np.inf] * 4,
            [np.nan] * 4,
            [-50.0, 0.0, 50.0, 0.0],
        ],
        np.float32,
    )
    weight, total, is_dead = NORMALIZE(rows)
    np.testing.assert_allclose(np.asarray(weight).sum(-1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(weight[0], [0.25, 0.75, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(weight[1], [0.25, 0.25, 0.5, 0.0], atol=1e-4)
    np.testing.assert_allclose(weight[2], [0.0, 0.5, 0.5, 0.0], atol=1e-6)
    np.testing.assert_allclose(weight[3:5], 0.25)
    assert is_dead.tolist() == [False, False, False, True, True, False]
    np.testing.assert_allclose(total[:3], [np.log(4.0), -1e4 + np.log(4.0), np.log(2.0)], atol=1e-3)
    assert (np.asarray(total[3:5]) == -np.inf).all()


def test_infinite_weight_is_refused_not_spread() -> None:
    """+∞ has no meaning as a weight: the result stays a distribution."""
    weight, _, _ = NORMALIZE(jnp.array([jnp.inf, 0.0, 0.0], jnp.float32))
    assert np.isfinite(weight).all()
    assert abs(float(weight.sum()) - 1.0) < 1e-6


def test_systematic_resampling_gives_everyone_its_share() -> None:
    random = np.random.default_rng(0)
    number, size = 200, 33
    weight = random.dirichlet(np.full(size, 0.3), number).astype(np.float32)
    weight[0] = 1.0 / size
    weight[1] = np.eye(size, dtype=np.float32)[4]
    weight[2] = np.eye(size, dtype=np.float32)[-1]
    uniform = random.uniform(size=number).astype(np.float32)
    uniform[:4] = 0.5, 0.0, 0.0, np.float32(0.99999994)
    ancestors = np.asarray(SYSTEMATIC(weight, uniform))
    assert (np.diff(ancestors, axis=1) >= 0).all()
    for row, chosen in zip(weight, ancestors, strict=True):
        count = np.bincount(chosen, minlength=size)
        # Within one, and a little more where float32 rounds the comb's teeth.
        assert (np.abs(count - size * row) <= 1.0 + 1e-3).all()
        assert (count[row == 0] == 0).all()
    assert ancestors[0].tolist() == list(range(size))
    assert (ancestors[1] == 4).all()
    assert (ancestors[2] == size - 1).all()


def test_systematic_resampling_is_unbiased() -> None:
    weight = np.array([0.02, 0.13, 0.35, 0.5], np.float32)
    number = 20_000
    uniform = jax.random.uniform(jax.random.key(1), (number,))
    ancestors = np.asarray(SYSTEMATIC(np.broadcast_to(weight, (number, 4)), uniform))
    share = np.stack([(ancestors == index).mean(1) for index in range(4)], 1)
    error = share.std(0) / np.sqrt(number)
    assert (np.abs(share.mean(0) - weight) <= 5 * error + 1e-6).all()


def test_effective_sample_size_by_hand() -> None:
    assert abs(float(effective_sample_size(jnp.full(8, 0.125))) - 8.0) < 1e-5
    assert abs(float(effective_sample_size(jnp.array([1.0, 0.0, 0.0]))) - 1.0) < 1e-6
    assert abs(float(effective_sample_size(jnp.array([0.5, 0.25, 0.25]))) - 1 / 0.375) < 1e-5
