"""Initial state and success of an episode, and the known-map baseline.

The baseline of section 4.2 knows all positions, including its own, drives straight to the goal and
stops there. Its distance is the column *Known* of Tables 2 and 3; divided by a run's distance it
gives the run's path efficiency (SPL).
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import MotionParams
from jaxlangnav.terrain.view import Eye
from jaxlangnav.world.motion import HOLONOMIC, move_or_stop, stop_at_wall
from jaxlangnav.world.state import Scenario, WorldState

SUCCESS_RADIUS = 1.5
"""Metres from the intended goal within which a stop is a success (section 4.2)."""
GOAL_RADIUS = 0.05  # metres from the goal within which the known-map robot has arrived
_MAX_STEPS = 200


def reset(scenario: Scenario) -> WorldState:
    """Build the initial state of the robot, at the start; observe with ``sense``."""
    return WorldState(
        position=scenario.start[:2],
        heading=scenario.start[2],
        odometry=scenario.start,
        distance=jnp.zeros_like(scenario.start[0]),
    )


def goal_distance(state: WorldState, scenario: Scenario) -> Array:
    """Compute the true distance from the robot to the intended goal, f32[] metres."""
    return jnp.hypot(*(scenario.goal - state.position))


def is_success(
    position: Array, scenario: Scenario, is_arrived: Array, radius: Array | float = SUCCESS_RADIUS
) -> Array:
    """Test for a declared arrival within 1.5 m of the goal, or with it in view within a radius."""
    view, eye = scenario.terrain.view, Eye(position[0], position[1], jnp.asarray(radius))
    is_near = jnp.hypot(*(scenario.goal - position)) <= SUCCESS_RADIUS
    return is_arrived & (is_near | view.sees(eye, *scenario.goal))


def known_distance(scenario: Scenario) -> Array:
    """Compute the shortest path length from start to goal, f32[] metres."""
    return scenario.terrain.travel.metres(*scenario.start[:2], *scenario.goal)


def drive_known_map(
    key: Array, scenario: Scenario, motion: MotionParams
) -> tuple[WorldState, Array]:
    """Drive to the goal with a known map, with the same motion model as any other robot.

    Limits: without odometry noise the distance is ``known_distance`` to within ``GOAL_RADIUS``.

    Returns:
        The robot at the end, and bool[], whether the run is a success.
    """

    def is_driving(drive: tuple[WorldState, Array]) -> Array:
        state, num_steps = drive
        return (goal_distance(state, scenario) > GOAL_RADIUS) & (num_steps < _MAX_STEPS)

    def advance(drive: tuple[WorldState, Array]) -> tuple[WorldState, Array]:
        # The known-map robot steers by its true position.
        (state, num_steps), terrain = drive, scenario.terrain
        waypoint = jnp.stack(terrain.travel.next_place(*state.position, *scenario.goal))
        action = move_or_stop(scenario.goal, waypoint - state.position, jnp.array(False))
        moved = HOLONOMIC.move(jax.random.fold_in(key, num_steps), state, action, motion)
        return stop_at_wall(state, moved, terrain), num_steps + 1

    state, _ = jax.lax.while_loop(is_driving, advance, (reset(scenario), jnp.int32(0)))
    is_arrived = goal_distance(state, scenario) <= GOAL_RADIUS
    return state, is_success(state.position, scenario, is_arrived)
