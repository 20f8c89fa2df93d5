"""The simulated object detector (section 4.2: limited range; section 4.3: limited field of view).

Each object within range and field of view is detected with a fixed probability. Its relative
position in the robot's frame gets isotropic Gaussian noise and is reported as range and bearing.
There are no false detections; type is always right (section 3.2). What the place itself hides is
the business of its ``terrain``.
"""

import chex
import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE, Observation, SensorParams
from jaxlangnav.numerics import batching
from jaxlangnav.terrain.view import eye_of
from jaxlangnav.world.state import Scenario, WorldState

NUM_DETECTIONS = 8


def sense(
    key: Array,
    state: WorldState,
    scenario: Scenario,
    sensor: SensorParams,
    *,
    num_detections: int = NUM_DETECTIONS,
) -> Observation:
    """Detect the objects around the robot, nearest first.

    Limits: no noise and probability 1 report exactly what ``visible`` shows; probability 0
    reports nothing. The order is that of the reported ranges, so that slots of the true world
    do not show through; of more objects than D the nearest are kept.

    Args:
        key: random key.
        state: the robot.
        scenario: the world.
        sensor: the specification; traced.
        num_detections: D, slots of the observation.

    Returns:
        The observation, its pose by dead reckoning.
    """
    chex.assert_shape([state.position, state.odometry], [(2,), (3,)])
    chex.assert_equal_shape([scenario.object_x, scenario.object_y, scenario.is_object])
    x, y, is_visible = visible(state, scenario, sensor)
    miss, noise = batching.uniforms(jax.random.split(key), 2 * x.size)
    is_found = is_visible & (miss[: x.size] < sensor.detection_probability)
    noise_x, noise_y = sensor.noise * batching.normal(noise).reshape(2, *x.shape)
    x, y = x + noise_x, y + noise_y
    distance = jnp.where(is_found, jnp.hypot(x, y), jnp.inf)
    nearest = jnp.argsort(distance)
    order = jnp.pad(nearest, (0, max(0, num_detections - nearest.size)))[:num_detections]
    is_detection = is_found[order] & (jnp.arange(num_detections) < nearest.size)
    return Observation(
        pose=state.odometry,
        detection_type=jnp.where(is_detection, scenario.object_type[order], NONE),
        detection_range=jnp.where(is_detection, distance[order], 0.0),
        detection_bearing=jnp.where(is_detection, jnp.arctan2(y, x)[order], 0.0),
        is_detection=is_detection,
        sensor=sensor,
        detection_attribute=_attributes_seen(scenario, order, is_detection),
    )


def _attributes_seen(scenario: Scenario, order: Array, is_detection: Array) -> Array | None:
    """Report what the things detected look like, where the world says it."""
    if scenario.object_attribute is None:
        return None
    return jnp.where(is_detection, scenario.object_attribute[order], 0)


def visible(
    state: WorldState, scenario: Scenario, sensor: SensorParams
) -> tuple[Array, Array, Array]:
    """Find which objects are in view: in range, in the field of view, and not hidden.

    Args:
        state: the robot.
        scenario: the world.
        sensor: the specification.

    Returns:
        f32[O] x ahead and f32[O] y to the left, metres, robot frame; bool[O] in view.
    """
    dx = scenario.object_x - state.position[0]
    dy = scenario.object_y - state.position[1]
    cosine, sine = jnp.cos(state.heading), jnp.sin(state.heading)
    x, y = cosine * dx + sine * dy, cosine * dy - sine * dx
    eye = eye_of(state.position[0], state.position[1], state.heading, sensor)
    in_view = scenario.terrain.view.sees(eye, scenario.object_x, scenario.object_y)
    return x, y, scenario.is_object & in_view
