"""What lies between two landmarks: the density, its draws, and when people would say so."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.relations.between import SPREAD, lies_between, log_density, sample

LANDMARK, OTHER = (5.0, 1.0), (1.0, -2.0)
"""Five metres apart: along is (0.8, 0.6)."""


def at(x, y):
    return jnp.asarray(x, jnp.float32), jnp.asarray(y, jnp.float32)


def test_density_by_hand_and_normalised() -> None:
    middle = float(log_density(at(3.0, -0.5), at(*LANDMARK), at(*OTHER)))
    assert middle == pytest.approx(-np.log(2 * np.pi * SPREAD[0] * SPREAD[1] * 25.0), abs=1e-4)
    # One standard deviation along, and two across.
    aside = at(3.0 + 0.8 * 1.0 - 0.6 * 1.5, -0.5 + 0.6 * 1.0 + 0.8 * 1.5)
    assert float(log_density(aside, at(*LANDMARK), at(*OTHER))) == pytest.approx(
        middle - 0.5 - 2.0, abs=1e-4
    )
    step = np.arange(-10.0, 15.0, 0.05)
    grid = at(*np.meshgrid(step, step))
    total = np.exp(np.asarray(log_density(grid, at(*LANDMARK), at(*OTHER)), float)).sum() * 0.05**2
    assert total == pytest.approx(1.0, abs=1e-3)


def test_neither_landmark_comes_first_and_no_place_is_infinite() -> None:
    places = at(*np.random.default_rng(0).uniform(-8, 8, (2, 50)))
    one, other = (
        log_density(places, *pair)
        for pair in ((at(*LANDMARK), at(*OTHER)), (at(*OTHER), at(*LANDMARK)))
    )
    np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)
    assert np.isfinite(log_density(places, at(*OTHER), at(*OTHER))).all()


def test_draws_have_the_densities_they_say() -> None:
    normal = jax.random.normal(jax.random.key(1), (2, 2, 40_000))
    along, lateral, log_drawn = sample(normal[0], normal[1])
    # A figure, seen from one landmark towards the other one, in shares of the way.
    places = np.asarray(along[0]) + 1.0, np.asarray(lateral[0])
    for values, mean, spread in zip(places, (0.5, 0.0), SPREAD, strict=True):
        error = spread / np.sqrt(values.size)
        assert abs(values.mean() - mean) < 5 * error
        assert abs(values.std() - spread) < 5 * error
    # A landmark, seen from its figure: the mean of 1 / q over a piece of a sector is its area.
    distance, turn = np.hypot(along[1], lateral[1]), np.arctan2(lateral[1], -along[1])
    for radius in (0.5, 1.0, 2.0):
        is_in = (distance > 0.2) & (distance < radius) & (np.abs(turn) < 1.2)
        inside = np.where(is_in, np.exp(-np.asarray(log_drawn[0], float)), 0.0)
        error = inside.std() / np.sqrt(inside.size)
        assert error < 0.05
        assert abs(inside.mean() - 1.2 * (radius**2 - 0.04)) < 5 * error


def test_lies_between_by_hand() -> None:
    one, other = (0.0, 0.0), (4.0, 0.0)
    told = {
        (2.0, 0.0): True,
        (2.0, 0.8): True,
        (2.0, 1.4): True,  # 2.33 standard deviations aside
        (2.0, 1.5): False,
        (0.3, 0.1): True,
        (-0.1, 0.0): False,
        (4.5, 0.0): False,
        (0.0, 0.0): False,
        (4.0, 0.0): False,
    }
    for place, is_so in told.items():
        assert bool(lies_between(np.array(place), one, other)) is is_so, place
        assert bool(lies_between(np.array(place), other, one)) is is_so, place
