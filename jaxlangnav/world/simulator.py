"""Where an episode begins in a world and when it is a success (section 4.2)."""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.world.state import Scenario, WorldState

SUCCESS_RADIUS = 1.5
"""Metres from the intended goal within which a stop is a success (section 4.2)."""


def reset(scenario: Scenario) -> WorldState:
    """Put the robot at the start, nothing travelled; observe with ``sense``."""
    return WorldState(
        position=scenario.start[:2],
        heading=scenario.start[2],
        odometry=scenario.start,
        distance=jnp.zeros_like(scenario.start[0]),
    )


def goal_distance(state: WorldState, scenario: Scenario) -> Array:
    """Measure how far the robot truly is from the intended goal, f32[] metres."""
    offset = scenario.goal - state.position
    return jnp.hypot(offset[0], offset[1])


def is_success(state: WorldState, scenario: Scenario, is_arrived: Array) -> Array:
    """Judge a run: the robot itself says, bool[], that it has arrived, within 1.5 m of the goal."""
    return is_arrived & (goal_distance(state, scenario) <= SUCCESS_RADIUS)
