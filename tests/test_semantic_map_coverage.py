"""Where the robot has looked: misses by cell, and draws from what is unseen."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand

from jaxlangnav.semantic_map.coverage import (
    Coverage,
    add_view,
    area_size,
    cell_centres,
    empty_coverage,
    log_miss_at,
    sample_unseen,
)
from jaxlangnav.terrain import OPEN
from jaxlangnav.terrain.view import eye_of

SAMPLE, AT = jax.jit(sample_unseen), jax.jit(log_miss_at)
CELLS = 32


@jax.jit
def look_at(coverage, x, y, heading, sensor) -> Coverage:
    eye = eye_of(x, y, heading, sensor)
    return add_view(coverage, eye, sensor, OPEN.view)


def fresh() -> Coverage:
    return empty_coverage(jnp.asarray(by_hand.AREA, jnp.float32), CELLS)


def random_coverage(seed: int = 0) -> Coverage:
    log_miss = -np.random.default_rng(seed).exponential(2.0, (CELLS, CELLS))
    return Coverage(
        log_miss=jnp.asarray(log_miss, jnp.float32), area=jnp.asarray(by_hand.AREA, jnp.float32)
    )


def test_a_look_misses_with_one_minus_the_detection_probability() -> None:
    coverage = look_at(fresh(), 4.0, 1.0, 0.0, by_hand.sensor(range_max=2.0, probability=0.8))
    x, y = np.meshgrid(*(np.asarray(axis) for axis in cell_centres(coverage)))
    distance = np.hypot(x - 4.0, y - 1.0)
    miss = np.exp(np.asarray(coverage.log_miss))
    np.testing.assert_allclose(miss[distance < 1.8], 0.2, rtol=1e-4)
    np.testing.assert_allclose(miss[distance > 2.2], 1.0)
    # The soft edge is fair: the covered area is that of the disc, to a few per cent.
    seen = ((1.0 - miss) / 0.8).sum() * float(area_size(coverage)) / CELLS**2
    assert abs(seen - np.pi * 4.0) < 0.02 * np.pi * 4.0


@pytest.mark.parametrize(("probability", "number"), [(0.8, 3), (1.0, 100)])
def test_looks_multiply_and_a_hundred_keep_a_little_room(probability: float, number: int) -> None:
    coverage, specification = fresh(), by_hand.sensor(range_max=2.0, probability=probability)
    for _ in range(number):
        coverage = look_at(coverage, 4.0, 1.0, 0.0, specification)
    at_centre = float(AT(coverage, jnp.float32(4.0), jnp.float32(1.0)))
    expected = number * np.log(1.0 - min(probability, 0.999))
    assert at_centre == pytest.approx(max(expected, -30.0), rel=2e-5)


def test_lookup_outside_the_area_is_impossible() -> None:
    coverage = random_coverage()
    x = jnp.array([-0.01, 10.01, 5.0, 5.0, 0.01, 9.99])
    y = jnp.array([0.0, 0.0, -5.01, 5.01, -4.99, 4.99])
    found = np.asarray(AT(coverage, x, y))
    assert (found[:4] == -np.inf).all()
    assert found[4] == coverage.log_miss[0, 0]
    assert found[5] == coverage.log_miss[-1, -1]


def test_unseen_places_follow_the_miss_probability() -> None:
    coverage = random_coverage()
    number, seeds = 128, 400
    uniform = jax.random.uniform(jax.random.key(0), (seeds, 2, number))
    x, y, log_unseen = jax.jit(jax.vmap(sample_unseen, in_axes=(None, 0, 0)))(
        coverage, jax.random.uniform(jax.random.key(1), (seeds,)), uniform
    )
    weight = np.exp(np.asarray(coverage.log_miss, float))
    np.testing.assert_allclose(log_unseen, np.log(weight.mean()), atol=1e-4)
    column = np.floor(np.asarray(x) / 10.0 * CELLS).astype(int)
    row = np.floor((np.asarray(y) + 5.0) / 10.0 * CELLS).astype(int)
    # Blocks of 8 × 8 cells, so that every one has its expected share.
    block = (row // 8) * 4 + column // 8
    share = np.stack([(block == index).mean(1) for index in range(16)], 1)
    expected = weight.reshape(4, 8, 4, 8).sum((1, 3)).reshape(-1) / weight.sum()
    error = share.std(0) / np.sqrt(seeds)
    assert (np.abs(share.mean(0) - expected) <= 5 * error + 1e-6).all()
    # Within their cells they are spread evenly.
    inside = np.asarray(x) / 10.0 * CELLS - column
    assert abs(inside.mean() - 0.5) < 5 / np.sqrt(12 * inside.size)


def test_unseen_places_are_spread_over_all_columns() -> None:
    """A comb over row-major cells must not fall on a few lines."""
    coverage = fresh()
    number = 128
    x, y, _ = SAMPLE(coverage, 0.3, jnp.full((2, number), 0.5))
    area = np.asarray(coverage.area)
    for place, low, high in ((x, area[0], area[1]), (y, area[2], area[3])):
        counts = np.histogram(np.asarray(place), bins=8, range=(low, high))[0]
        assert (np.abs(counts - number / 8) <= 5).all(), counts
