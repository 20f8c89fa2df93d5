"""Sensor models: simulation and likelihood of detections (eq. 7b, 8).

World and belief use the same record: the world simulates by it, the belief conditions on it. A
report is a range and a bearing. A bearing-only detector reports ``range_max``; each particle then
samples the range of a new object, and later reports are weighted by parallax.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.observations import MIN_NOISE
from jaxlangnav.messages import SensorParams
from jaxlangnav.numerics.gaussian import log_normal_isotropic
from jaxlangnav.pytree import pytree
from jaxlangnav.terrain.view import Eye, Position, View


@pytree
class SensorModel:
    """Range-bearing detector of the paper, with isotropic position noise; the base of others.

    Positions x, y are relative to the robot, metres; arguments broadcast against each other.
    """

    @property
    def is_located(self) -> bool:
        """Whether a report has a range; if not, unreferenced objects stay in the particles."""
        return True

    def simulate(self, normal: Array, x: Array, y: Array, sensor: SensorParams) -> Position:
        """Simulate reports of objects at f32[n] x ahead, y left; noise from normals f32[2, n]."""
        noise = sensor.noise * normal
        return x + noise[0], y + noise[1]

    def variance(self, x: Array, y: Array, sensor: SensorParams) -> Array:
        """Compute the noise variance R of a report of an object at x, y, square metres per axis."""
        return jnp.maximum(sensor.noise, MIN_NOISE) ** 2

    def draw_range(self, uniform: Array, metres: Array, sensor: SensorParams) -> Array:
        """Sample the range of a new object, f32[D] or f32[D, 1, P] metres, by uniform f32[D, P]."""
        return metres

    def log_volume(self, sensor: SensorParams) -> Array:
        """Compute the log volume element, from densities of objects in 1/m² to those of reports."""
        return jnp.float32(0.0)

    def match(
        self, report: Position, mean: Position, variance: Array
    ) -> tuple[Array, Array, Array]:
        """Compute the log-likelihood of a report of an object with predicted position and variance.

        Returns it, and the position x and y that the object is then conditioned on.
        """
        return log_normal_isotropic(report[0] - mean[0], report[1] - mean[1], variance), *report

    def log_fit(self, sensor: SensorParams) -> Array:
        """Compute the mean log-likelihood of a report of an object at a known position, f32[]."""
        return -(jnp.log(2.0 * jnp.pi * self.variance(sensor.noise, sensor.noise, sensor)) + 1.0)

    def report_probability(
        self, view: View, eye: Eye, x: Array, y: Array, softness: Array, sensor: SensorParams
    ) -> Array:
        """Compute the detection probability of an object in the map, below 1.

        ``softness``: metres over which the object's position is spread.
        """
        return jnp.minimum(sensor.detection_probability, 0.999) * view.share(eye, x, y, softness)


RANGING = SensorModel()
