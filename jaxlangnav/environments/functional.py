"""Following a command as a pure environment: ``reset`` and ``step`` (section 4.2).

An agent drives the simulated robot of our worlds itself: it is told which of Table 2's commands it
is to carry out, senses what the robot senses, and says stop where it takes the goal to be.

    params = default_params(world="2H1C", relation="behind")
    observation, state = reset(key, params)
    observation, state, reward, is_over, info = step(key, state, action, params)

Where episodes follow one another, worlds are drawn ahead:

    pool = draw_pool(key, params.law)
    observation, state, reward, is_over, info = step_and_reset(key, state, action, params, pool)

Everything is ``jit``- and ``vmap``-able; ``params`` are traced and may differ from lane to lane.
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.episode import MAX_STEPS
from jaxlangnav.experiments.tasks import SENTENCES
from jaxlangnav.inputs.limits import refuse_below
from jaxlangnav.messages import MotionParams, SensorParams, default_motion, default_sensor
from jaxlangnav.pytree import pytree
from jaxlangnav.world import simulator
from jaxlangnav.world.motion import carry_out, plain_action
from jaxlangnav.world.scenario import ScenarioLaw, draw_scenario, scenario_law
from jaxlangnav.world.sensor import NUM_DETECTIONS, sense
from jaxlangnav.world.state import CONE, HYDRANT, Scenario, WorldState

ACTION_SIZE = 3
STOP_ABOVE = 0.9
"""An action stops where its last entry is above this: one in twenty of uniformly random ones."""
NUM_DIRECTIONS = 16


_TURNS = np.arange(NUM_DIRECTIONS) * (2.0 * math.pi / NUM_DIRECTIONS)
DISCRETE_ACTIONS = np.array(
    [[0.0, 0.0, 1.0], *([np.cos(turn), np.sin(turn), -1.0] for turn in _TURNS)], np.float32
)
"""f32[17, 3], the discrete actions: stop, then the greatest step in 16 directions, +x to +y."""


BOUND = 100.0  # entries of an observation are clipped to plus and minus this
OBSERVATION_SIZE = 12 + 5 * NUM_DETECTIONS


NUM_WORLDS = 1024
"""Worlds of a pool unless told otherwise: 150 kB, and an average's σ/√N is 3 % of σ."""
_SLICE = 64  # worlds drawn together; all at once would hold every place tried
DEFAULT_RELATION = "behind"


@functools.partial(jax.jit, static_argnames="num_worlds")
def draw_pool(key: Array, law: ScenarioLaw, *, num_worlds: int = NUM_WORLDS) -> Scenario:
    """Draw the worlds of a pool, a leading axis N ≥ 1 on every leaf; another N recompiles.

    Limits: one world makes every episode the same place; a world that does not meet the law is
    replaced by one of the pool that does (if there is one).
    """
    refuse_below(1, num_worlds=num_worlds)
    keys = jax.random.split(key, num_worlds)
    drawn = jax.lax.map(lambda one: draw_scenario(one, law), keys, batch_size=_SLICE)
    best = jnp.argsort(~drawn.is_valid, stable=True)
    number = jnp.maximum(jnp.sum(drawn.is_valid), 1)
    return jax.tree.map(lambda leaf: leaf[best[jnp.arange(num_worlds) % number]], drawn)


def pick_world(key: Array, pool: Scenario) -> Scenario:
    """Take one of the N worlds of a pool by lot."""
    # One draw where randint takes four; 2³² is so large that its remainder favours nobody.
    index = jax.random.bits(key) % jnp.uint32(pool.goal_index.shape[0])
    return jax.tree.map(lambda leaf: leaf[index], pool)


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
    relation: str = DEFAULT_RELATION,
    sensing_range: float = 3.0,
    max_steps: int = MAX_STEPS,
    metre_cost: float = 0.01,
) -> EnvironmentParams:
    """Build the parameters of an environment, with the default noise of all tables.

    ``world``: a template such as "2H1C"; ``relation``: "null", "behind" or "nearest", which command
    is given; ``sensing_range``: metres; ``max_steps``: those after which an episode is cut off;
    ``metre_cost``: subtracted from the reward for each metre travelled. ``ValueError``: an unknown
    world or relation, or a number outside its limits.
    """
    if not sensing_range > 0.0:
        raise ValueError(f"sensing_range is {sensing_range:g}, but must be above 0 m")
    refuse_below(1, max_steps=max_steps)
    return EnvironmentParams(
        law=scenario_law(template=world, relation=relation),
        sensor=default_sensor(sensing_range),
        motion=default_motion(),
        max_steps=jnp.int32(max_steps),
        metre_cost=jnp.float32(metre_cost),
    )


def reset(
    key: Array, params: EnvironmentParams, pool: Scenario | None = None
) -> tuple[Array, EnvironmentState]:
    """Put the robot at the start of a world, fresh or of a ``pool``: observation f32[52], state."""
    world_key, sense_key = jax.random.split(key)
    state = _begin(world_key, params, pool)
    return _observe(sense_key, state, params), state


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
            (1 m), and stop where above ``STOP_ABOVE``. A step longer than the greatest
            one is shortened. ``DISCRETE_ACTIONS`` lists some.
        params: the environment.

    Returns:
        Observation f32[52], state, reward f32[], bool[] whether the episode is over, and info.
    """
    move_key, sense_key = jax.random.split(key)
    after, reward, info = _advance(move_key, state, action, params)
    observation = _observe(sense_key, after, params)
    return observation, after, reward, info.is_stopped | info.is_cut_off, info


def step_and_reset(
    key: Array,
    state: EnvironmentState,
    action: Array,
    params: EnvironmentParams,
    pool: Scenario | None = None,
) -> tuple[Array, EnvironmentState, Array, Array, EnvironmentInfo]:
    """Carry out one action and begin the next episode at once where one ends, as gymnax does.

    As ``step``; observation and state are those of a new episode where one is over. ``pool`` is as
    of ``reset``; without it a world is drawn in every step.
    """
    move_key, world_key, sense_key = jax.random.split(key, 3)
    after, reward, info = _advance(move_key, state, action, params)
    is_over = info.is_stopped | info.is_cut_off
    fresh = _begin(world_key, params, pool)
    after = jax.tree.map(functools.partial(jnp.where, is_over), fresh, after)
    return _observe(sense_key, after, params), after, reward, is_over, info


def step_or_reset(
    key: Array,
    state: EnvironmentState,
    action: Array,
    params: EnvironmentParams,
    pool: Scenario | None,
    is_over: Array,
) -> tuple[Array, EnvironmentState, Array, EnvironmentInfo]:
    """Carry out one action, or begin a new episode where the last one ``is_over``, bool[].

    As ``step_and_reset``, but where a new episode begins the action has no effect, and reward and
    info are zero. Observation, state, reward and info.
    """
    move_key, world_key, sense_key = jax.random.split(key, 3)
    after, reward, info = _advance(move_key, state, action, params)
    reward, info = jax.tree.map(
        lambda leaf: jnp.where(is_over, jnp.zeros_like(leaf), leaf), (reward, info)
    )
    fresh = _begin(world_key, params, pool)
    after = jax.tree.map(functools.partial(jnp.where, is_over), fresh, after)
    return _observe(sense_key, after, params), after, reward, info


def _begin(key: Array, params: EnvironmentParams, pool: Scenario | None) -> EnvironmentState:
    """Put the robot at the start of a world: one of the pool, or a new one."""
    scenario = draw_scenario(key, params.law) if pool is None else pick_world(key, pool)
    world = simulator.reset(scenario)
    return EnvironmentState(scenario=scenario, world=world, steps=jnp.int32(0))


def _advance(
    key: Array, state: EnvironmentState, action: Array, params: EnvironmentParams
) -> tuple[EnvironmentState, Array, EnvironmentInfo]:
    """Move and judge; nothing is sensed yet."""
    action = jnp.clip(action, -1.0, 1.0)
    is_stopped = action[2] > STOP_ABOVE
    way = action[:2] * params.motion.step_length
    order = plain_action(state.world.odometry[:2] + way, way, is_stopped)
    world = carry_out(key, state.world, order, params.motion)
    after = EnvironmentState(scenario=state.scenario, world=world, steps=state.steps + 1)
    is_success = simulator.is_success(world, state.scenario, is_stopped)
    info = EnvironmentInfo(
        is_success=is_success,
        is_stopped=is_stopped,
        is_cut_off=~is_stopped & (after.steps >= params.max_steps),
        distance=world.distance,
        goal_distance=simulator.goal_distance(world, state.scenario),
    )
    travelled = world.distance - state.world.distance
    return after, is_success.astype(jnp.float32) - params.metre_cost * travelled, info


def _observe(key: Array, state: EnvironmentState, params: EnvironmentParams) -> Array:
    seen = sense(key, state.world, state.scenario, params.sensor)
    x, y, heading = seen.pose[0], seen.pose[1], seen.pose[2]
    told = (jnp.arange(len(SENTENCES)) == params.law.relation).astype(jnp.float32)
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
    reach, area = seen.sensor.range_max[None], state.scenario.area
    parts = [own, area, reach, told, detections.reshape(-1)]
    return jnp.clip(jnp.concatenate(parts), -BOUND, BOUND)
