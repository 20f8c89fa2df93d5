"""Where a decision cycle's time goes: its parts compiled alone, on the same beliefs."""

import dataclasses
import os
import platform
import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxlangnav.episode import EpisodeState, Task, advance, begin, observe
from jaxlangnav.experiments.experiment import Grid
from jaxlangnav.experiments.monte_carlo import CHUNK, LANES, usable_cores
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.rows import PRINTED
from jaxlangnav.experiments.tasks import SENTENCES, ground_sentences
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.semantic_map.behaviors import infer_clause_behaviors

POLICY = "informed"  # the policy that is measured
_STEPS = 5  # cycles run before the parts are timed: some things are seen, some words are refuted
_CALLS = 20  # calls of a part in one measurement
_SEED = 4242  # of the worlds; none that a table uses by default


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cost:
    """What something took."""

    cpu: float  # CPU seconds; seconds on the wall where the work is on another device
    wall: float  # seconds


def describe_machine() -> dict[str, Any]:
    """Say on what the figures were measured."""
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
        "chunk": CHUNK,
        "lanes": LANES,
        "policy": POLICY,
    }


def measure(work: Callable[[], Any], repetitions: int, *, patience: float = float("inf")) -> Cost:
    """Time work warmed up by the caller: medians, of what fits into ``patience`` seconds."""
    is_local = jax.default_backend() == "cpu"
    costs = []
    begin = time.perf_counter()
    while not costs or (len(costs) < repetitions and time.perf_counter() - begin < patience):
        cpu, wall = time.process_time(), time.perf_counter()
        jax.block_until_ready(work())
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        costs.append((cpu if is_local else wall, wall))
    cpu, wall = np.median(costs, axis=0).tolist()
    return Cost(cpu=cpu, wall=wall)


def measure_parts(
    tasks: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    repetitions: int,
    config: NavigatorConfig,
) -> dict[str, float]:
    """Measure a cycle in one batch of lanes, its sensor, its filter, behavior in every particle.

    ``tasks``, leaves [E ≥ lanes, …]; ``instructions``, leaves [I, …]. CPU seconds of one lane, the
    whole cycle first; planner and motion are what the parts leave over.
    """

    def sense_and_filter(progress: EpisodeState) -> Any:
        state = progress.navigator
        key = jax.random.fold_in(progress.task.key, progress.steps)
        readings, seen = state.instruction.readings, observe(progress)
        return semantic_filter.step(
            key, state.belief, readings, seen, params=params.map, is_sparse=True
        )

    def infer(progress: EpisodeState) -> Any:
        state = progress.navigator
        return infer_clause_behaviors(
            state.belief.particles, state.instruction, state.clause, state.previous_goal
        )

    first = jax.tree.map(lambda leaf: leaf[:LANES], tasks)
    progress = jax.vmap(lambda task: begin(task, instructions, config=config))(first)

    def compiled(part: Callable[[EpisodeState], Any]) -> Any:
        return jax.jit(jax.vmap(part)).lower(progress).compile()

    cycle = compiled(lambda one: advance(one, params=params, config=config)[0])
    for _ in range(_STEPS):
        progress = cycle(progress)
    whole = _seconds(cycle, progress, repetitions)
    sensor, both, inferred = (
        _seconds(compiled(part), progress, repetitions)
        for part in (observe, sense_and_filter, infer)
    )
    return {
        "the cycle": whole,
        "the sensor": sensor,
        # The filter's part has to look as well; the sensor has been counted already.
        "the filter": both - sensor,
        "behavior in every particle": inferred,
        "planner, motion and the rest": whole - both - inferred,
    }


def _seconds(part: Any, progress: EpisodeState, repetitions: int) -> float:
    """Time one call of a part on all lanes, for one of them."""
    jax.block_until_ready(part(progress))

    def calls() -> Any:
        return [part(progress) for _ in range(_CALLS)][-1]

    return measure(calls, repetitions).cpu / _CALLS / LANES


def cycle_parts(*, params: NavigatorParams) -> dict[str, Any]:
    """Measure the parts of a cycle, in a batch of episodes of all rows.

    ``cycle_us`` and ``parts_us`` by name, microseconds of one cycle of one episode; ``machine``,
    ``wall_s``. A part that is left over may come out below zero by the noise of the others; it is
    then counted as nothing.
    """
    start, machine = time.perf_counter(), describe_machine()
    settings, number = [one.setting(seed=_SEED) for one in PRINTED], -(-LANES // len(PRINTED))
    grid = Grid(settings=settings, arms=(), episodes=number, names=())
    tasks = grid.draw(np.random.default_rng(0).permutation(number * len(settings)))
    instructions = ground_sentences(list(SENTENCES.values())).instructions
    config = navigator_config(POLICY)
    measured = measure_parts(tasks, instructions, params=params, repetitions=3, config=config)
    whole = measured.pop("the cycle")
    return {
        "experiment": "time",
        "cycle_us": 1e6 * whole,
        "parts_us": {name: max(0.0, 1e6 * seconds) for name, seconds in measured.items()},
        "machine": machine,
        "wall_s": time.perf_counter() - start,
        "files": [],
    }
