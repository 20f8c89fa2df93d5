"""Coverage maps for both signs of a constant heading bias; the robot plans by the likelier (ours).

The magnitude of a constant heading bias is known but not its sign, until something is seen again.
So one coverage map per sign is kept, the robot plans by the likelier one, and particles ground the
words each by its own.

Limits: with a compass, and with no steady drift, there is one way, and nothing of this is computed.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import Observation, SensorParams
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief, fix, is_led, mean_drift, robot_position
from jaxlangnav.semantic_map.coverage import Coverage, log_miss_at, look
from jaxlangnav.terrain.view import eye_of

LEAST_LED = 0.2
"""Probability of the drift that the robot goes by, below which it goes by the other one."""


def both_ways(belief: ParticleBelief) -> tuple[Coverage, Array]:
    """Stack the coverages by the active sign of the bias and by the other, f32[2 G, G].

    i32[P], row at which the map of a particle's own sign begins.
    """
    maps = belief.coverage.log_miss, belief.alternate_miss
    rows = jnp.where(is_led(belief), 0, belief.alternate_miss.shape[0]).astype(jnp.int32)
    return replace(belief.coverage, log_miss=jnp.concatenate(maps)), rows


def log_missed(belief: ParticleBelief, x: Array, y: Array) -> Array:
    """Look up the log-probability that something at offsets from the robot was missed so far.

    x and y are f32[D] metres, map axes; f32[D, 1, P] where particles differ, for f32[D, P].
    """
    if x.ndim > 1:
        x, y = x[:, 0], y[:, 0]
    if mean_drift(belief) is None:
        robot_x, robot_y = robot_position(belief)
        return log_miss_at(belief.coverage, robot_x + x, robot_y + y)
    held, (coverage, rows) = belief.particles, both_ways(belief)
    return log_miss_at(coverage, held.mean_x[-1:] + x, held.mean_y[-1:] + y, rows)


def look_around(
    belief: ParticleBelief, observation: Observation, sensor: SensorParams
) -> tuple[Coverage, Array]:
    """Enter a look into the coverage, and into that by a drift of the other sign, f32[G, G]."""

    def looked(log_miss: Array, at: tuple[Array, Array], heading: Array) -> Coverage:
        before = Coverage(log_miss=log_miss, area=belief.coverage.area)
        eye = eye_of(*at, heading, sensor)
        return look(before, eye, sensor, belief.terrain.view, belief.sensor_model)

    heading, drift = observation.pose[2], mean_drift(belief)
    ours = looked(belief.coverage.log_miss, robot_position(belief), heading)
    if drift is None:
        return ours, belief.alternate_miss
    is_other = ~is_led(belief)
    x, y, turned = fix(belief, is_other)
    theirs = looked(belief.alternate_miss, (x, y), heading - drift + turned).log_miss
    return ours, jnp.where(jnp.any(is_other), theirs, belief.alternate_miss)


def switch_bias_hypothesis(belief: ParticleBelief) -> ParticleBelief:
    """Let the robot go by the other sign of a steady drift where that is far the likelier."""
    if mean_drift(belief) is None:
        return belief
    share = jnp.sum(jnp.where(is_led(belief), jnp.exp(belief.log_weight), 0.0))
    turns = share < LEAST_LED
    ours, theirs = belief.coverage.log_miss, belief.alternate_miss
    return replace(
        belief,
        coverage=replace(belief.coverage, log_miss=jnp.where(turns, theirs, ours)),
        alternate_miss=jnp.where(turns, ours, theirs),
        bias_sign=jnp.where(turns, -belief.bias_sign, belief.bias_sign),
    )
