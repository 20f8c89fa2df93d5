"""Instruction following as a functional RL environment: ``reset`` and ``step`` (section 4.2).

An agent controls the simulated robot: it observes an embedded command and the robot's sensors, and
stops where it expects the goal.

    params = default_params(world="yard", instruction="go to the hydrant behind the cone")
    observation, state = reset(key, params)
    observation, state, reward, is_over, info = step(key, state, action, params)

For training over many episodes, sample a pool of worlds beforehand:

    params = replace(params, worlds=draw_pool(key, params.worlds))
    observation, state, reward, is_over, info = step_and_reset(key, state, action, params)

Everything is ``jit``- and ``vmap``-able; ``params`` are traced and may vary over the batch.

An observation, f32[OBSERVATION_SIZE], has the current view first, then a memory:

    0:4      x, y of odometry, metres; cosine and sine of its heading
    4:8      the operating area: x_min, x_max, y_min, y_max, metres
    8        the sensing range, metres
    9:21     the command, probabilities over its readings: the goal is related to the landmark by
             each relation of ``relations.table.REGISTRY``; more so than others of its type; the
             landmark is the robot; the goal is a region at the landmark; the action is find
    21:61    eight detections, nearest first: is it valid, x and y in the robot's frame, metres,
             is it of the goal's type, is it of the landmark's
    61:67    last detected goal type and landmark type: is it known, x and y in the
             robot's frame, metres
    67:131   coverage of 8 × 8 cells, row by row from y_min: has its centre been in view
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.environments.command import (
    COMMAND_SIZE,
    DEFAULT_RELATION,
    EmbeddedCommand,
    command_text,
    embed_command,
)
from jaxlangnav.environments.pool import sample_world
from jaxlangnav.episode import MAX_STEPS
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.inputs.limits import check_minimum
from jaxlangnav.inputs.object_types import ANYTHING
from jaxlangnav.messages import MotionParams, SensorParams, default_motion, default_sensor
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.task.loading import detector_of, load_task
from jaxlangnav.terrain.view import eye_of, rotate
from jaxlangnav.world import simulator
from jaxlangnav.world.files import WorldFile, open_world
from jaxlangnav.world.motion import HOLONOMIC, move_or_stop, stop_at_wall
from jaxlangnav.world.scenario import ScenarioParams, scenario_params
from jaxlangnav.world.sensor import NUM_DETECTIONS, sense
from jaxlangnav.world.state import Scenario, WorldState

ACTION_SIZE = 3
STOP_THRESHOLD = 0.9
"""An action with a last entry above this stops: 1 of 20 uniformly random actions does."""
NUM_DIRECTIONS = 16

_DIRECTIONS = np.arange(NUM_DIRECTIONS) * (2.0 * math.pi / NUM_DIRECTIONS)
DISCRETE_ACTIONS = np.array(
    [[0.0, 0.0, 1.0], *([np.cos(turn), np.sin(turn), -1.0] for turn in _DIRECTIONS)], np.float32
)
"""f32[17, 3], the discrete actions: stop, then the maximum step in 16 directions, +x to +y."""

MAX_OBSERVATION = 100.0  # observations are clipped to ± this
NUM_CELLS = 8
"""Cells of the coverage grid along each axis."""
VIEW_SIZE = 9 + COMMAND_SIZE + 5 * NUM_DETECTIONS
"""Size of the current view, the first entries of an observation."""
OBSERVATION_SIZE = VIEW_SIZE + 6 + NUM_CELLS**2


@pytree
class EnvironmentParams:
    """Parameters of an environment; traced, may vary over the batch."""

    worlds: ScenarioParams | Scenario  # their distribution, or a pool, leaves [N, …]
    command: EmbeddedCommand
    sensor: SensorParams
    motion: MotionParams
    max_steps: Array  # i32[] steps after which an episode is truncated
    stop_radius: Array  # f32[] metres from the goal, in view, within which a stop is a success
    metre_cost: Array  # f32[] subtracted from the reward for each metre travelled
    shaping: Array  # f32[] added to the reward for each metre that the goal has come nearer


@pytree
class EnvironmentState:
    """State of an episode."""

    scenario: Scenario
    world: WorldState
    steps: Array  # i32[]
    is_detected: Array  # bool[2] goal type and landmark type have been detected
    last_position: Array  # f32[2, 2] where they were last detected by odometry: x, y metres
    is_covered: Array  # bool[NUM_CELLS, NUM_CELLS] cell centre has been in view; [y, x]


@pytree
class EnvironmentInfo:
    """Diagnostics of one step."""

    is_success: Array  # bool[] stopped within the stop radius of the goal
    is_stopped: Array  # bool[] the agent has stopped
    is_truncated: Array  # bool[] out of time
    distance: Array  # f32[] metres travelled in this episode
    goal_distance: Array  # f32[] metres to the intended goal


def default_params(
    *,
    world: str = "1H1C",
    relation: str = DEFAULT_RELATION,
    instruction: str | None = None,
    sensing_range: float | None = None,
    max_steps: int = MAX_STEPS,
    metre_cost: float = 0.01,
    shaping: float = 0.0,
) -> EnvironmentParams:
    """Build the parameters of an environment.

    Args:
        world: a template such as "2H1C", whose worlds are drawn; a shipped world, or a file.
        relation: which of Table 2's commands is given in a template: "null", "behind", "nearest".
        instruction: the sentence in a world of a file; the file's own if None.
        sensing_range: metres; 3, or what the world's file says, if None.
        max_steps: steps after which an episode is truncated.
        metre_cost: subtracted from the reward for each metre travelled.
        shaping: added to the reward for each metre that the goal has come nearer.

    Raises:
        ValueError: an unknown world or relation, a sentence that is not understood or that nothing
            there fits, or a number outside its limits; one line.
    """
    check_minimum(1, max_steps=max_steps)
    model, source, is_find_task = load_shipped(), open_world(world), False
    sensor = default_sensor(3.0 if sensing_range is None else sensing_range)
    motion = default_motion()
    if isinstance(source, WorldFile):
        text = command_text(world=world, instruction=instruction)
        if not text:
            raise ValueError(f"world {source.name} has no instruction of its own: give one")
        understood = understand(text, model, detector_of(source, model.type_names))
        prepared = load_task(source, understood, sensing_range=sensing_range, seed=0)
        if prepared.unscored:
            raise ValueError(f"world {source.name}: {prepared.unscored}")
        task, is_find_task = prepared.task, prepared.is_find_task
        worlds = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], task.scenario)
        sensor, motion = task.sensor, task.motion
    elif instruction is not None:
        raise ValueError(f"instruction is given, but in {world} worlds relation names the command")
    else:
        worlds = scenario_params(template=source, relation=relation)
        understood = understand(command_text(world=world, relation=relation), model)
    return EnvironmentParams(
        worlds=worlds,
        command=embed_command(understood, is_find_task=is_find_task),
        sensor=sensor,
        motion=motion,
        max_steps=jnp.int32(max_steps),
        stop_radius=jnp.maximum(sensor.range_max * is_find_task, simulator.SUCCESS_RADIUS),
        metre_cost=jnp.float32(metre_cost),
        shaping=jnp.float32(shaping),
    )


def reset(key: Array, params: EnvironmentParams) -> tuple[Array, EnvironmentState]:
    """Start an episode: observation f32[OBSERVATION_SIZE], state."""
    world_key, sense_key = jax.random.split(key)
    return _observe(sense_key, _initial_state(world_key, params), params)


def step(
    key: Array, state: EnvironmentState, action: Array, params: EnvironmentParams
) -> tuple[Array, EnvironmentState, Array, Array, EnvironmentInfo]:
    """Execute one action; after the end of an episode call ``reset``.

    The reward is 1 where the agent stops within the stop radius of the goal, and otherwise 0, less
    the cost of the way, and with what ``shaping`` gives.

    Args:
        key: random key, consumed.
        state: the episode.
        action: f32[3], in [−1, 1]: the step along the map's x and y in units of
            ``motion.step_length``, to which a longer one is shortened, and stop where above
            ``STOP_THRESHOLD``. ``DISCRETE_ACTIONS`` lists some.
        params: the environment.

    Returns:
        Observation f32[OBSERVATION_SIZE], state, reward f32[], bool[] whether the episode is over,
        and info.
    """
    move_key, sense_key = jax.random.split(key)
    after, reward, info = _transition(move_key, state, action, params)
    observation, after = _observe(sense_key, after, params)
    return observation, after, reward, info.is_stopped | info.is_truncated, info


def step_and_reset(
    key: Array, state: EnvironmentState, action: Array, params: EnvironmentParams
) -> tuple[Array, EnvironmentState, Array, Array, EnvironmentInfo]:
    """Execute one action, with automatic reset at the end of an episode, as gymnax does.

    As ``step``; observation and state are those of a new episode where one is over. Without a pool
    a world is drawn in every step.
    """
    move_key, world_key, sense_key = jax.random.split(key, 3)
    after, reward, info = _transition(move_key, state, action, params)
    is_over = info.is_stopped | info.is_truncated
    observation, after = _observe(sense_key, _reset_if(world_key, after, params, is_over), params)
    return observation, after, reward, is_over, info


def step_or_reset(
    key: Array, state: EnvironmentState, action: Array, params: EnvironmentParams, is_over: Array
) -> tuple[Array, EnvironmentState, Array, EnvironmentInfo]:
    """Execute one action, or reset where the last step ended its episode (``is_over``, bool[]).

    As ``step_and_reset``, but where a new episode begins the action has no effect, and reward and
    info are zero. Observation, state, reward and info.
    """
    move_key, world_key, sense_key = jax.random.split(key, 3)
    after, reward, info = _transition(move_key, state, action, params)
    reward, info = jax.tree.map(
        lambda leaf: jnp.where(is_over, jnp.zeros_like(leaf), leaf), (reward, info)
    )
    observation, after = _observe(sense_key, _reset_if(world_key, after, params, is_over), params)
    return observation, after, reward, info


def _initial_state(key: Array, params: EnvironmentParams) -> EnvironmentState:
    """Build the initial state in a new world, sampled or taken from the pool."""
    scenario = sample_world(key, params.worlds)
    return EnvironmentState(
        scenario=scenario,
        world=simulator.reset(scenario),
        steps=jnp.int32(0),
        is_detected=jnp.zeros(2, bool),
        last_position=jnp.zeros((2, 2)),
        is_covered=jnp.zeros((NUM_CELLS, NUM_CELLS), bool),
    )


def _reset_if(
    key: Array, state: EnvironmentState, params: EnvironmentParams, is_over: Array
) -> EnvironmentState:
    """Replace the state by an initial one where the episode is over."""
    return jax.tree.map(functools.partial(jnp.where, is_over), _initial_state(key, params), state)


def _transition(
    key: Array, state: EnvironmentState, action: Array, params: EnvironmentParams
) -> tuple[EnvironmentState, Array, EnvironmentInfo]:
    """Move the robot and compute the reward, without sensing."""
    action = jnp.clip(action, -1.0, 1.0)
    is_stopped = action[2] > STOP_THRESHOLD
    displacement = action[:2] * params.motion.step_length
    motion_command = move_or_stop(state.world.odometry[:2] + displacement, displacement, is_stopped)
    target = HOLONOMIC.move(key, state.world, motion_command, params.motion)
    world = stop_at_wall(state.world, target, state.scenario.terrain)
    next_state = replace(state, world=world, steps=state.steps + 1)
    previous_distance = simulator.goal_distance(state.world, state.scenario)
    goal_distance = simulator.goal_distance(world, state.scenario)
    succeeds = simulator.is_success(world.position, state.scenario, is_stopped, params.stop_radius)
    info = EnvironmentInfo(
        is_success=succeeds,
        is_stopped=is_stopped,
        is_truncated=~is_stopped & (next_state.steps >= params.max_steps),
        distance=world.distance,
        goal_distance=goal_distance,
    )
    travelled = world.distance - state.world.distance
    shaping_reward = params.shaping * (previous_distance - goal_distance)
    reward = succeeds.astype(jnp.float32) - params.metre_cost * travelled + shaping_reward
    return next_state, reward, info


def _observe(
    key: Array, state: EnvironmentState, params: EnvironmentParams
) -> tuple[Array, EnvironmentState]:
    """Sense, update the memory, and assemble the observation vector."""
    scan = sense(key, state.world, state.scenario, params.sensor, num_detections=NUM_DETECTIONS)
    (x, y, heading), bearing = scan.pose, scan.detection_bearing
    position = scan.detection_range[None] * jnp.stack([jnp.cos(bearing), jnp.sin(bearing)])
    position = jnp.where(scan.is_detection[None], position, 0)  # f32[2, D] ahead, left
    command = params.command
    is_match = scan.is_detection[None] & jnp.stack(  # bool[2, D] goal type, landmark type
        [
            (scan.detection_type == command.figure) | (command.figure == ANYTHING),
            scan.detection_type == command.landmark,
        ]
    )
    state = _remember(state, scan.pose, is_match, position, params)
    offset = state.last_position - scan.pose[None, :2]
    last_ahead, last_left = rotate(offset[:, 0], offset[:, 1], -heading)
    parts = [
        jnp.stack([x, y, jnp.cos(heading), jnp.sin(heading)]),
        state.scenario.area,
        scan.sensor.range_max[None],
        command.embedding,
        jnp.stack([scan.is_detection, *position, *is_match], axis=1).reshape(-1),
        (state.is_detected[None] * jnp.stack([jnp.ones(2), last_ahead, last_left])).T.reshape(-1),
        state.is_covered.reshape(-1),
    ]
    observation = jnp.concatenate([part.astype(jnp.float32) for part in parts])
    return jnp.clip(observation, -MAX_OBSERVATION, MAX_OBSERVATION), state


def _remember(
    state: EnvironmentState, pose: Array, is_match: Array, offset: Array, params: EnvironmentParams
) -> EnvironmentState:
    """Update the last positions of goal and landmark type, and the coverage grid.

    ``is_match``: bool[2, D], detections of the two types; ``offset``: f32[2, D], ahead and left.
    """
    nearest = jnp.argmax(is_match, axis=1)  # detections come nearest first
    dx, dy = rotate(offset[0, nearest], offset[1, nearest], pose[2])
    is_visible = is_match.any(axis=1)
    position = jnp.where(
        is_visible[:, None], jnp.stack([pose[0] + dx, pose[1] + dy], 1), state.last_position
    )
    x_min, x_max, y_min, y_max = state.scenario.area
    centre = (jnp.arange(NUM_CELLS) + 0.5) / NUM_CELLS
    y, x = jnp.meshgrid(
        y_min + centre * (y_max - y_min), x_min + centre * (x_max - x_min), indexing="ij"
    )
    eye = eye_of(pose[0], pose[1], pose[2], params.sensor)
    return replace(
        state,
        is_detected=state.is_detected | is_visible,
        last_position=position,
        is_covered=state.is_covered | state.scenario.terrain.view.sees(eye, x, y),
    )
