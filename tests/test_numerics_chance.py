"""Random numbers for several keys at once are those of each key alone."""

import jax
import numpy as np
import pytest

from jaxlangnav.numerics import chance

KEYS = jax.random.split(jax.random.key(5), 3)


@pytest.mark.parametrize("shape", [(), (7,), (8, 64), (2, 3, 5)])
def test_each_row_begins_as_the_key_draws_alone(shape: tuple[int, ...]) -> None:
    size = int(np.prod(shape))
    drawn = jax.jit(lambda keys: chance.uniforms(keys, size + 11))(KEYS)
    assert drawn.shape == (3, size + 11)
    for key, row in zip(KEYS, drawn, strict=True):
        np.testing.assert_array_equal(row[:size].reshape(shape), jax.random.uniform(key, shape))


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.5, 2.0), (1e-6, 1.0 - 1e-6)])
def test_between_two_numbers(low: float, high: float) -> None:
    drawn = chance.between(chance.uniforms(KEYS, 1000)[0], low, high)
    same = jax.random.uniform(KEYS[0], (1000,), minval=low, maxval=high)
    # A product and a sum may be rounded once or twice.
    np.testing.assert_allclose(drawn, same, rtol=3e-7, atol=3e-7)
    assert np.all((drawn >= np.float32(low)) & (drawn <= np.float32(high)))


def test_normal_numbers() -> None:
    drawn = chance.normal(chance.uniforms(KEYS, 1000)[1])
    np.testing.assert_allclose(drawn, jax.random.normal(KEYS[1], (1000,)), rtol=1e-6, atol=1e-6)


def test_lanes_draw_as_each_alone() -> None:
    keys = jax.random.split(jax.random.key(6), (4, 2))
    lanes = jax.vmap(lambda one: chance.uniforms(one, 5))(keys)
    np.testing.assert_array_equal(lanes[3], chance.uniforms(keys[3], 5))
