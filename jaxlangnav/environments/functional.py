"""Following a command as a pure environment: ``reset`` and ``step`` (section 4.2).

An agent drives the simulated robot of our worlds itself: it is told which of Table 2's commands
it is to carry out, senses what the robot senses, and says stop where it takes the goal to be.

    params = default_params(world="2H1C", relation="behind")
    observation, state = reset(key, params)
    observation, state, reward, is_over, info = step(key, state, action, params)

Everything is ``jit``- and ``vmap``-able; ``params`` are traced, so worlds, commands, ranges and
noise may differ from lane to lane of one compiled program.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import (
    Action,
    MotionParams,
    Observation,
    SensorParams,
    default_motion,
    default_sensor,
)
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.world import simulator
from jaxlangnav.world.motion import move
from jaxlangnav.world.scenario import ScenarioLaw, draw_scenario, scenario_law
from jaxlangnav.world.sensor import NUM_DETECTIONS, sense
from jaxlangnav.world.state import CONE, HYDRANT, Scenario, WorldState

COMMANDS = {
    "null": "go to the hydrant",
    "behind": "go to the hydrant behind the cone",
    "nearest": "go to the hydrant nearest to the cone",
}
"""What the agent is told, by relation, in the order of its one-hot in the observation."""
MAX_STEPS = 120
BOUND = 100.0
"""Entries of an observation are clipped to plus and minus this."""
OBSERVATION_SIZE = 12 + 5 * NUM_DETECTIONS
ACTION_SIZE = 3


@pytree
class EnvironmentParams:
    """What may vary from lane to lane; traced."""

    law: ScenarioLaw  # how worlds are drawn, the command's relation included
    sensor: SensorParams
    motion: MotionParams
    max_steps: Array  # i32[] steps after which an episode is cut off
    metre_cost: Array  # f32[] subtracted from the reward for each metre travelled


@pytree
class EnvironmentState:
    """An episode under way."""

    scenario: Scenario
    world: WorldState
    steps: Array  # i32[]


@pytree
class EnvironmentInfo:
    """What a person or a test wants to know of one step."""

    is_success: Array  # bool[] stopped within 1.5 m of the goal
    is_stopped: Array  # bool[] the agent has said stop
    is_cut_off: Array  # bool[] out of time
    distance: Array  # f32[] metres travelled in this episode
    goal_distance: Array  # f32[] metres to the goal that is meant


def default_params(
    *,
    world: str = "1H1C",
    relation: str = "behind",
    sensing_range: float = 3.0,
    max_steps: int = MAX_STEPS,
    metre_cost: float = 0.01,
) -> EnvironmentParams:
    """Build the parameters of an environment.

    Args:
        world: a template such as "2H1C".
        relation: "null", "behind" or "nearest": which command is given.
        sensing_range: metres.
        max_steps: steps after which an episode is cut off.
        metre_cost: subtracted from the reward for each metre travelled.

    Returns:
        The parameters, with the default noise of all tables.

    Raises:
        ValueError: an unknown world or relation, or a number outside its limits.
    """
    if not sensing_range > 0.0:
        raise ValueError(f"sensing_range is {sensing_range:g}, but must be above 0 m")
    if max_steps < 1:
        raise ValueError(f"max_steps is {max_steps}, but must be at least 1")
    return EnvironmentParams(
        law=scenario_law(template=world, relation=relation),
        sensor=default_sensor(sensing_range),
        motion=default_motion(),
        max_steps=jnp.int32(max_steps),
        metre_cost=jnp.float32(metre_cost),
    )


def reset(key: Array, params: EnvironmentParams) -> tuple[Array, EnvironmentState]:
    """Draw a world and put the robot at its start.

    Args:
        key: random key, consumed.
        params: the environment.

    Returns:
        The first observation, f32[52], and the state.
    """
    world_key, sense_key = jax.random.split(key)
    scenario = draw_scenario(world_key, params.law)
    world = simulator.reset(scenario)
    seen = sense(sense_key, world, scenario, params.sensor)
    state = EnvironmentState(scenario=scenario, world=world, steps=jnp.int32(0))
    return to_vector(seen, scenario, params), state


def step(
    key: Array, state: EnvironmentState, action: Array, params: EnvironmentParams
) -> tuple[Array, EnvironmentState, Array, Array, EnvironmentInfo]:
    """Carry out one action; the next episode has to be begun by ``reset``.

    The reward is 1 where the agent stops within 1.5 m of the goal, and otherwise 0, less the cost
    of the way.

    Args:
        key: random key, consumed.
        state: the episode.
        action: f32[3], in [−1, 1]: the step along the map's x and y in units of the greatest step
            (1 m), and stop where above 0. A step longer than the greatest one is shortened.
        params: the environment.

    Returns:
        Observation f32[52], state, reward f32[], bool[] whether the episode is over, and info.
    """
    move_key, sense_key = jax.random.split(key)
    action = jnp.clip(action, -1.0, 1.0)
    is_stopped = action[2] > 0.0
    way = action[:2] * params.motion.step_length
    order = Action(
        waypoint=state.world.odometry[:2] + way,
        step=way,
        is_stop=is_stopped,
        speed=jnp.float32(1.0),
        clearance=jnp.float32(0.0),
    )
    world = move(move_key, state.world, order, params.motion)
    after = replace(state, world=world, steps=state.steps + 1)
    is_success = simulator.is_success(world, state.scenario, is_stopped)
    is_cut_off = ~is_stopped & (after.steps >= params.max_steps)
    travelled = world.distance - state.world.distance
    info = EnvironmentInfo(
        is_success=is_success,
        is_stopped=is_stopped,
        is_cut_off=is_cut_off,
        distance=world.distance,
        goal_distance=simulator.goal_distance(world, state.scenario),
    )
    seen = sense(sense_key, world, state.scenario, params.sensor)
    reward = is_success.astype(jnp.float32) - params.metre_cost * travelled
    observation = to_vector(seen, state.scenario, params)
    return observation, after, reward, is_stopped | is_cut_off, info


def step_and_reset(
    key: Array, state: EnvironmentState, action: Array, params: EnvironmentParams
) -> tuple[Array, EnvironmentState, Array, Array, EnvironmentInfo]:
    """Carry out one action and begin the next episode at once where one ends, as gymnax does.

    Args:
        key: random key, consumed.
        state: the episode.
        action: f32[3], as of ``step``.
        params: the environment.

    Returns:
        As ``step``; observation and state are those of a new episode where one is over.
    """
    step_key, reset_key = jax.random.split(key)
    observation, after, reward, is_over, info = step(step_key, state, action, params)
    first, begun = reset(reset_key, params)
    return (
        jnp.where(is_over, first, observation),
        jax.tree.map(lambda new, old: jnp.where(is_over, new, old), begun, after),
        reward,
        is_over,
        info,
    )


def to_vector(seen: Observation, scenario: Scenario, params: EnvironmentParams) -> Array:
    """Lay out what the agent is given.

    Args:
        seen: what the robot senses.
        scenario: for the edges of the operating area, which are known to all.
        params: for the command and the sensing range.

    Returns:
        f32[52]: x, y, cosine and sine of the heading (odometry); the area's edges (4); the sensing
        range; one-hot of the command (3); and for each of eight detections, nearest first,
        whether there is one, metres ahead, metres to the left, is hydrant, is cone.
    """
    x, y, heading = seen.pose[0], seen.pose[1], seen.pose[2]
    told = (jnp.arange(len(COMMANDS)) == params.law.relation).astype(jnp.float32)
    is_there = seen.is_detection.astype(jnp.float32)
    detections = jnp.stack(
        [
            is_there,
            is_there * seen.detection_range * jnp.cos(seen.detection_bearing),
            is_there * seen.detection_range * jnp.sin(seen.detection_bearing),
            (seen.detection_type == HYDRANT).astype(jnp.float32),
            (seen.detection_type == CONE).astype(jnp.float32),
        ],
        axis=1,
    )
    own = jnp.stack([x, y, jnp.cos(heading), jnp.sin(heading)])
    parts = [own, scenario.area, params.sensor.range_max[None], told, detections.reshape(-1)]
    return jnp.clip(jnp.concatenate(parts), -BOUND, BOUND)
