"""Coverage maps for both signs of a constant heading bias; planning uses the likelier one (ours).

The magnitude of a constant heading bias is known but not its sign, until an object is seen again.
So there is one coverage map per sign; the robot plans with that of the likelier sign, and each
particle grounds the utterance with that of its own sign.
Limits: with a compass, or without a bias, there is one map, and nothing of this is computed.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import Observation, SensorParams
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import belief as beliefs
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.coverage import Coverage, add_view, log_miss_at
from jaxlangnav.terrain.view import eye_of

MIN_SIGN_PROB = 0.2
"""Probability of the active sign of the bias below which the other sign becomes active."""


def stack_coverage(belief: ParticleBelief) -> tuple[Coverage, Array]:
    """Stack the coverage maps of the active and of the other sign of the bias, f32[2 G, G].

    Also i32[P], the row at which the map of each particle's sign begins.
    """
    maps = belief.coverage.log_miss, belief.alternate_miss
    rows = jnp.where(beliefs.is_active(belief), 0, belief.alternate_miss.shape[0]).astype(jnp.int32)
    return replace(belief.coverage, log_miss=jnp.concatenate(maps)), rows


def log_miss_at_offset(belief: ParticleBelief, x: Array, y: Array) -> Array:
    """Look up the log miss probability of objects at offsets from the robot.

    x and y are f32[D] metres, map axes; f32[D, 1, P] where particles differ, for f32[D, P].
    """
    x, y = (x[:, 0], y[:, 0]) if x.ndim > 1 else (x, y)
    if beliefs.mean_drift(belief) is None:
        robot_x, robot_y = beliefs.robot_position(belief)
        return log_miss_at(belief.coverage, robot_x + x, robot_y + y)
    particles, (coverage, rows) = belief.particles, stack_coverage(belief)
    return log_miss_at(coverage, particles.mean_x[-1:] + x, particles.mean_y[-1:] + y, rows)


def update_coverage(
    belief: ParticleBelief, observation: Observation, sensor: SensorParams
) -> tuple[Coverage, Array]:
    """Add an observation's view to both coverage maps; log_miss of the other sign, f32[G, G]."""

    def viewed(log_miss: Array, robot: tuple[Array, Array], heading: Array) -> Coverage:
        before = Coverage(log_miss=log_miss, area=belief.coverage.area)
        eye = eye_of(*robot, heading, sensor)
        return add_view(before, eye, sensor, belief.terrain.view, belief.sensor_model)

    heading, drift = observation.pose[2], beliefs.mean_drift(belief)
    active = viewed(belief.coverage.log_miss, beliefs.robot_position(belief), heading)
    if drift is None:
        return active, belief.alternate_miss
    is_passive = ~beliefs.is_active(belief)
    x, y, turn = beliefs.mean_robot_pose(belief, is_passive)
    other = viewed(belief.alternate_miss, (x, y), heading - drift + turn).log_miss
    return active, jnp.where(jnp.any(is_passive), other, belief.alternate_miss)


def switch_bias_hypothesis(belief: ParticleBelief) -> ParticleBelief:
    """Make the other sign of the heading bias the active one where it is far more probable."""
    if beliefs.mean_drift(belief) is None:
        return belief
    prob = jnp.sum(jnp.where(beliefs.is_active(belief), jnp.exp(belief.log_weight), 0.0))
    is_switched = prob < MIN_SIGN_PROB
    active, other = belief.coverage.log_miss, belief.alternate_miss
    return replace(
        belief,
        coverage=replace(belief.coverage, log_miss=jnp.where(is_switched, other, active)),
        alternate_miss=jnp.where(is_switched, active, other),
        bias_sign=jnp.where(is_switched, -belief.bias_sign, belief.bias_sign),
    )
