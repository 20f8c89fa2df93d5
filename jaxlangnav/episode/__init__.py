"""Simulated episode: navigator and world in closed loop until it stops (``run``, a pure function).

The result depends on the task's key only; ``lanes`` runs batches.
"""

import functools

import chex
import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav import navigator
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.messages import Fault, MotionParams, Observation, SensorParams, Status
from jaxlangnav.navigator import NavigatorConfig, NavigatorInfo, NavigatorParams, NavigatorState
from jaxlangnav.numerics.batching import select_row
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.world import simulator
from jaxlangnav.world.motion import HOLONOMIC, Body, stop_at_wall
from jaxlangnav.world.sensor import sense
from jaxlangnav.world.state import Scenario, WorldState

MAX_STEPS = 120  # decision cycles after which an episode that has not stopped counts as a time-out


@pytree
class Task:
    """Inputs of one episode: key, scenario, instruction and models of sensor and motion."""

    key: Array  # typed key of this episode
    scenario: Scenario
    instruction_index: Array  # i32[] index into the batch's instructions
    sensor: SensorParams
    motion: MotionParams
    body: Body = HOLONOMIC  # motion model of the robot
    assumed_sensor: SensorParams | None = None  # sensor model of the belief; None: true one


@pytree
class EpisodeResult:
    """Outcome and statistics of an episode: one row of a results table."""

    is_success: Array  # bool[] reported arrival within 1.5 m of the intended goal
    is_stopped: Array  # bool[] the task ended; otherwise it timed out
    ending: Array  # i32[] final messages.Status; that of the last cycle after a time-out
    distance: Array  # f32[] metres truly travelled
    steps: Array  # i32[] decision cycles
    final: Array  # f32[2] metres, map frame: true final position
    goal_distance: Array  # f32[] metres from the final position to the goal
    overflow: Array  # i32[] detections for which no object slot was free
    degenerate: Array  # i32[] steps at which all particle weights vanished
    contradictions: Array  # i32[] steps at which the observation contradicted the map
    faults: Array  # i32[] steps at which the robot stood still because of a fault
    mean_effective_sample_size: Array  # f32[] over the steps
    is_valid: Array  # bool[] the scenario satisfies its template's constraints


COUNTS = ("overflow", "degenerate", "contradictions", "faults")
"""Fields of ``EpisodeResult`` that are counted step by step."""


@pytree
class EpisodeState:
    """State of a running episode: loop carry of ``run``."""

    task: Task
    navigator: NavigatorState
    world: WorldState
    steps: Array  # i32[] decision cycles so far
    counts: dict[str, Array]  # i32[] each, ``COUNTS`` so far
    sum_effective_sample_size: Array  # f32[] over the steps so far


def begin(task: Task, instructions: Instruction, *, config: NavigatorConfig) -> EpisodeState:
    """Initialize robot and navigator for a task; ``instructions``: leaves [I, …]."""
    scenario = task.scenario
    chex.assert_shape([scenario.start, scenario.area, scenario.goal], [(3,), (4,), (2,)])
    chex.assert_rank([task.key, task.instruction_index, task.sensor.range_max], 0)
    chex.assert_equal_shape([scenario.object_x, scenario.object_y, scenario.is_object])
    chex.assert_type([scenario.object_type, scenario.is_object], [int, bool])
    instruction = select_row(instructions, task.instruction_index)
    pose_and_area = scenario.start, scenario.area
    environment = {"terrain": scenario.terrain, "sensor_model": scenario.sensor_model}
    return EpisodeState(
        task=task,
        navigator=navigator.start(instruction, *pose_and_area, config=config, **environment),
        world=simulator.reset(scenario),
        steps=jnp.int32(0),
        counts=dict.fromkeys(COUNTS, jnp.int32(0)),
        sum_effective_sample_size=jnp.float32(0.0),
    )


def _step_keys(state: EpisodeState) -> Array:
    """Derive the next step's keys, key[3]: sensing, decision, motion."""
    return jax.random.split(jax.random.fold_in(state.task.key, state.steps), 3)


def observe(state: EpisodeState) -> Observation:
    """Simulate the observation of the next step; deterministic in the state."""
    task, key = state.task, _step_keys(state)[0]
    return sense(key, state.world, task.scenario, task.sensor, task.assumed_sensor)


def advance(
    state: EpisodeState, *, params: NavigatorParams, config: NavigatorConfig
) -> tuple[EpisodeState, NavigatorInfo, Observation]:
    """Run one cycle: sense, decide, move; also return the decision's diagnostics and input."""
    task, (_, decide_key, move_key) = state.task, _step_keys(state)
    observation = observe(state)
    agent, action, info = navigator.step(
        decide_key, state.navigator, observation, params=params, config=config
    )
    proposed = task.body.move(move_key, state.world, action, task.motion)
    world = stop_at_wall(state.world, proposed, task.scenario.terrain)
    return replace(add_counts(state, info), navigator=agent, world=world), info, observation


def add_counts(state: EpisodeState, info: NavigatorInfo) -> EpisodeState:
    """Count one more step, and add its diagnostics to the episode's counters."""
    filter_info, weights = info.filter, int(Fault.WEIGHTS)
    increments = {
        "overflow": filter_info.overflow,
        "degenerate": (info.fault & weights) != 0,
        "contradictions": filter_info.is_contradiction,
        "faults": (info.fault & ~weights) != 0,
    }
    return replace(
        state,
        steps=state.steps + 1,
        counts=jax.tree.map(jnp.add, state.counts, increments),
        sum_effective_sample_size=state.sum_effective_sample_size
        + filter_info.effective_sample_size,
    )


def finish(state: EpisodeState) -> EpisodeResult:
    """Compute the result of an episode from its final state."""
    status, world, scenario = state.navigator.status, state.world, state.task.scenario
    steps = jnp.maximum(state.steps, 1).astype(jnp.float32)
    return EpisodeResult(
        is_success=simulator.is_success(world.position, scenario, status == Status.ARRIVED),
        is_stopped=state.navigator.is_done,
        ending=status,
        distance=world.distance,
        steps=state.steps,
        final=world.position,
        goal_distance=simulator.goal_distance(world, scenario),
        mean_effective_sample_size=state.sum_effective_sample_size / steps,
        is_valid=scenario.is_valid,
        **state.counts,
    )


@functools.partial(jax.jit, static_argnames=("config", "max_steps"))
def run(
    task: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
) -> EpisodeResult:
    """Run one episode, language included, as one jitted function; ``params`` are traced.

    ``task``: key, scenario, sentence (one of ``instructions``, leaves [I, …]), sensor and odometry;
    ``max_steps``: cycles until a time-out.
    """

    def is_running(state: EpisodeState) -> Array:
        return ~state.navigator.is_done & (state.steps < max_steps)

    def body(state: EpisodeState) -> EpisodeState:
        return advance(state, params=params, config=config)[0]

    return finish(jax.lax.while_loop(is_running, body, begin(task, instructions, config=config)))
