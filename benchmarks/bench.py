"""Benchmarks of the navigator, as ratios to baselines measured in the same run (section 4.2).

On a CPU costs are CPU seconds, all threads counted, so that other work on the machine disturbs
them little; rates are by the clock on the wall. Every figure is the median of several repetitions
after a first one that warms up, long ones excepted, which run once; compilation is measured apart.
"""

import contextlib
import dataclasses
import functools
import itertools
import statistics
import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy_twin
from jax.experimental.compilation_cache import compilation_cache
from record import Measurement, against, entry, render

from jaxlangnav.episode import MAX_STEPS, EpisodeResult, Task, run
from jaxlangnav.episode.lanes import run_batch
from jaxlangnav.experiments.monte_carlo import NUM_LANES, run_tasks, usable_cores
from jaxlangnav.experiments.paper import SENSING_RANGES
from jaxlangnav.experiments.policies import DEFAULT_PARTICLES, navigator_config
from jaxlangnav.experiments.rows import RowSpec
from jaxlangnav.experiments.tasks import (
    SENTENCES,
    concatenate,
    ground_sentences,
    make_tasks,
    take_tasks,
)
from jaxlangnav.experiments.timing import POLICY, describe_machine, measure, measure_parts
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.navigator import NavigatorParams, default_params
from jaxlangnav.navigator.deployment import deployment_config, deployment_params
from jaxlangnav.pytree import replace
from jaxlangnav.world.templates import TEMPLATE_NAMES

__all__ = ["Workbench", "render", "run_bench", "set_up", "stages"]

MONTE_CARLO = len(TEMPLATE_NAMES) * len(SENTENCES) * len(SENSING_RANGES) * 100
"""Episodes of the paper's simulations: templates, commands, ranges, runs."""
_MAX_SECONDS = 10.0  # after which no measurement is repeated
OnProgress = Callable[[str, int], None]
Stage = tuple[str, Callable[[], list[Measurement]]]
"""Description of a measurement, and its function."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Workbench:
    """Inputs shared by all measurements."""

    tasks: Task
    """Shuffled episodes of the paper's grid, as many as the largest batch."""
    instructions: Instruction
    params: NavigatorParams
    repetitions: int
    is_quick: bool


def run_bench(bench: Workbench, *, on_progress: OnProgress | None = None) -> dict[str, Any]:
    """Measure speed.

    Args:
        bench: of ``set_up``.
        on_progress: called with what is measured next and how many stages have just ended.

    Returns:
        ``machine`` and ``entries``, each with ``name``, ``value``, ``unit``, ``baseline``,
        ``ratio``, ``target`` and ``holds``; None where there is no such thing.
    """
    machine = describe_machine()
    entries: list[Measurement] = []
    for index, (name, measure_stage) in enumerate(stages(bench)):
        if on_progress is not None:
            on_progress(name, min(index, 1))
        entries += measure_stage()
    return {"machine": machine, "entries": entries}


def stages(bench: Workbench) -> list[Stage]:
    """List the measurements in order."""
    counts = (DEFAULT_PARTICLES,) if bench.is_quick else (64, 256, 1000)
    loops = [
        (f"the full loop, {count} particles", functools.partial(_full_loop, bench, count))
        for count in counts
    ]
    return [
        *loops,
        ("lanes without refilling", lambda: [_refilling(bench)]),
        ("the parts of a cycle", lambda: _parts(bench)),
        ("compilation", lambda: _compilation(bench)),
    ]


def set_up(*, is_quick: bool = False) -> Workbench:
    """Sample the episodes that all measurements run.

    Args:
        is_quick: the default particle count only, smaller batches, fewer repetitions.

    Returns:
        The inputs of all measurements.
    """
    largest = 256 if is_quick else 512
    grid = list(itertools.product(TEMPLATE_NAMES, SENTENCES, SENSING_RANGES))
    count = -(-largest // len(grid))
    cells = [
        RowSpec(world=world, range=sensing_range, relation=relation).setting(seed=4242)
        for world, relation, sensing_range in grid
    ]
    shuffled = np.random.default_rng(0).permutation(count * len(grid))[:largest]
    return Workbench(
        tasks=take_tasks(concatenate([make_tasks(item, count) for item in cells]), shuffled),
        instructions=ground_sentences(list(SENTENCES.values())).instructions,
        params=default_params(),
        repetitions=1 if is_quick else 3,
        is_quick=is_quick,
    )


def _full_loop(bench: Workbench, particles: int) -> list[Measurement]:
    """Measure whole episodes by batch, and one cycle against the NumPy twin."""
    largest = bench.tasks.instruction_index.shape[0]
    entries: list[Measurement] = []
    # Compiles the program of all batches.
    batch = _measure_batch(bench, particles, 1, repetitions=1)
    for size in (largest,) if bench.is_quick else (1, 64, largest):
        batch = _measure_batch(bench, particles, size, repetitions=bench.repetitions)
        label = f"{particles} particles, batch {size}"
        entries.append(entry(f"episodes, {label}", size / batch.wall, "1/s"))
        entries.append(entry(f"an episode, {label}", 1e3 * batch.cpu / size, "ms CPU"))
    if particles == DEFAULT_PARTICLES:
        entries += _monte_carlo(batch)
    return entries + _against_twin(1e3 * batch.cpu / batch.steps, particles)


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Batch:
    """Measured cost of a batch."""

    size: int  # episodes
    steps: int  # cycles of all of them
    cpu: float  # seconds
    wall: float  # seconds


def _measure_batch(
    bench: Workbench, particles: int, size: int, *, repetitions: int, num_threads: int | None = None
) -> _Batch:
    """Measure the first episodes of the bench with ``run_tasks``."""
    tasks = take_tasks(bench.tasks, np.arange(size))
    config = navigator_config(POLICY, particles)
    results: list[EpisodeResult] = []

    def call() -> None:
        results.append(
            run_tasks(
                tasks,
                bench.instructions,
                params=bench.params,
                config=config,
                num_threads=num_threads,
            )
        )

    cost = measure(call, repetitions, max_seconds=_MAX_SECONDS)
    return _Batch(size=size, steps=int(np.sum(results[0].steps)), cpu=cost.cpu, wall=cost.wall)


def _monte_carlo(batch: _Batch) -> list[Measurement]:
    """Extrapolate the time of the paper's whole Monte Carlo from a batch."""
    name = f"the paper's {MONTE_CARLO} simulations"
    wall = MONTE_CARLO * batch.wall / batch.size
    cpu = MONTE_CARLO * batch.cpu / batch.size / usable_cores()
    return [
        entry(f"{name}, at this rate", wall, "s", target=60.0, is_limit=True),
        entry(f"{name}, CPU over threads", cpu, "s", target=60.0, is_limit=True),
        entry(f"{name}, CPU over threads, stretch", cpu, "s", target=20.0, is_limit=True),
    ]


def _against_twin(ours: float, particles: int) -> list[Measurement]:
    """Compare a cycle, ms CPU, with the NumPy twin's."""
    looping, vectorised = (
        1e3 * _twin_seconds(particles, is_looping=is_looping) for is_looping in (True, False)
    )
    label = f"{particles} particles"
    return [
        entry(f"cycle against NumPy with loops over particles, {label}", ours, "ms CPU")
        | against(ours, looping, 150.0),
        entry(f"cycle against NumPy over all particles at once, {label}", ours, "ms CPU")
        | against(ours, vectorised, 3.0),
    ]


def _twin_seconds(particles: int, *, is_looping: bool, steps: int = 12) -> float:
    """Measure a cycle of the NumPy twin on a walk past a cone and a hydrant, CPU seconds."""
    costs = []
    for seed in range(3):
        twin = numpy_twin.start(particles, seed=seed)
        rng = np.random.default_rng(seed)
        robot = np.zeros(2)
        begin = time.process_time()
        for index in range(steps):
            move = np.array([0.7, 0.12]) if index else np.zeros(2)
            robot = robot + move
            detections = [
                (kind, *(np.array(place) - robot + rng.normal(0.0, 0.1, 2)))
                for kind, place in ((1, (6.0, 1.0)), (0, (8.0, 1.5)))
                if np.hypot(*(np.array(place) - robot)) < 3.0
            ]
            numpy_twin.step(twin, move, detections, 3.0, is_looping=is_looping)
        costs.append((time.process_time() - begin) / steps)
    return statistics.median(costs)


def _refilling(bench: Workbench) -> Measurement:
    """Compare refilled lanes with ``vmap`` of the episode loop, which waits for the slowest."""
    count = bench.tasks.instruction_index.shape[0]
    config = navigator_config(POLICY)

    def run_all(tasks: Task) -> EpisodeResult:
        def run_one(task: Task) -> EpisodeResult:
            return run(task, bench.instructions, params=bench.params, config=config)

        return jax.vmap(run_one)(tasks)

    program = jax.jit(run_all).lower(bench.tasks).compile()
    refilled = _measure_batch(
        bench, DEFAULT_PARTICLES, count, repetitions=bench.repetitions, num_threads=1
    )
    ours = 1e3 * refilled.cpu / count
    theirs = 1e3 * measure(lambda: program(bench.tasks), 1).cpu / count
    name = f"refilled lanes against vmap of the loop, {count} episodes"
    return entry(name, ours, "ms CPU an episode") | against(ours, theirs, 4.0)


def _parts(bench: Workbench) -> list[Measurement]:
    """Measure the run time of the parts of a cycle."""
    params, inputs = deployment_params(), (bench.tasks, bench.instructions)
    config, count = deployment_config(POLICY, params=params), bench.repetitions
    usual = navigator_config(POLICY)
    parts = measure_parts(*inputs, params=bench.params, repetitions=count, config=usual)
    large = measure_parts(*inputs, params=params, repetitions=count, config=config)
    entries, pretrained = share_entries(parts), share_entries(large, ", as Navigator.pretrained")
    pretrained[0] |= {"target": 2500.0, "holds": pretrained[0]["value"] <= 2500.0}
    return [*entries, *pretrained]


def share_entries(parts: dict[str, float], label: str = "") -> list[Measurement]:
    """Build entries of a cycle's run time: the total, then the fraction of each part."""
    (_, total), *rest = parts.items()
    return [
        entry(f"one cycle of one lane{label}", 1e6 * total, "µs CPU"),
        *(entry(f"share of {name}{label}", 100.0 * seconds / total, "%") for name, seconds in rest),
    ]


@contextlib.contextmanager
def without_cache() -> Iterator[None]:
    """Compile anew, whatever the persistent cache holds."""
    setting = "jax_enable_compilation_cache"
    was_enabled = getattr(jax.config, setting)
    try:
        jax.config.update(setting, False)
        compilation_cache.reset_cache()
        yield
    finally:
        jax.config.update(setting, was_enabled)
        compilation_cache.reset_cache()


def _compilation(bench: Workbench) -> list[Measurement]:
    """Measure compilation without the persistent cache, and count recompilations."""
    config = navigator_config(POLICY)
    with without_cache():
        begin, cpu = time.perf_counter(), time.process_time()
        # A program that is not in the in-memory cache.
        program = functools.partial(
            run_batch, config=config, num_lanes=NUM_LANES, max_steps=MAX_STEPS - 1
        )
        lowered = jax.jit(program).lower(bench.tasks, bench.instructions, params=bench.params)
        traced = time.perf_counter() - begin
        lowered.compile()
        cold, cold_cpu = time.perf_counter() - begin, time.process_time() - cpu
    return [
        entry("compilation of a batch, cold", cold, "s", target=30.0, is_limit=True),
        entry("compilation of a batch, cold, CPU", cold_cpu, "s CPU"),
        entry("tracing and lowering of it", traced, "s"),
        entry(
            "recompilations in a sweep of Params, ranges and noise",
            float(_recompilations(bench)),
            "",
            target=0.0,
            is_limit=True,
        ),
    ]


def _recompilations(bench: Workbench) -> int:
    """Count recompilations while parameters vary, for a single cycle."""
    config = navigator_config(POLICY)
    count = 0

    @jax.jit
    def run_cycle(task: Task, params: NavigatorParams) -> EpisodeResult:
        nonlocal count
        count += 1
        return run(task, bench.instructions, params=params, config=config, max_steps=1)

    first = jax.tree.map(lambda leaf: leaf[0], bench.tasks)
    for value in (0.7, 0.8, 0.9):
        planner = replace(bench.params.planner, discount=jnp.float32(value))
        sensor = replace(first.sensor, range_max=jnp.float32(10.0 * value))
        params = replace(bench.params, planner=planner)
        jax.block_until_ready(run_cycle(replace(first, sensor=sensor), params))
    return count - 1
