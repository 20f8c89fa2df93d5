"""A custom sensor model: a camera that measures bearings without ranges.

    python examples/bearing_camera.py 100  # episodes in Table 2's worlds, seen 5 m far

Every particle samples the range of a new object. As the robot moves, the bearing changes, and the
particles with a wrong range lose their weight.
"""

import math
import sys

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav import SensorParams, default_sensor, keep_compiled_programs
from jaxlangnav.experiments.metrics import summarize
from jaxlangnav.experiments.policies import run_policy
from jaxlangnav.experiments.tasks import Cell, ground_sentences, known_distances, make_tasks
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.terrain import RANGING, SensorModel
from jaxlangnav.terrain.view import wrapped

NEAREST = 0.3
"""Metres; lower bound of ranges, where a bearing would be too informative."""


@pytree
class BearingCamera(SensorModel):
    """Bearings with Gaussian noise; the range that it reports is the end of its ray."""

    noise: Array  # f32[] radians, standard deviation of a bearing

    @property
    def is_located(self) -> bool:
        """False: it measures no range."""
        return False

    def simulate(
        self, normal: Array, ahead: Array, left: Array, sensor: SensorParams
    ) -> tuple[Array, Array]:
        """Simulate a noisy bearing at the maximum range."""
        bearing = jnp.arctan2(left, ahead) + self.noise * normal[0]
        return sensor.range_max * jnp.cos(bearing), sensor.range_max * jnp.sin(bearing)

    def variance(self, x: Array, y: Array, sensor: SensorParams) -> Array:
        """Compute R = (σ r)², r the range of the object in a particle."""
        return self.noise**2 * jnp.maximum(x * x + y * y, NEAREST**2)

    def draw_range(self, uniform: Array, metres: Array, sensor: SensorParams) -> Array:
        """Sample a range along the ray, uniform over the area in view."""
        return (metres[:, None] * jnp.sqrt(uniform))[:, None]

    def log_volume(self, sensor: SensorParams) -> Array:
        """Compute log ½ r², the area of a ray in square metres per radian."""
        return jnp.log(0.5 * sensor.range_max**2)

    def match(
        self, detected: tuple[Array, Array], expected: tuple[Array, Array], variance: Array
    ) -> tuple[Array, Array, Array]:
        """Evaluate the Gaussian of the bearing; the object's range is unchanged."""
        metres = jnp.maximum(jnp.hypot(*expected), NEAREST)
        bearing = jnp.arctan2(detected[1], detected[0])
        lateral = metres * wrapped(bearing - jnp.arctan2(expected[1], expected[0]))
        log_density = -0.5 * (lateral**2 / variance + jnp.log(2.0 * jnp.pi * variance))
        return log_density + jnp.log(metres), metres * jnp.cos(bearing), metres * jnp.sin(bearing)

    def log_fit(self, sensor: SensorParams) -> Array:
        """Compute −½ (log 2πσ² + 1)."""
        return -0.5 * (jnp.log(2.0 * jnp.pi * self.noise**2) + 1.0)


def success_rate(model: SensorModel, episodes: int, *, particles: int = 256) -> float:
    """Follow a sentence in Table 2's worlds: percent of the episodes that end at the hydrant."""
    cell = Cell(world="1H1C", relation="behind", sensor=default_sensor(5.0), seed=0)
    tasks = make_tasks(cell, episodes)
    model = jax.tree.map(lambda leaf: jnp.full(episodes, leaf), model)
    tasks = replace(tasks, scenario=replace(tasks.scenario, sensor_model=model))
    instructions = ground_sentences(["go to the hydrant behind the cone"]).instructions
    found = run_policy("informed", tasks, instructions, num_particles=particles)
    return summarize(found, known_distances(tasks)).success_rate


def main(episodes: str = "100") -> None:
    """Compare the two detectors."""
    keep_compiled_programs()
    camera = BearingCamera(noise=jnp.float32(math.radians(2.0)))
    for name, model in {"range and bearing": RANGING, "bearing alone": camera}.items():
        print(f"{name}: {success_rate(model, int(episodes)):.0f} % arrive")


if __name__ == "__main__":
    main(*sys.argv[1:])
