"""Where an episode begins in a world, when it is a success, and a robot that knows the map.

It knows where everything is, itself included, drives straight to the goal and stops on it: the
baseline of section 4.2. Its distance is the column *Known* of Tables 2 and 3; divided by a run's
distance it gives the run's path efficiency (SPL).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import MotionParams
from jaxlangnav.world.motion import carry_out, halted, plain_action
from jaxlangnav.world.state import Scenario, WorldState

SUCCESS_RADIUS = 1.5
"""Metres from the intended goal within which a stop is a success (section 4.2)."""
ARRIVAL = 0.05
"""Metres from the goal that count as being there for a robot that knows the map."""
_MAX_STEPS = 200


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


class _Drive(NamedTuple):
    """Carry of the drive's loop."""

    state: WorldState
    num_steps: Array  # i32[]


def known_distance(scenario: Scenario) -> Array:
    """Measure the shortest way from start to goal, f32[] metres: the least any robot travels."""
    return scenario.terrain.travel.metres(*scenario.start[:2], *scenario.goal)


def drive_known_map(
    key: Array, scenario: Scenario, motion: MotionParams
) -> tuple[WorldState, Array]:
    """Drive to the goal with full knowledge, by the same motion as any other robot.

    Limits: without odometry noise the distance is ``known_distance`` to within ``ARRIVAL``.

    Returns:
        The robot at the end, and bool[], whether the run is a success.
    """

    def is_under_way(drive: _Drive) -> Array:
        far = goal_distance(drive.state, scenario) > ARRIVAL
        return far & (drive.num_steps < _MAX_STEPS)

    def advance(drive: _Drive) -> _Drive:
        # It is localised in its map, so it steers by the true offset.
        here, terrain = drive.state.position, scenario.terrain
        place = jnp.stack(terrain.travel.next_place(*here, *scenario.goal))
        action = plain_action(scenario.goal, place - here, jnp.array(False))
        key_step = jax.random.fold_in(key, drive.num_steps)
        state = halted(drive.state, carry_out(key_step, drive.state, action, motion), terrain)
        return _Drive(state=state, num_steps=drive.num_steps + 1)

    start = _Drive(state=reset(scenario), num_steps=jnp.int32(0))
    state, _ = jax.lax.while_loop(is_under_way, advance, start)
    is_there = goal_distance(state, scenario) <= ARRIVAL
    return state, is_success(state, scenario, is_there)
