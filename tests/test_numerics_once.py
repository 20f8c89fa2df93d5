"""Values worked out once: the same values and derivatives, kept from being worked out anew."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.numerics.once import once

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
    same = jax.jit(once)(values)
    jax.tree.map(np.testing.assert_array_equal, same, values)
    assert jax.tree.map(lambda leaf: leaf.dtype, same) == jax.tree.map(lambda x: x.dtype, values)


def test_a_batch_within_a_batch():
    values = jnp.arange(24.0).reshape(2, 3, 4)

    def one(shared, own):
        return once((own, shared))

    own, shared = jax.jit(jax.vmap(jax.vmap(one, in_axes=(None, 0)), in_axes=(None, 0)))(3, values)
    np.testing.assert_array_equal(own, values)
    np.testing.assert_array_equal(shared, np.full((2, 3), 3))


def test_derivatives_go_through_in_both_modes():
    point = jnp.array([0.3, -2.0, 5.0])

    def cubes(x):
        return jnp.sum(once((x**3, jnp.arange(3)))[0])

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
            value = once(value)
        # A joined array is a loop of its own on CPU.
        return [jnp.concatenate([value * factor, value[:1]]) for factor in range(2, 12)]

    return run


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="what XLA on CPU does")
def test_readers_do_not_work_it_out_anew():
    x = jnp.linspace(0.0, 1.0, 64)
    lines = {}
    for is_kept in (False, True):
        text = jax.jit(jax.vmap(read_often(is_kept))).lower(x[None]).compile().as_text()
        lines[is_kept] = text.count("\n")
        assert (" conditional(" in text) == is_kept
    assert lines[True] < 0.5 * lines[False], lines
    for kept, anew in zip(read_often(True)(x), read_often(False)(x), strict=True):
        np.testing.assert_array_equal(kept, anew)
