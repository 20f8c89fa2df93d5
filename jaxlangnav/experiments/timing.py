"""Profiling of a decision cycle: its parts compiled and timed separately, on equal beliefs."""

import os
import platform
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxlangnav.episode import EpisodeState, Task, advance, begin, observe
from jaxlangnav.experiments.experiment import Grid
from jaxlangnav.experiments.monte_carlo import CHUNK_SIZE, NUM_LANES, usable_cores
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.rows import TABLE2_ROWS
from jaxlangnav.experiments.tasks import SENTENCES, ground_sentences
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.semantic_map.behaviors import infer_clause_behaviors

POLICY = "informed"  # the policy measured: the full method of this package
_STEPS = 5  # warm-up cycles, so that beliefs have objects and refuted groundings
_CALLS = 20  # calls of a part in one measurement
_SEED = 4242  # of the worlds; not the default of any table


class Cost(NamedTuple):
    """Measured cost: CPU and wall-clock time."""

    cpu: float  # CPU seconds; wall-clock seconds on an accelerator
    wall: float  # seconds


def describe_machine() -> dict[str, Any]:
    """Describe the machine of a measurement."""
    return {
        "platform": jax.default_backend(),
        "device": jax.devices()[0].device_kind,
        "devices": jax.device_count(),
        "cpu": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "threads": usable_cores(),
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "jax": jax.__version__,
        "numpy": np.__version__,
        "chunk": CHUNK_SIZE,
        "lanes": NUM_LANES,
        "policy": POLICY,
    }


def measure(run: Callable[[], Any], repetitions: int, *, max_seconds: float = float("inf")) -> Cost:
    """Time a warmed-up function: medians of the repetitions within ``max_seconds`` seconds."""
    is_local = jax.default_backend() == "cpu"
    costs, start = [], time.perf_counter()
    while not costs or (len(costs) < repetitions and time.perf_counter() - start < max_seconds):
        cpu, wall = time.process_time(), time.perf_counter()
        jax.block_until_ready(run())
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        costs.append((cpu if is_local else wall, wall))
    return Cost(*np.median(costs, axis=0).tolist())


def measure_parts(
    tasks: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    repetitions: int,
    config: NavigatorConfig,
) -> dict[str, float]:
    """Time a cycle in one batch of episodes, and its sensor, filter and behavior inference.

    ``tasks``, leaves [E ≥ NUM_LANES, …]; ``instructions``, [I, …]. CPU seconds per episode, the
    whole cycle first; planner and motion are the remainder.
    """

    def sense_and_filter(episode: EpisodeState) -> Any:
        belief, readings = episode.navigator.belief, episode.navigator.instruction.readings
        key, observation = jax.random.fold_in(episode.task.key, episode.steps), observe(episode)
        return semantic_filter.step(key, belief, readings, observation, params=params.map)

    def infer_behavior(episode: EpisodeState) -> Any:
        state = episode.navigator
        return infer_clause_behaviors(
            state.belief.particles, state.instruction, state.clause, state.previous_goal
        )

    batch = jax.tree.map(lambda leaf: leaf[:NUM_LANES], tasks)
    episodes = jax.vmap(lambda task: begin(task, instructions, config=config))(batch)

    def compile_part(part: Callable[[EpisodeState], Any]) -> Any:
        return jax.jit(jax.vmap(part)).lower(episodes).compile()

    run_cycle = compile_part(lambda state: advance(state, params=params, config=config)[0])
    for _ in range(_STEPS):
        episodes = run_cycle(episodes)
    cycle_seconds = _episode_seconds(run_cycle, episodes, repetitions)
    sensor_seconds, filter_seconds, behavior_seconds = (
        _episode_seconds(compile_part(part), episodes, repetitions)
        for part in (observe, sense_and_filter, infer_behavior)
    )
    return {
        "the cycle": cycle_seconds,
        "the sensor": sensor_seconds,
        # This part includes the sensor, which is subtracted.
        "the filter": filter_seconds - sensor_seconds,
        "behavior in every particle": behavior_seconds,
        "planner, motion and the rest": cycle_seconds - filter_seconds - behavior_seconds,
    }


def _episode_seconds(part: Any, episodes: EpisodeState, repetitions: int) -> float:
    """Time one call of a part on all concurrent episodes; seconds per episode."""
    jax.block_until_ready(part(episodes))

    def calls() -> Any:
        return [part(episodes) for _ in range(_CALLS)][-1]

    return measure(calls, repetitions).cpu / _CALLS / NUM_LANES


def cycle_parts(*, params: NavigatorParams) -> dict[str, Any]:
    """Time the parts of a decision cycle, in a batch of episodes of all rows.

    ``cycle_us`` and ``parts_us`` by name, microseconds of one cycle of one episode; ``machine``. A
    remainder that is negative by measurement noise is set to zero.
    """
    machine = describe_machine()
    settings = [spec.setting(seed=_SEED) for spec in TABLE2_ROWS]
    count = -(-NUM_LANES // len(settings))  # episodes per setting
    grid = Grid(settings=settings, arms=(), episodes=count, names=())
    tasks = grid.draw(np.random.default_rng(0).permutation(count * len(settings)))
    instructions = ground_sentences(list(SENTENCES.values())).instructions
    config = navigator_config(POLICY)
    seconds_of = measure_parts(tasks, instructions, params=params, repetitions=3, config=config)
    cycle_seconds = seconds_of.pop("the cycle")
    return {
        "experiment": "time",
        "cycle_us": 1e6 * cycle_seconds,
        "parts_us": {name: max(0.0, 1e6 * seconds) for name, seconds in seconds_of.items()},
        "machine": machine,
    }
