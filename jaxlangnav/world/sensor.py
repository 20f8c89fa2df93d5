"""The simulated object detector (section 4.2: limited range; section 4.3: limited field of view).

Each object within range and field of view is detected with a fixed probability. Its relative
position in the robot's frame gets isotropic Gaussian noise and is reported as range and bearing.
What the place itself hides is the business of its ``terrain``.

The paper's detector invents nothing and its types are always right (section 3.2). Real ones err,
as ours do where ``Scenario.errors`` says so:

- *fresh* ghosts: in each look, of each type that is invented, a Poisson number of false detections
  with mean ``SensorParams.false_detections``, each anywhere in view, evenly by area, anew at every
  look (of more than ``MOST_FRESH`` in one look the rest is dropped);
- *haunted* places, drawn with the world: one in view is reported in a look with a probability of
  its own, where it is, with the noise of any thing. Nothing tells the belief of these;
- labels: a thing detected is called another type with probability ``SensorParams.mislabelled``,
  each of the others equally likely, anew at every look.
"""

import chex
import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE, Observation, SensorParams
from jaxlangnav.numerics import batching
from jaxlangnav.pytree import replace
from jaxlangnav.terrain.view import eye_of
from jaxlangnav.world.state import Errors, Scenario, WorldState

MOST_FRESH = 4
"""Fresh ghosts in one look; at a mean of 0.1 there are more in one look of ten million."""
Ghosts = tuple[Array, Array, Array, Array]
"""Type i32[n]; x ahead, y to the left, f32[n] metres, robot frame; whether reported, bool[n]."""


def _located(
    x: Array, y: Array, is_there: Array, state: WorldState, scenario: Scenario, sensor: SensorParams
) -> tuple[Array, Array, Array]:
    """Put places into the robot's frame and tell which are in view."""
    dx, dy = x - state.position[0], y - state.position[1]
    cosine, sine = jnp.cos(state.heading), jnp.sin(state.heading)
    ahead, left = cosine * dx + sine * dy, cosine * dy - sine * dx
    eye = eye_of(state.position[0], state.position[1], state.heading, sensor)
    return ahead, left, is_there & scenario.terrain.view.sees(eye, x, y)


def _labels_read(key: Array, kind: Array, errors: Errors, sensor: SensorParams) -> Array:
    """Read the labels of things, some of them wrongly."""
    # Limits: a rate of 0, or a single type told apart, reads every label as it is.
    uniform = jax.random.uniform(key, (2, kind.size))
    others = jnp.sum(errors.is_type) - 1
    is_wrong = (uniform[0] < sensor.mislabelled) & (others > 0) & (kind != NONE)
    choice = _evenly(uniform[1], others)
    # The thing's own type is stepped over.
    choice = choice + (choice >= (jnp.cumsum(errors.is_type) - 1)[jnp.maximum(kind, 0)])
    return jnp.where(is_wrong, _nth(errors.is_type, choice), kind).astype(kind.dtype)


def _evenly(uniform: Array, number: Array) -> Array:
    """Choose one of so many, each equally likely: f32[n] in [0, 1) to i32[n]."""
    return jnp.minimum((uniform * number).astype(jnp.int32), number - 1)


def _nth(is_one: Array, rank: Array) -> Array:
    """Find the index of the rank-th that is one: bool[T], i32[n] from 0, to i32[n]."""
    is_chosen = (jnp.cumsum(is_one) - 1)[None, :] == rank[:, None]
    return jnp.argmax(is_chosen & is_one[None, :], axis=1)


def _fresh_ghosts(
    key: Array, state: WorldState, scenario: Scenario, errors: Errors, sensor: SensorParams
) -> Ghosts:
    """Invent detections anew for one look."""
    # number ~ Poisson(λ T),   λ = ``false_detections``, T types that are invented
    # Limits: λ = 0 invents nothing.
    number_key, place_key = jax.random.split(key)
    mean = sensor.false_detections * jnp.sum(errors.is_invented)
    terms = jnp.cumprod(jnp.concatenate([jnp.exp(-mean)[None], mean / jnp.arange(1, MOST_FRESH)]))
    number = jnp.sum(jax.random.uniform(number_key) > jnp.cumsum(terms))
    uniform = jax.random.uniform(place_key, (3, MOST_FRESH))
    metres = sensor.range_max * jnp.sqrt(uniform[0])
    bearing = sensor.field_of_view * (uniform[1] - 0.5)
    turned = state.heading + bearing
    x = state.position[0] + metres * jnp.cos(turned)
    y = state.position[1] + metres * jnp.sin(turned)
    is_there = jnp.arange(MOST_FRESH) < number
    ahead, left, is_reported = _located(x, y, is_there, state, scenario, sensor)
    ahead, left = scenario.sensor_model.simulate(jnp.zeros((2, 1)), ahead, left, sensor)
    kind = _nth(errors.is_invented, _evenly(uniform[2], jnp.sum(errors.is_invented)))
    return kind.astype(jnp.int32), ahead, left, is_reported


def _haunting_ghosts(
    key: Array, state: WorldState, scenario: Scenario, errors: Errors, sensor: SensorParams
) -> Ghosts:
    """Report places that are mistaken for things again and again."""
    chance_key, noise_key = jax.random.split(key)
    place = errors.haunt_x, errors.haunt_y, errors.haunt_type != NONE
    ahead, left, is_seen = _located(*place, state, scenario, sensor)
    normal = jax.random.normal(noise_key, (2, ahead.size))
    place = scenario.sensor_model.simulate(normal, ahead, left, sensor)
    chance = jax.random.uniform(chance_key, ahead.shape)
    is_reported = is_seen & (chance < errors.haunt_probability)
    return errors.haunt_type, *place, is_reported


NUM_DETECTIONS, NUM_DETECTIONS_CROWDED = 8, 16
"""Slots of an observation, in places of at most eight things and of more."""
_ERRING = 79
"""Folded into a look's key for what the detector gets wrong; the rest of the look stays."""


def sense(
    key: Array,
    state: WorldState,
    scenario: Scenario,
    sensor: SensorParams,
    told: SensorParams | None = None,
    *,
    num_detections: int | None = None,
) -> Observation:
    """Detect the objects around the robot, nearest first.

    Limits: no noise and probability 1 report what is ``visible``, probability 0 what is invented;
    of more than D the nearest are kept, and the observation reaches no farther than they.

    Args:
        key: random key.
        state: the robot.
        scenario: the world.
        sensor: what the detector is truly like; traced.
        told: what the robot takes it for; the truth if None.
        num_detections: D, slots of the observation; by the number of the world's slots if None.
    """
    chex.assert_shape([state.position, state.odometry], [(2,), (3,)])
    chex.assert_equal_shape([scenario.object_x, scenario.object_y, scenario.is_object])
    x, y, is_visible = visible(state, scenario, sensor)
    if num_detections is None:
        num_detections = NUM_DETECTIONS_CROWDED if x.size > NUM_DETECTIONS else NUM_DETECTIONS
    miss, noise = batching.uniforms(jax.random.split(key), 2 * x.size)
    is_found = is_visible & (miss[: x.size] < sensor.detection_probability)
    normal, kind = batching.normal(noise).reshape(2, *x.shape), scenario.object_type
    x, y = scenario.sensor_model.simulate(normal, x, y, sensor)
    if (errors := scenario.errors) is not None:
        keys = jax.random.split(jax.random.fold_in(key, _ERRING), 3)
        kind = _labels_read(keys[0], kind, errors, sensor)
        fresh = _fresh_ghosts(keys[1], state, scenario, errors, sensor)
        haunting = _haunting_ghosts(keys[2], state, scenario, errors, sensor)
        parts = zip((kind, x, y, is_found), fresh, haunting, strict=True)
        kind, x, y, is_found = (jnp.concatenate(part) for part in parts)
    distance = jnp.where(is_found, jnp.hypot(x, y), jnp.inf)
    nearest = jnp.argsort(distance)
    order = jnp.pad(nearest, (0, max(0, num_detections - nearest.size)))[:num_detections]
    is_detection = is_found[order] & (jnp.arange(num_detections) < nearest.size)
    if (attribute := scenario.object_attribute) is not None:
        # What is invented looks like nothing: it comes after the things.
        seen = attribute[jnp.minimum(order, attribute.size - 1)]
        attribute = jnp.where(is_detection & (order < attribute.size), seen, 0)
    told = sensor if told is None else told
    if nearest.size > num_detections:
        # Infinite where nothing has been left out.
        reach = jnp.minimum(told.range_max, distance[nearest[num_detections]])
        told = replace(told, range_max=reach)
    return Observation(
        pose=state.odometry,
        detection_type=jnp.where(is_detection, kind[order], NONE),
        detection_range=jnp.where(is_detection, distance[order], 0.0),
        detection_bearing=jnp.where(is_detection, jnp.arctan2(y, x)[order], 0.0),
        is_detection=is_detection,
        sensor=told,
        detection_attribute=attribute,
    )


def visible(
    state: WorldState, scenario: Scenario, sensor: SensorParams
) -> tuple[Array, Array, Array]:
    """Find which objects are in view: in range, in the field of view, and not hidden.

    f32[O] x ahead and f32[O] y to the left, metres, robot frame; bool[O] in view.
    """
    return _located(
        scenario.object_x, scenario.object_y, scenario.is_object, state, scenario, sensor
    )
