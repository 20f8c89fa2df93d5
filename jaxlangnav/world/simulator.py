"""The simulator: a world that answers an action with an observation (section 4.2)."""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import Action, MotionParams, Observation, SensorParams
from jaxlangnav.world.motion import move
from jaxlangnav.world.sensor import NUM_DETECTIONS, sense
from jaxlangnav.world.state import Scenario, WorldState

SUCCESS_RADIUS = 1.5
"""Metres from the intended goal within which a stop is a success (section 4.2)."""


def reset(scenario: Scenario) -> WorldState:
    """Put the robot at the start.

    Args:
        scenario: the world.

    Returns:
        The robot, nothing travelled; observe with ``sense``.
    """
    return WorldState(
        position=scenario.start[:2],
        heading=scenario.start[2],
        odometry=scenario.start,
        distance=jnp.zeros_like(scenario.start[0]),
    )


def step(
    key: Array,
    state: WorldState,
    scenario: Scenario,
    action: Action,
    *,
    sensor: SensorParams,
    motion: MotionParams,
    num_detections: int = NUM_DETECTIONS,
) -> tuple[WorldState, Observation]:
    """Move, then sense.

    Args:
        key: random key.
        state: the robot.
        scenario: the world.
        action: what the navigator asks.
        sensor: the detector's specification; traced.
        motion: the odometry's specification; traced.
        num_detections: D, slots of the observation.

    Returns:
        The robot after the step and what it senses there.
    """
    key_move, key_sense = jax.random.split(key)
    state = move(key_move, state, action, motion)
    observation = sense(key_sense, state, scenario, sensor, num_detections=num_detections)
    return state, observation


def goal_distance(state: WorldState, scenario: Scenario) -> Array:
    """Measure how far the robot truly is from the intended goal.

    Args:
        state: the robot.
        scenario: the world.

    Returns:
        f32[], metres.
    """
    offset = scenario.goal - state.position
    return jnp.hypot(offset[0], offset[1])


def is_success(state: WorldState, scenario: Scenario, is_stopped: Array) -> Array:
    """Judge a run: the robot itself has stopped, within 1.5 m of the intended goal.

    Args:
        state: the robot at the end.
        scenario: the world.
        is_stopped: bool[], the robot declared the command carried out.

    Returns:
        bool[].
    """
    return is_stopped & (goal_distance(state, scenario) <= SUCCESS_RADIUS)
