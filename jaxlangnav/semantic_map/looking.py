"""Where the robot has looked: by its drift, or by either sign of a steady one (ours).

Of a steady drift only the size is known. Until something is seen again nothing tells its sign, and
after twenty metres at 3° each the two places where the robot may be are ten metres apart: what lies
between them is nowhere. So the robot goes by one of them, and where it has looked is kept by
either. Particles ground the words each by its own, so that they live by what they were to see;
where all that could be seen by the one has been looked at in vain, the robot goes by the other.

Limits: with a compass, and with no steady drift, there is one way, and nothing of this is computed.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import Observation, SensorParams
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import (
    ParticleBelief,
    fix,
    is_led,
    mean_drift,
    robot_position,
)
from jaxlangnav.semantic_map.coverage import Coverage, log_miss_at, look
from jaxlangnav.terrain.view import eye_of

LEAST_LED = 0.2
"""Probability of the drift that the robot goes by, below which it goes by the other one. To change
at every doubt would be to search by both at once, and to finish neither."""


class Looked(NamedTuple):
    """Where the robot has looked, by either sign of a steady drift."""

    coverage: Coverage  # f32[2 G, G], that which the robot goes by above the other
    first_row: Array  # i32[P] where in it the map begins that a particle goes by


def both_ways(belief: ParticleBelief) -> Looked:
    """Put where the robot has looked by either drift one below the other, for all particles."""
    maps = belief.coverage.log_miss, belief.other_miss
    rows = jnp.where(is_led(belief), 0, belief.other_miss.shape[0]).astype(jnp.int32)
    return Looked(replace(belief.coverage, log_miss=jnp.concatenate(maps)), rows)


def log_missed(belief: ParticleBelief, x: Array, y: Array) -> Array:
    """Look up by which probability something at offsets from the robot has been missed so far.

    Args:
        belief: where the robot is and has looked.
        x: f32[D] metres, map axes; f32[D, 1, P] where headings differ.
        y: see ``x``.

    Returns:
        f32[D], or f32[D, P]: log-probabilities.
    """
    if mean_drift(belief) is None:
        robot_x, robot_y = robot_position(belief)
        return log_miss_at(belief.coverage, robot_x + x, robot_y + y)
    held, looked = belief.particles, both_ways(belief)
    place = held.mean_x[-1:] + x[:, 0], held.mean_y[-1:] + y[:, 0]
    return log_miss_at(looked.coverage, *place, looked.first_row)


def look_around(
    belief: ParticleBelief, observation: Observation, sensor: SensorParams
) -> tuple[Coverage, Array]:
    """Enter a look into the coverage, and into that by a drift of the other sign, f32[G, G]."""

    def looked(log_miss: Array, at: tuple[Array, Array], heading: Array) -> Coverage:
        before = Coverage(log_miss=log_miss, area=belief.coverage.area)
        eye = eye_of(*at, heading, sensor)
        return look(before, eye, sensor.detection_probability, belief.terrain.view)

    heading, drift = observation.pose[2], mean_drift(belief)
    ours = looked(belief.coverage.log_miss, robot_position(belief), heading)
    if drift is None:
        return ours, belief.other_miss
    is_other = ~is_led(belief)
    other = fix(belief, is_other)
    theirs = looked(belief.other_miss, other[:2], heading - drift + other.drift).log_miss
    return ours, jnp.where(jnp.any(is_other), theirs, belief.other_miss)


def go_by_the_likelier(belief: ParticleBelief) -> ParticleBelief:
    """Let the robot go by the other sign of a steady drift where that is far the likelier."""
    if mean_drift(belief) is None:
        return belief
    share = jnp.sum(jnp.where(is_led(belief), jnp.exp(belief.log_weight), 0.0))
    turns = share < LEAST_LED
    ours, theirs = belief.coverage.log_miss, belief.other_miss
    return replace(
        belief,
        coverage=replace(belief.coverage, log_miss=jnp.where(turns, theirs, ours)),
        other_miss=jnp.where(turns, ours, theirs),
        led_sign=jnp.where(turns, -belief.led_sign, belief.led_sign),
    )
