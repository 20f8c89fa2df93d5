"""An episode: a navigator in a world until it stops, as one function of arrays (``run``).

Its result depends on its own key only; ``lanes`` runs many.
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
from jaxlangnav.world.motion import HOLONOMIC, Body, halted
from jaxlangnav.world.sensor import sense
from jaxlangnav.world.state import Scenario, WorldState

MAX_STEPS = 120  # decision cycles after which an episode that has not stopped counts as a time-out


@pytree
class Task:
    """One episode to run."""

    key: Array  # typed key, the episode's own
    scenario: Scenario
    instruction_index: Array  # i32[] which of the batch's instructions
    sensor: SensorParams
    motion: MotionParams
    body: Body = HOLONOMIC  # how the robot moves
    told: SensorParams | None = None  # what it takes its detector for; None: what it is


@pytree
class EpisodeResult:
    """How an episode ended; one row of every results table."""

    is_success: Array  # bool[] arrived, by its own account, within 1.5 m of the intended goal
    is_stopped: Array  # bool[] the task ended; otherwise it ran out of time
    ending: Array  # i32[] a messages.Status: at the end; under way where it ran out of time
    distance: Array  # f32[] metres truly travelled
    steps: Array  # i32[] decision cycles
    final: Array  # f32[2] metres, map frame: where it truly ended
    goal_distance: Array  # f32[] metres from there to the goal
    overflow: Array  # i32[] detections that found no free slot
    degenerate: Array  # i32[] steps at which all weights had died
    contradictions: Array  # i32[] steps at which the observation contradicted the map
    faults: Array  # i32[] steps at which the robot stood still for what cannot be was reported
    mean_effective_sample_size: Array  # f32[] over the steps
    is_valid: Array  # bool[] the scenario met its template's law


@pytree
class EpisodeState:
    """An episode under way."""

    task: Task
    navigator: NavigatorState
    world: WorldState
    steps: Array  # i32[]
    overflow: Array  # i32[]
    degenerate: Array  # i32[]
    contradictions: Array  # i32[]
    faults: Array  # i32[]
    sum_effective_sample_size: Array  # f32[]


def begin(task: Task, instructions: Instruction, *, config: NavigatorConfig) -> EpisodeState:
    """Put robot and navigator at the start of a task; ``instructions``: leaves [I, …]."""
    scenario = task.scenario
    chex.assert_shape([scenario.start, scenario.area, scenario.goal], [(3,), (4,), (2,)])
    chex.assert_rank([task.key, task.instruction_index, task.sensor.range_max], 0)
    chex.assert_equal_shape([scenario.object_x, scenario.object_y, scenario.is_object])
    chex.assert_type([scenario.object_type, scenario.is_object], [int, bool])
    instruction = select_row(instructions, task.instruction_index)
    place, none = (scenario.start, scenario.area), jnp.int32(0)
    world = {"terrain": scenario.terrain, "sensor_model": scenario.sensor_model}
    return EpisodeState(
        task=task,
        navigator=navigator.start(instruction, *place, config=config, **world),
        world=simulator.reset(scenario),
        steps=none,
        overflow=none,
        degenerate=none,
        contradictions=none,
        faults=none,
        sum_effective_sample_size=jnp.float32(0.0),
    )


def _step_keys(progress: EpisodeState) -> Array:
    """Derive the next step's keys, key[3]: to sense, to decide, to move."""
    return jax.random.split(jax.random.fold_in(progress.task.key, progress.steps), 3)


def observe(progress: EpisodeState) -> Observation:
    """Sense what the next step is decided by; the same however often it is asked for."""
    task, key = progress.task, _step_keys(progress)[0]
    return sense(key, progress.world, task.scenario, task.sensor, task.told)


def advance(
    progress: EpisodeState, *, params: NavigatorParams, config: NavigatorConfig
) -> tuple[EpisodeState, NavigatorInfo]:
    """Run one cycle: sense, decide, move; the episode a step later, and why it did what it did."""
    return cycle(progress, params=params, config=config)[:2]


def cycle(
    progress: EpisodeState, *, params: NavigatorParams, config: NavigatorConfig
) -> tuple[EpisodeState, NavigatorInfo, Observation]:
    """Run one cycle as ``advance`` does, and return what was sensed in it, too."""
    task, (_, decide_key, move_key) = progress.task, _step_keys(progress)
    observation = observe(progress)
    state, action, info = navigator.step(
        decide_key, progress.navigator, observation, params=params, config=config
    )
    moved = task.body.move(move_key, progress.world, action, task.motion)
    world = halted(progress.world, moved, task.scenario.terrain)
    sums = count(progress, info)
    after = replace(progress, navigator=state, world=world, steps=progress.steps + 1, **sums)
    return after, info, observation


def count(progress: EpisodeState, info: NavigatorInfo) -> dict[str, Array]:
    """Add what one cycle says of itself to the sums of an episode, by the names of their fields."""
    seen, weights = info.filter, int(Fault.WEIGHTS)
    more = {
        "overflow": seen.overflow,
        "degenerate": ((info.fault & weights) != 0).astype(jnp.int32),
        "contradictions": seen.is_contradiction.astype(jnp.int32),
        "faults": ((info.fault & ~weights) != 0).astype(jnp.int32),
        "sum_effective_sample_size": seen.effective_sample_size,
    }
    return {name: getattr(progress, name) + one for name, one in more.items()}


def finish(progress: EpisodeState) -> EpisodeResult:
    """Judge an episode."""
    status, world, scenario = progress.navigator.status, progress.world, progress.task.scenario
    steps = jnp.maximum(progress.steps, 1).astype(jnp.float32)
    return EpisodeResult(
        is_success=simulator.is_success(world, scenario, status == Status.ARRIVED),
        is_stopped=progress.navigator.is_done,
        ending=status,
        distance=world.distance,
        steps=progress.steps,
        final=world.position,
        goal_distance=simulator.goal_distance(world, scenario),
        overflow=progress.overflow,
        degenerate=progress.degenerate,
        contradictions=progress.contradictions,
        faults=progress.faults,
        mean_effective_sample_size=progress.sum_effective_sample_size / steps,
        is_valid=scenario.is_valid,
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

    def is_running(progress: EpisodeState) -> Array:
        return ~progress.navigator.is_done & (progress.steps < max_steps)

    def body(progress: EpisodeState) -> EpisodeState:
        return advance(progress, params=params, config=config)[0]

    start = begin(task, instructions, config=config)
    return finish(jax.lax.while_loop(is_running, body, start))
