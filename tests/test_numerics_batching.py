"""What pleases XLA changes no value and no derivative, and does what it is there for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.numerics import batching
from jaxlangnav.numerics.batching import lookup, materialize, select_row

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
    drawn = batching.between(batching.uniforms(KEYS, 1000)[0], low, high)
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


FIRST = {
    "number": jnp.float32(2.5),
    "not a number": jnp.float32(jnp.nan),
    "infinite": jnp.float32(jnp.inf),
    "integer": jnp.int32(-(2**31)),
    "false": jnp.asarray(False),
}


@pytest.mark.parametrize("first", FIRST.values(), ids=FIRST.keys())
def test_values_are_the_same_whatever_stands_first(first):
    values = {"a": jnp.stack([first, first]), "b": (jnp.arange(3), jnp.ones((2, 2), bool))}
    same = jax.jit(materialize)(values)
    jax.tree.map(np.testing.assert_array_equal, same, values)
    assert jax.tree.map(lambda leaf: leaf.dtype, same) == jax.tree.map(lambda x: x.dtype, values)


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
