"""Gaussians in moment form, draws and resampling, by hand and against NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.numerics import categorical, gaussian
from jaxlangnav.numerics.batching import take
from jaxlangnav.numerics.resampling import effective_sample_size, independent, systematic

EDGES = [(0, 5), (1, 5), (3, 5), (2, 4), (0, 1)]
EPS = float(np.finfo(np.float32).eps)
CONDITION = jax.jit(lambda moments, *rest: gaussian.condition_offsets(moments, EDGES, *rest))
NORMALIZE = jax.jit(categorical.log_normalize)
DRAW = jax.jit(jax.vmap(categorical.draw))
SYSTEMATIC = jax.jit(jax.vmap(systematic))


def joint(size: int, seed: int, batch: int = 1) -> gaussian.Moments:
    """Random joint Gaussians in float64, particle axis last."""
    random = np.random.default_rng(seed)
    root = random.normal(size=(batch, size, size))
    covariance = root @ root.transpose(0, 2, 1) + 0.5 * np.eye(size)
    mean = random.normal(size=(2, size, batch))
    return gaussian.Moments(covariance.transpose(1, 2, 0), mean[0], mean[1])


def single(moments: gaussian.Moments) -> gaussian.Moments:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), moments)


@pytest.mark.parametrize("variance", [0.0, 0.3, 1e4])
def test_noise_adds_to_the_variance_of_one_coordinate(variance: float) -> None:
    covariance = joint(5, seed=2).covariance
    ours = gaussian.add_noise(jnp.asarray(covariance, jnp.float32), 3, jnp.float32(variance))
    covariance[3, 3] += variance
    np.testing.assert_allclose(ours, covariance, rtol=1e-6)


def test_conditioning_equals_the_information_form() -> None:
    """Λ' = Λ + Σ h hᵀ / R and η' = η + Σ h z / R, solved densely, for all but unused ones."""
    size, batch, edges = 6, 40, EDGES
    moments, random = joint(size, 3, batch), np.random.default_rng(4)
    offset = random.normal(size=(2, len(edges), batch))
    variance = random.uniform(0.01, 1.0, (len(edges), batch))
    is_used = random.uniform(size=(len(edges), batch)) < 0.7
    is_used[:, 0], is_used[:, 1] = True, False
    ours = CONDITION(single(moments), is_used, *(np.float32(part) for part in (*offset, variance)))
    for lane in range(batch):
        precision = np.linalg.inv(moments.covariance[..., lane])
        eta = [precision @ mean[:, lane] for mean in (moments.mean_x, moments.mean_y)]
        for index in np.flatnonzero(is_used[:, lane]):
            row = np.zeros(size)
            row[list(edges[index])] = 1.0, -1.0
            precision += np.outer(row, row) / variance[index, lane]
            for axis in range(2):
                eta[axis] += row * offset[axis, index, lane] / variance[index, lane]
        truth = np.linalg.inv(precision)
        # Each of five downdates rounds numbers of the size of the largest variance.
        allowed = 5 * len(edges) * EPS * np.abs(moments.covariance[..., lane]).max()
        assert np.abs(ours.covariance[..., lane] - truth).max() < allowed
        for mean, own in ((ours.mean_x, eta[0]), (ours.mean_y, eta[1])):
            # A gain is a covariance over S ≥ R, and meets an innovation of a few metres.
            assert np.abs(mean[:, lane] - truth @ own).max() < 10.0 * allowed / variance.min()
    np.testing.assert_array_equal(ours.covariance, np.swapaxes(ours.covariance, 0, 1))
    np.testing.assert_array_equal(ours.mean_x[:, 1], np.float32(moments.mean_x[:, 1]))


def test_measurement_of_no_worth_and_of_one_coordinate_by_hand() -> None:
    """R → ∞ changes nothing; two variances of 1 and R = 2 share an innovation of 4 alike."""
    eye = gaussian.Moments(jnp.eye(2), jnp.zeros(2), jnp.zeros(2))
    used, four = jnp.array([True]), jnp.array([4.0])
    vague = gaussian.condition_offsets(eye, [(0, 1)], used, four, four, jnp.array([1e20]))
    for ours, before in zip(vague, eye, strict=True):
        np.testing.assert_allclose(ours, before, atol=1e-9)
    found = gaussian.condition_offsets(eye, [(0, 1)], used, four, -four, jnp.array([2.0]))
    np.testing.assert_allclose(found.covariance, [[0.75, 0.25], [0.25, 0.75]], rtol=1e-6)
    np.testing.assert_allclose(found.mean_x, [1.0, -1.0], rtol=1e-6)
    np.testing.assert_allclose(found.mean_y, [-1.0, 1.0], rtol=1e-6)


def test_new_coordinates_are_the_limit_of_a_flat_prior() -> None:
    """Two enter relative to the third, whatever they held; a prior of 1e6 m² gives the same."""
    moments = joint(4, seed=6)
    is_new = np.array([True, False, True, False])[:, None]
    offset = np.array([[1.0], [9.0], [-2.0], [9.0]])
    variance = np.full((4, 1), 0.04)
    ours = gaussian.enter(
        single(moments), 3, jnp.asarray(is_new), offset, 0.5 * offset, jnp.float32(variance)
    )
    flat = np.where(is_new | is_new.T, np.diag([1e6] * 4), moments.covariance[..., 0])
    start = np.where(is_new[:, 0], 0.0, moments.mean_x[:, 0])
    for index in (0, 2):
        row = np.zeros(4)
        row[[index, 3]] = 1.0, -1.0
        gain = flat @ row / (row @ flat @ row + 0.04)
        start = start + gain * (offset[index, 0] - row @ start)
        flat = flat - np.outer(gain, row @ flat)
    # What the flat prior still says: a variance of a few m² over 1e6.
    np.testing.assert_allclose(ours.covariance[..., 0], flat, atol=1e-4)
    np.testing.assert_allclose(ours.mean_x[:, 0], start, atol=1e-4)
    np.testing.assert_array_equal(ours.covariance, np.swapaxes(ours.covariance, 0, 1))


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
    log_weight = np.full((4, 5), -np.inf, np.float32)
    log_weight[0, 3], log_weight[1, 4] = -1e4, 1e4
    log_weight[2, :3] = 0.0, -300.0, 300.0
    for uniform in (0.0, 0.5, 0.99999994):
        choice, total = DRAW(jnp.asarray(log_weight), jnp.full(4, uniform, jnp.float32))
        assert choice.tolist()[:2] == [3, 4]
        assert uniform == 0.0 or int(choice[2]) == 2
        np.testing.assert_allclose(total[:3], [-1e4, 1e4, 300.0])
        assert total[3] == -np.inf
        assert 0 <= int(choice[3]) < 5


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


def test_systematic_resampling_equals_counting_teeth() -> None:
    """The definition: tooth (j + u) / P belongs to the first whose cumulative weight exceeds it."""
    random = np.random.default_rng(5)
    for size in (1, 7, 64, 1000):
        weight = random.dirichlet(np.full(size, 0.2)).astype(np.float32)
        uniform = np.float32(random.uniform())
        ours = np.asarray(jax.jit(systematic)(weight, uniform))
        ends = np.cumsum(weight, dtype=float) / weight.sum(dtype=float)
        teeth = (np.arange(size) + float(uniform)) / size
        truth = np.searchsorted(ends, teeth, side="right")
        # A tooth within the rounding of a sum of P numbers may fall to the neighbour.
        gap = np.abs(ends[None, :] - teeth[:, None]).min(axis=1)
        is_clear = gap > size * np.finfo(np.float32).eps
        assert is_clear.mean() > 0.8
        np.testing.assert_array_equal(ours[is_clear], truth[is_clear])


def test_independent_draws_of_ancestors_are_in_proportion() -> None:
    weight = np.array([0.0, 2.0, 0.0, 5.0, 3.0, 0.0], np.float32)
    number = 30_000
    uniform = jax.random.uniform(jax.random.key(2), (number // 6, 6))
    drawn = np.asarray(jax.jit(jax.vmap(independent, in_axes=(None, 0)))(weight, uniform))
    share = np.bincount(drawn.ravel(), minlength=6) / number
    expected = weight / weight.sum()
    assert (np.abs(share - expected) <= 5 * np.sqrt(expected * (1 - expected) / number)).all()
    edge = independent(jnp.asarray(weight), jnp.array([0.0, 0.2, 0.69, 0.71, 1.0 - 6e-8, 0.0]))
    assert edge.tolist() == [1, 3, 3, 4, 4, 1]


ANCESTORS = np.array([0, 0, 2])


def test_taken_particles_are_copies_to_the_bit() -> None:
    random = np.random.default_rng(3)
    record = {
        "table": random.normal(size=(3, 2, 9)).astype(np.float32),
        "odd": np.array([0.0, -0.0, np.nan, np.inf, -np.inf, 1e-30, 1, 2, 3], np.float32),
        "index": random.integers(-(2**24), 2**24, (4, 9)).astype(np.int32),
        "flag": random.uniform(size=(2, 9)) < 0.5,
    }
    ancestors = np.array([8, 2, 2, 0, 1, 5, 4, 3, 2])
    ours = jax.jit(take)(record, ancestors)
    for name, leaf in record.items():
        found = np.asarray(ours[name])
        assert found.dtype == leaf.dtype
        assert found.tobytes() == np.ascontiguousarray(leaf[..., ancestors]).tobytes(), name


def test_gradients_pass_through_taken_particles() -> None:
    slope = jax.grad(lambda x: jnp.sum(take({"x": x, "n": jnp.arange(3)}, ANCESTORS)["x"] ** 2))
    assert np.array_equal(slope(jnp.array([1.0, 2.0, 3.0])), [4.0, 0.0, 6.0])


def test_effective_sample_size_by_hand() -> None:
    assert abs(float(effective_sample_size(jnp.full(8, 0.125))) - 8.0) < 1e-5
    assert abs(float(effective_sample_size(jnp.array([1.0, 0.0, 0.0]))) - 1.0) < 1e-6
    assert abs(float(effective_sample_size(jnp.array([0.5, 0.25, 0.25]))) - 1 / 0.375) < 1e-5
