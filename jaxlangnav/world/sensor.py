"""Simulated object detector (section 4.2: limited range; section 4.3: limited field of view).

Each object within range and field of view is detected with a fixed probability. Its position in the
robot's frame gets isotropic Gaussian noise and is reported as range and bearing. Occlusion is
modelled by the scenario's ``terrain``.

The paper's detector has no false detections or wrong types (section 3.2). Real ones have, as ours
where ``Scenario.errors`` is set:

- *random* clutter: in each scan, for each affected type, a Poisson number of false detections with
  mean ``SensorParams.false_detections``, uniform over the field of view, independent between scans
  (more than ``MAX_CLUTTER`` in one scan are dropped);
- *fixed* clutter at positions sampled with the world: one in view is reported in a scan with its
  own probability, with the noise of a real detection. The filter does not model it;
- labels: a detected object gets another type with probability ``SensorParams.mislabelled``, each
  of the others equally likely, independent between scans.
"""

import chex
import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE, Observation, SensorParams
from jaxlangnav.numerics import batching
from jaxlangnav.pytree import replace
from jaxlangnav.terrain.view import eye_of
from jaxlangnav.world.state import CLUTTER_TYPES, NUM_TYPES, Errors, Scenario, WorldState

MAX_CLUTTER = 4
"""Limit of random clutter in one scan; at a mean of 0.1 exceeded once in ten million scans."""
Clutter = tuple[Array, Array, Array, Array]
"""Type i32[n]; x ahead, y to the left, f32[n] metres, robot frame; whether reported, bool[n]."""


def _to_robot(
    x: Array, y: Array, is_used: Array, state: WorldState, scenario: Scenario, sensor: SensorParams
) -> tuple[Array, Array, Array]:
    """Transform positions into the robot's frame, and determine which are in view."""
    dx, dy = x - state.position[0], y - state.position[1]
    cos, sin = jnp.cos(state.heading), jnp.sin(state.heading)
    ahead, left = cos * dx + sin * dy, cos * dy - sin * dx
    eye = eye_of(state.position[0], state.position[1], state.heading, sensor)
    return ahead, left, is_used & scenario.terrain.view.sees(eye, x, y)


def _sample_labels(key: Array, label: Array, sensor: SensorParams) -> Array:
    """Sample the reported labels of objects, some of them wrong."""
    # Limits: a rate of 0 leaves every label unchanged.
    uniform = jax.random.uniform(key, (2, label.size))
    is_wrong = (uniform[0] < sensor.mislabelled) & (label != NONE)
    other = _pick_index(uniform[1], NUM_TYPES - 1)
    # Skip the object's true type.
    return jnp.where(is_wrong, other + (other >= label), label).astype(label.dtype)


def _pick_index(uniform: Array, count: int) -> Array:
    """Map uniform numbers to equally likely indices: f32[n] in [0, 1) to i32[n]."""
    return jnp.minimum((uniform * count).astype(jnp.int32), count - 1)


def _random_clutter(
    key: Array, state: WorldState, scenario: Scenario, sensor: SensorParams
) -> Clutter:
    """Sample the random clutter of one scan."""
    # count ~ Poisson(λ T),   λ = ``false_detections``, T affected types
    # Limits: λ = 0 gives no clutter.
    count_key, position_key = jax.random.split(key)
    mean = sensor.false_detections * len(CLUTTER_TYPES)
    terms = jnp.cumprod(jnp.concatenate([jnp.exp(-mean)[None], mean / jnp.arange(1, MAX_CLUTTER)]))
    count = jnp.sum(jax.random.uniform(count_key) > jnp.cumsum(terms))
    uniform = jax.random.uniform(position_key, (3, MAX_CLUTTER))
    radius = sensor.range_max * jnp.sqrt(uniform[0])
    direction = state.heading + sensor.field_of_view * (uniform[1] - 0.5)
    x = state.position[0] + radius * jnp.cos(direction)
    y = state.position[1] + radius * jnp.sin(direction)
    is_used = jnp.arange(MAX_CLUTTER) < count
    ahead, left, is_reported = _to_robot(x, y, is_used, state, scenario, sensor)
    ahead, left = scenario.sensor_model.simulate(jnp.zeros((2, 1)), ahead, left, sensor)
    label = jnp.array(CLUTTER_TYPES, jnp.int32)[_pick_index(uniform[2], len(CLUTTER_TYPES))]
    return label, ahead, left, is_reported


def _fixed_clutter(
    key: Array, state: WorldState, scenario: Scenario, errors: Errors, sensor: SensorParams
) -> Clutter:
    """Sample the detections of fixed clutter."""
    uniform_key, noise_key = jax.random.split(key)
    position = errors.clutter_x, errors.clutter_y, errors.clutter_type != NONE
    ahead, left, is_visible = _to_robot(*position, state, scenario, sensor)
    normal = jax.random.normal(noise_key, (2, ahead.size))
    position = scenario.sensor_model.simulate(normal, ahead, left, sensor)
    uniform = jax.random.uniform(uniform_key, ahead.shape)
    is_reported = is_visible & (uniform < errors.clutter_probability)
    return errors.clutter_type, *position, is_reported


NUM_DETECTIONS, NUM_DETECTIONS_CROWDED = 8, 16
"""Slots of an observation, in worlds of at most eight objects and of more."""
_ERROR_KEY = 79
"""Folded into a scan's key for detector errors; true detections stay the same."""


def sense(
    key: Array,
    state: WorldState,
    scenario: Scenario,
    sensor: SensorParams,
    assumed: SensorParams | None = None,
    *,
    num_detections: int | None = None,
) -> Observation:
    """Detect the objects around the robot, nearest first.

    Limits: no noise and probability 1 report what is ``visible``, probability 0 only clutter; of
    more than D the nearest are kept, and the reported range is limited to theirs.

    Args:
        key: random key.
        state: the robot.
        scenario: the world.
        sensor: the true sensor model; traced.
        assumed: the sensor model that the robot assumes; the true one if None.
        num_detections: D, slots of the observation; if None, by the world's number of slots.
    """
    chex.assert_shape([state.position, state.odometry], [(2,), (3,)])
    chex.assert_equal_shape([scenario.object_x, scenario.object_y, scenario.is_object])
    x, y, is_visible = visible(state, scenario, sensor)
    if num_detections is None:
        num_detections = NUM_DETECTIONS_CROWDED if x.size > NUM_DETECTIONS else NUM_DETECTIONS
    miss, noise = batching.uniforms(jax.random.split(key), 2 * x.size)
    is_detected = is_visible & (miss[: x.size] < sensor.detection_probability)
    normal, label = batching.normal(noise).reshape(2, *x.shape), scenario.object_type
    x, y = scenario.sensor_model.simulate(normal, x, y, sensor)
    if (errors := scenario.errors) is not None:
        error_keys = jax.random.split(jax.random.fold_in(key, _ERROR_KEY), 3)
        label = _sample_labels(error_keys[0], label, sensor)
        random = _random_clutter(error_keys[1], state, scenario, sensor)
        fixed = _fixed_clutter(error_keys[2], state, scenario, errors, sensor)
        parts = zip((label, x, y, is_detected), random, fixed, strict=True)
        label, x, y, is_detected = (jnp.concatenate(part) for part in parts)
    distance = jnp.where(is_detected, jnp.hypot(x, y), jnp.inf)
    by_distance = jnp.argsort(distance)
    order = jnp.pad(by_distance, (0, max(0, num_detections - by_distance.size)))[:num_detections]
    is_detection = is_detected[order] & (jnp.arange(num_detections) < by_distance.size)
    if (attribute := scenario.object_attribute) is not None:
        # Clutter, which comes after the objects, has no attributes.
        codes = attribute[jnp.minimum(order, attribute.size - 1)]
        attribute = jnp.where(is_detection & (order < attribute.size), codes, 0)
    assumed = sensor if assumed is None else assumed
    if by_distance.size > num_detections:
        # Infinite where nothing was dropped.
        radius = jnp.minimum(assumed.range_max, distance[by_distance[num_detections]])
        assumed = replace(assumed, range_max=radius)
    return Observation(
        pose=state.odometry,
        detection_type=jnp.where(is_detection, label[order], NONE),
        detection_range=jnp.where(is_detection, distance[order], 0.0),
        detection_bearing=jnp.where(is_detection, jnp.arctan2(y, x)[order], 0.0),
        is_detection=is_detection,
        sensor=assumed,
        detection_attribute=attribute,
    )


def visible(
    state: WorldState, scenario: Scenario, sensor: SensorParams
) -> tuple[Array, Array, Array]:
    """Determine which objects are in view: in range, in the field of view, and not occluded.

    f32[O] x ahead and f32[O] y to the left, metres, robot frame; bool[O] in view.
    """
    objects = scenario.object_x, scenario.object_y, scenario.is_object
    return _to_robot(*objects, state, scenario, sensor)
