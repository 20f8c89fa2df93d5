"""The compile clock counts overlapping compilations once, and nothing when nothing compiles."""

import time

import jax
import jax.numpy as jnp
import pytest

from jaxlangnav.experiments.compilation import CompileClock, union_length


@pytest.mark.parametrize(
    ("intervals", "expected"),
    [
        ([], 0.0),
        ([(0.0, 2.0), (5.0, 6.0)], 3.0),
        ([(1.0, 4.0), (0.0, 2.0)], 4.0),
        ([(0.0, 10.0), (2.0, 3.0), (4.0, 11.0)], 11.0),
    ],
)
def test_union_length(intervals: list[tuple[float, float]], expected: float) -> None:
    assert union_length(intervals) == pytest.approx(expected)


def test_the_clock_counts_compilation_and_not_running() -> None:
    @jax.jit
    def cube(x: jax.Array) -> jax.Array:
        return x * x * x

    begin = time.perf_counter()
    with CompileClock() as first:
        cube(jnp.arange(3.0)).block_until_ready()
    passed = time.perf_counter() - begin
    with CompileClock() as second:
        cube(jnp.arange(3.0)).block_until_ready()
    assert 0.0 < first.seconds <= passed
    assert second.seconds < first.seconds
