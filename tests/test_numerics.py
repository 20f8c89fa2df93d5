"""Gaussians, draws and resampling against NumPy; what pleases XLA changes no value."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.numerics import batching, categorical, gaussian
from jaxlangnav.numerics.batching import lookup, materialize, select_row, take
from jaxlangnav.numerics.categorical import independent, systematic

EDGES = [(0, 5), (1, 5), (3, 5), (2, 4), (0, 1)]
EPS = float(np.finfo(np.float32).eps)
CONDITION = jax.jit(lambda moments, *rest: gaussian.condition_offsets(moments, EDGES, *rest))
NORMALIZE = jax.jit(categorical.log_normalize)
DRAW = jax.jit(jax.vmap(categorical.draw))


def joint(size: int, seed: int, batch: int = 1) -> gaussian.Moments:
    """Random joint Gaussians in float64, particle axis last."""
    random = np.random.default_rng(seed)
    root = random.normal(size=(batch, size, size))
    covariance = root @ root.transpose(0, 2, 1) + 0.5 * np.eye(size)
    mean = random.normal(size=(2, size, batch))
    return gaussian.Moments(covariance.transpose(1, 2, 0), mean[0], mean[1])


def single(moments: gaussian.Moments) -> gaussian.Moments:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), moments)


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


def test_new_coordinates_are_the_limit_of_a_flat_prior() -> None:
    """Two enter relative to the third, whatever they held; a prior of 1e6 m² gives the same."""
    moments = joint(4, seed=6)
    is_new = np.array([True, False, True, False])[:, None]
    offset = np.array([[1.0], [9.0], [-2.0], [9.0]])
    variance = np.full((4, 1), 0.04)
    ours = gaussian.add_coordinates(
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


def test_systematic_resampling_equals_counting_teeth() -> None:
    """The definition: tooth (j + u) / P belongs to the first whose cumulative weight exceeds it."""
    random = np.random.default_rng(5)
    cases = [(random.dirichlet(np.full(n, 0.2)), random.uniform()) for n in (1, 7, 64, 1000)]
    cases += [(np.eye(33)[4], 0.0), (np.eye(33)[-1], 0.99999994), (np.full(33, 1 / 33), 0.5)]
    for weight, uniform in cases:
        size, weight, uniform = len(weight), np.float32(weight), np.float32(uniform)
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


KEYS = jax.random.split(jax.random.key(5), 3)


@pytest.mark.parametrize("shape", [(), (7,), (8, 64), (2, 3, 5)])
def test_each_row_begins_as_the_key_draws_alone(shape: tuple[int, ...]) -> None:
    size = int(np.prod(shape))
    drawn = jax.jit(lambda keys: batching.uniforms(keys, size + 11))(KEYS)
    assert drawn.shape == (3, size + 11)
    for key, row in zip(KEYS, drawn, strict=True):
        np.testing.assert_array_equal(row[:size].reshape(shape), jax.random.uniform(key, shape))


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.5, 2.0), (1e-6, 1.0 - 1e-6)])
def test_between_two_numbers(low: float, high: float) -> None:
    drawn = batching.to_interval(batching.uniforms(KEYS, 1000)[0], low, high)
    same = jax.random.uniform(KEYS[0], (1000,), minval=low, maxval=high)
    # A product and a sum may be rounded once or twice.
    np.testing.assert_allclose(drawn, same, rtol=3e-7, atol=3e-7)
    assert np.all((drawn >= np.float32(low)) & (drawn <= np.float32(high)))


def test_normal_numbers() -> None:
    drawn = batching.normal(batching.uniforms(KEYS, 1000)[1])
    np.testing.assert_allclose(drawn, jax.random.normal(KEYS[1], (1000,)), rtol=1e-6, atol=1e-6)


def test_lanes_draw_as_each_alone() -> None:
    keys = jax.random.split(jax.random.key(6), (4, 2))
    lanes = jax.vmap(lambda one: batching.uniforms(one, 5))(keys)
    np.testing.assert_array_equal(lanes[3], batching.uniforms(keys[3], 5))


def test_a_batch_within_a_batch():
    values = jnp.arange(24.0).reshape(2, 3, 4)

    def one(shared, own):
        return materialize((own, shared))

    own, shared = jax.jit(jax.vmap(jax.vmap(one, in_axes=(None, 0)), in_axes=(None, 0)))(3, values)
    np.testing.assert_array_equal(own, values)
    np.testing.assert_array_equal(shared, np.full((2, 3), 3))


def test_derivatives_go_through_in_both_modes():
    point = jnp.array([0.3, -2.0, 5.0])

    def cubes(x):
        return jnp.sum(materialize((x**3, jnp.arange(3)))[0])

    np.testing.assert_allclose(jax.grad(cubes)(point), 3 * point**2, rtol=1e-6)
    points = jnp.stack([point, 2 * point])
    np.testing.assert_allclose(jax.vmap(jax.grad(cubes))(points), 3 * points**2, rtol=1e-6)
    _, slope = jax.jvp(cubes, (point,), (jnp.ones(3),))
    np.testing.assert_allclose(slope, jnp.sum(3 * point**2), rtol=1e-6)
    np.testing.assert_allclose(jax.hessian(cubes)(point), jnp.diag(6 * point), rtol=1e-6)


def read_often(is_kept):
    """Build a long chain of cheap operations whose result many loops read, each for itself."""

    def run(x):
        value = x
        for index in range(40):
            value = jnp.where(value > index, value - 0.5, value + index)
        if is_kept:
            value = materialize(value)
        # A joined array is a loop of its own on CPU.
        return [jnp.concatenate([value * factor, value[:1]]) for factor in range(2, 12)]

    return run


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="what XLA on CPU does")
def test_readers_do_not_work_it_out_anew():
    x = jnp.linspace(0.0, 1.0, 64)
    lines = {}
    for is_kept in (False, True):
        text = jax.jit(jax.vmap(read_often(is_kept))).lower(x[None]).compile().as_text() or ""
        lines[is_kept] = text.count("\n")
        assert (" conditional(" in text) == is_kept
    assert lines[True] < 0.5 * lines[False], lines
    for kept, anew in zip(read_often(True)(x), read_often(False)(x), strict=True):
        np.testing.assert_array_equal(kept, anew)


@pytest.mark.parametrize("batch", [(), (5,)])
def test_pick_looks_up_a_short_table(batch: tuple[int, ...]) -> None:
    """Beyond its ends is 0; a table for each member of the batch, and an index for each."""
    random = np.random.default_rng(0)
    table = random.normal(size=(4, *batch)).astype(np.float32)
    for index in (-1, 0, 3, 4):
        chosen = np.full(batch, index, np.int32)
        expected = table[index] if 0 <= index < 4 else np.zeros(batch, np.float32)
        np.testing.assert_array_equal(lookup(jnp.asarray(table), jnp.asarray(chosen)), expected)


def test_rows_of_records() -> None:
    records = {"a": jnp.arange(12.0).reshape(3, 2, 2), "b": jnp.array([True, False, True])}
    for index, row in ((0, 0), (2, 2), (-1, 0), (7, 2)):
        found = jax.jit(select_row)(records, jnp.int32(index))
        jax.tree.map(
            lambda one, leaf, row=row: np.testing.assert_array_equal(one, leaf[row]), found, records
        )
