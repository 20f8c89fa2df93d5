"""What a simulated detector gets wrong: it sees what is not there, and calls things by wrong names.

The paper's detector does neither (section 3.2); real ones do both. The law:

- *fresh* ghosts: in each look, of each type that is invented, a Poisson number of false detections
  with mean ``SensorParams.false_detections``, each anywhere in view, evenly by area, anew at every
  look (of more than ``MOST_FRESH`` in one look the rest is dropped);
- *haunted* places, drawn with the world: one in view is reported in a look with a probability of
  its own, where it is, with the noise of any thing. Nothing tells the belief of these;
- labels: a thing detected is called another type with probability ``SensorParams.mislabelled``,
  each of the others equally likely, anew at every look.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE, SensorParams
from jaxlangnav.terrain.view import eye_of
from jaxlangnav.world.state import Errors, Scenario, WorldState

MOST_FRESH = 4
"""Fresh ghosts in one look; at a mean of 0.1 there are more in one look of ten million."""
Ghosts = tuple[Array, Array, Array, Array]
"""Type i32[n]; x ahead, y to the left, f32[n] metres, robot frame; whether reported, bool[n]."""


def located(
    x: Array, y: Array, is_there: Array, state: WorldState, scenario: Scenario, sensor: SensorParams
) -> tuple[Array, Array, Array]:
    """Put places into the robot's frame and tell which are in view.

    Args:
        x: f32[n] metres, map frame.
        y: f32[n] metres.
        is_there: bool[n].
        state: the robot.
        scenario: the world.
        sensor: range and field of view.

    Returns:
        f32[n] x ahead and f32[n] y to the left, metres, robot frame; bool[n] there and in view.
    """
    dx, dy = x - state.position[0], y - state.position[1]
    cosine, sine = jnp.cos(state.heading), jnp.sin(state.heading)
    ahead, left = cosine * dx + sine * dy, cosine * dy - sine * dx
    eye = eye_of(state.position[0], state.position[1], state.heading, sensor)
    return ahead, left, is_there & scenario.terrain.view.sees(eye, x, y)


def labels_read(key: Array, kind: Array, errors: Errors, sensor: SensorParams) -> Array:
    """Read the labels of things, some of them wrongly.

    Limits: a rate of 0, or a single type told apart, reads every label as it is.

    Args:
        key: random key.
        kind: i32[O], type of each thing; NONE in empty slots.
        errors: which types there are.
        sensor: its ``mislabelled`` is the rate.

    Returns:
        i32[O], types as read in this look.
    """
    uniform = jax.random.uniform(key, (2, kind.size))
    others = jnp.sum(errors.is_type) - 1
    is_wrong = (uniform[0] < sensor.mislabelled) & (others > 0) & (kind != NONE)
    rank = jnp.cumsum(errors.is_type) - 1
    choice = jnp.minimum((uniform[1] * others).astype(jnp.int32), others - 1)
    # The thing's own type is stepped over.
    choice = choice + (choice >= rank[jnp.maximum(kind, 0)])
    is_chosen = (rank[None, :] == choice[:, None]) & errors.is_type[None, :]
    return jnp.where(is_wrong, jnp.argmax(is_chosen, axis=1), kind).astype(kind.dtype)


def fresh_ghosts(
    key: Array, state: WorldState, scenario: Scenario, errors: Errors, sensor: SensorParams
) -> Ghosts:
    """Invent detections anew for one look.

        number ~ Poisson(λ T),   λ = ``false_detections``, T types that are invented

    Limits: λ = 0 invents nothing.

    Args:
        key: random key.
        state: the robot.
        scenario: the world; what its terrain hides is not invented either.
        errors: which types are invented.
        sensor: rate, range and field of view.

    Returns:
        At most ``MOST_FRESH`` ghosts.
    """
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
    ahead, left, is_reported = located(x, y, is_there, state, scenario, sensor)
    types = jnp.sum(errors.is_invented)
    choice = jnp.minimum((uniform[2] * types).astype(jnp.int32), types - 1)
    is_chosen = (jnp.cumsum(errors.is_invented) - 1)[None, :] == choice[:, None]
    kind = jnp.argmax(is_chosen & errors.is_invented[None, :], axis=1)
    return kind.astype(jnp.int32), ahead, left, is_reported


def haunting_ghosts(
    key: Array, state: WorldState, scenario: Scenario, errors: Errors, sensor: SensorParams
) -> Ghosts:
    """Report places that are mistaken for things again and again.

    Args:
        key: random key.
        state: the robot.
        scenario: the world.
        errors: the places.
        sensor: range, field of view and noise.

    Returns:
        A ghost for each place.
    """
    chance_key, noise_key = jax.random.split(key)
    place = errors.haunt_x, errors.haunt_y, errors.haunt_type != NONE
    ahead, left, is_seen = located(*place, state, scenario, sensor)
    noise = sensor.noise * jax.random.normal(noise_key, (2, ahead.size))
    chance = jax.random.uniform(chance_key, ahead.shape)
    is_reported = is_seen & (chance < errors.haunt_probability)
    return errors.haunt_type, ahead + noise[0], left + noise[1], is_reported
