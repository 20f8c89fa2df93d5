"""Sensor models: what they report, and how probable it is, by the same record."""

import math
import runpy
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand

from jaxlangnav.terrain import RANGING

EXAMPLE = runpy.run_path(str(Path(__file__).parent.parent / "examples" / "bearing_camera.py"))
CAMERA = EXAMPLE["BearingCamera"](noise=jnp.float32(math.radians(2.0)))
SENSOR = by_hand.sensor(range_max=5.0, noise=0.2)
MODELS = pytest.mark.parametrize("model", [RANGING, CAMERA], ids=["positions", "bearings"])
NUMBER = 20_000


def reports(model, place: tuple[float, float]):
    """Log-likelihoods of so many reports of a thing at a place, held against that place."""
    normal = jax.random.normal(jax.random.key(0), (2, NUMBER))
    there = jnp.broadcast_to(jnp.array(place)[:, None], (2, NUMBER))
    seen = model.simulate(normal, *there, SENSOR)
    variance = model.variance(*there, SENSOR)
    return model.match(seen, tuple(there), variance)


@MODELS
@pytest.mark.parametrize("place", [(3.0, 1.0), (-2.0, 0.1), (0.5, -4.0)])
def test_reports_are_as_likely_as_the_model_says(model, place) -> None:
    log_likelihood, x, y = reports(model, place)
    error = 5.0 * float(jnp.std(log_likelihood)) / math.sqrt(NUMBER)
    assert float(jnp.mean(log_likelihood)) == pytest.approx(float(model.log_fit(SENSOR)), abs=error)
    np.testing.assert_allclose([jnp.mean(x), jnp.mean(y)], place, atol=0.02)


def test_likelihoods_are_densities_of_reports() -> None:
    """Of a camera over all bearings, from a place known to within half a metre, too."""
    bearing = jnp.linspace(-math.pi, math.pi, 20_001)[:-1]
    ray = 5.0 * jnp.cos(bearing), 5.0 * jnp.sin(bearing)
    for place in ((3.0, 1.0), (-4.0, 0.2)):
        variance = CAMERA.variance(*map(jnp.float32, place), SENSOR) + 0.25
        log_density, _, _ = CAMERA.match(ray, tuple(map(jnp.float32, place)), variance)
        total = float(jnp.sum(jnp.exp(log_density))) * 2.0 * math.pi / bearing.size
        assert total == pytest.approx(1.0, abs=1e-3)


def test_a_range_that_is_not_measured_is_drawn_evenly_over_the_view() -> None:
    """A density λ of things gives λ ½ r² reports per radian: what the weight of a new one says."""
    uniform = jax.random.uniform(jax.random.key(1), (1, NUMBER))
    drawn = np.asarray(CAMERA.draw_range(uniform, jnp.full(1, 5.0), SENSOR))[0, 0]
    for part in (1.0, 2.5, 4.0):
        share = (part / 5.0) ** 2
        spread = 5.0 * math.sqrt(share * (1.0 - share) / NUMBER)
        assert np.mean(drawn < part) == pytest.approx(share, abs=spread)
    assert float(jnp.exp(CAMERA.log_volume(SENSOR))) == pytest.approx(12.5)
    assert float(RANGING.log_volume(SENSOR)) == 0.0


@pytest.mark.slow
def test_a_camera_without_ranges_finds_the_hydrant() -> None:
    """From start to stop, in Table 2's worlds: 36 of 48 episodes end within 1.5 m of it."""
    assert EXAMPLE["success_rate"](CAMERA, 48, particles=64) >= 75.0
