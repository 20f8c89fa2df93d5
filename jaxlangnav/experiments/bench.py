"""Speed of the engine, as ratios against baselines measured in the same run (section 4.2's runs).

On a CPU costs are CPU seconds, all threads counted, so that other work on the machine disturbs
them little; rates are by the clock on the wall. Every figure is the median of several repetitions
after a first one that warms up; compilation is measured apart.
"""

import dataclasses
import statistics
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.compilation_cache import compilation_cache

from jaxlangnav.episode import MAX_STEPS, EpisodeResult, Task, run, run_batch
from jaxlangnav.experiments import numpy_twin
from jaxlangnav.experiments.breakdown import shares
from jaxlangnav.experiments.measuring import (
    POLICY,
    Entry,
    against,
    describe_machine,
    entry,
    is_cache_on,
    measure,
    render,
)
from jaxlangnav.experiments.monte_carlo import (
    LANES,
    cell,
    concatenate,
    make_tasks,
    run_tasks,
    usable_cores,
)
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.sentences import SENTENCES, ground_sentences
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.navigator import NavigatorParams, default_params
from jaxlangnav.pytree import replace
from jaxlangnav.world.templates import TABLE_2

__all__ = ["render", "run_bench"]

MONTE_CARLO = 4 * 3 * 6 * 100
"""Episodes of the paper's simulations: templates, commands, ranges, runs."""
_EPISODES = 256
"""Episodes of one repetition on one core."""
Tell = Callable[[str], None]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Bench:
    """What all measurements share."""

    tasks: Task
    """_EPISODES episodes of the rows of Table 2, mixed."""
    instructions: Instruction
    params: NavigatorParams
    repetitions: int


def run_bench(*, is_quick: bool = False, on_progress: Tell | None = None) -> dict[str, Any]:
    """Measure speed.

    Args:
        is_quick: the default particle count only, fewer repetitions, no lane counts.
        on_progress: called with what is being measured.

    Returns:
        ``machine`` and ``entries``, each with ``name``, ``value``, ``unit``, ``baseline``,
        ``ratio``, ``target`` and ``holds``; None where there is no such thing.
    """
    tell: Tell = (lambda what: None) if on_progress is None else on_progress
    bench = _set_up(1 if is_quick else 3)
    machine = describe_machine()
    entries: list[Entry] = []
    for particles in (64,) if is_quick else (64, 256, 1000):
        tell(f"the full loop, {particles} particles")
        entries += _full_loop(bench, particles)
    tell("lanes without refilling")
    entries.append(_refilling(bench, 1 if is_quick else 4))
    if not is_quick:
        for lanes in (1, 8, 128):
            tell(f"{lanes} lanes")
            entries.append(_lanes(bench, lanes))
        tell("the parts of a cycle")
        entries += shares(
            bench.tasks,
            bench.instructions,
            params=bench.params,
            repetitions=bench.repetitions,
        )
    tell("compilation")
    entries += _compilation(bench)
    return {"machine": machine, "entries": entries}


def _set_up(repetitions: int) -> Bench:
    """Draw the episodes that all measurements run."""
    order = list(SENTENCES)
    number = -(-_EPISODES // len(TABLE_2))
    tasks = concatenate(
        [
            make_tasks(
                cell(row.world, row.relation, order.index(row.relation), row.range, number, 4242)
            )
            for row in TABLE_2
        ]
    )
    shuffled = np.random.default_rng(0).permutation(number * len(TABLE_2))[:_EPISODES]
    sentences = ground_sentences(list(SENTENCES.values()))
    return Bench(
        tasks=jax.tree.map(lambda leaf: leaf[shuffled], tasks),
        instructions=sentences.instructions,
        params=default_params(),
        repetitions=repetitions,
    )


def _full_loop(bench: Bench, particles: int) -> list[Entry]:
    """Measure whole episodes, and one cycle against the NumPy twin."""
    config = navigator_config(POLICY, particles)
    # About the same work at every size: fewer episodes where a cycle costs more.
    share = max(3, 2 * _EPISODES * 64 // particles // LANES) * LANES
    number = share * usable_cores()
    rounds = -(-number // _EPISODES)
    many = concatenate([bench.tasks] * rounds)
    many = jax.tree.map(lambda leaf: leaf[:number], many)

    def work() -> EpisodeResult:
        return run_tasks(many, bench.instructions, params=bench.params, config=config)

    steps = int(np.sum(np.asarray(work().steps)))
    cost = measure(work, bench.repetitions)
    rate = number / cost.wall
    ours = 1e3 * cost.cpu / steps
    looping, vectorised = (
        1e3 * _twin_seconds(particles, is_looping=is_looping) for is_looping in (True, False)
    )
    label = f"{particles} particles"
    entries = [
        entry(f"episodes, {label}", rate, "1/s"),
        entry(f"cycle against NumPy with loops over particles, {label}", ours, "ms CPU")
        | against(ours, looping, 150.0),
        entry(f"cycle against NumPy over all particles at once, {label}", ours, "ms CPU")
        | against(ours, vectorised, 3.0),
    ]
    if particles == navigator_config(POLICY).map.num_particles:
        name = f"the paper's {MONTE_CARLO} simulations, {label}"
        alone = MONTE_CARLO * cost.cpu / number / usable_cores()
        entries[1:1] = [
            entry(f"{name}, at this rate", MONTE_CARLO / rate, "s", target=60.0, is_limit=True),
            entry(f"{name}, CPU over threads", alone, "s", target=60.0, is_limit=True),
        ]
    return entries


def _twin_seconds(particles: int, *, is_looping: bool, steps: int = 12) -> float:
    """Measure a cycle of the NumPy twin on a walk past a cone and a hydrant, CPU seconds."""
    costs = []
    for seed in range(3):
        twin = numpy_twin.start(particles, seed=seed)
        noise = np.random.default_rng(seed)
        robot = np.zeros(2)
        begin = time.process_time()
        for index in range(steps):
            move = np.array([0.7, 0.12]) if index else np.zeros(2)
            robot = robot + move
            seen = [
                (kind, *(np.array(place) - robot + noise.normal(0.0, 0.1, 2)))
                for kind, place in ((1, (6.0, 1.0)), (0, (8.0, 1.5)))
                if np.hypot(*(np.array(place) - robot)) < 3.0
            ]
            numpy_twin.step(twin, move, seen, 3.0, is_looping=is_looping)
        costs.append((time.process_time() - begin) / steps)
    return statistics.median(costs)


def _refilling(bench: Bench, times: int) -> Entry:
    """Set refilled lanes against ``vmap`` of the loop over cycles, which waits for the slowest."""
    tasks = concatenate([_again(bench.tasks, index) for index in range(times)])
    number = times * _EPISODES
    config = navigator_config(POLICY)

    def refilled() -> EpisodeResult:
        return run_batch(
            tasks, bench.instructions, params=bench.params, config=config, num_lanes=LANES
        )

    @jax.jit
    def waiting(many: Task) -> EpisodeResult:
        def one(task: Task) -> EpisodeResult:
            return run(task, bench.instructions, params=bench.params, config=config)

        return jax.vmap(one)(many)

    jax.block_until_ready((refilled(), waiting(tasks)))
    ours = 1e3 * measure(refilled, bench.repetitions).cpu / number
    theirs = 1e3 * measure(lambda: waiting(tasks), bench.repetitions).cpu / number
    name = f"refilled lanes against vmap of the loop, {number} episodes"
    return entry(name, ours, "ms CPU an episode") | against(ours, theirs, 4.0)


def _again(tasks: Task, index: int) -> Task:
    """Repeat tasks with other noise; the first time they stay as they are."""
    if not index:
        return tasks
    keys = jax.vmap(lambda key: jax.random.fold_in(key, index))(tasks.key)
    return replace(tasks, key=keys)


def _lanes(bench: Bench, lanes: int) -> Entry:
    """Measure another number of lanes against the default one."""
    config = navigator_config(POLICY)
    number = min(_EPISODES, 32 * lanes)
    tasks = jax.tree.map(lambda leaf: leaf[:number], bench.tasks)

    def with_lanes(count: int) -> float:
        def work() -> EpisodeResult:
            return run_batch(
                tasks, bench.instructions, params=bench.params, config=config, num_lanes=count
            )

        steps = int(np.sum(np.asarray(work().steps)))
        return 1e3 * measure(work, bench.repetitions).cpu / steps

    ours, theirs = with_lanes(LANES), with_lanes(lanes)
    name = f"cycle in {LANES} lanes against {lanes}, {number} episodes"
    return entry(name, ours, "ms CPU", baseline=theirs, ratio=theirs / ours)


def _compilation(bench: Bench) -> list[Entry]:
    """Measure compilation without the persistent cache, and count recompilations."""
    config = navigator_config(POLICY)
    was_kept = is_cache_on()
    try:
        jax.config.update("jax_enable_compilation_cache", False)
        compilation_cache.reset_cache()
        begin, cpu = time.perf_counter(), time.process_time()
        lowered = run_batch.lower(
            bench.tasks,
            bench.instructions,
            params=bench.params,
            config=config,
            num_lanes=LANES,
            # Another program than any that is kept in memory.
            max_steps=MAX_STEPS - 1,
        )
        traced = time.perf_counter() - begin
        lowered.compile()
        cold, cold_cpu = time.perf_counter() - begin, time.process_time() - cpu
    finally:
        jax.config.update("jax_enable_compilation_cache", was_kept)
        compilation_cache.reset_cache()
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


def _recompilations(bench: Bench) -> int:
    """Count programs built while numbers vary; a single cycle stands for all."""
    config = navigator_config(POLICY)
    count = 0

    @jax.jit
    def one(task: Task, params: NavigatorParams) -> EpisodeResult:
        nonlocal count
        count += 1
        return run(task, bench.instructions, params=params, config=config, max_steps=1)

    first = jax.tree.map(lambda leaf: leaf[0], bench.tasks)
    for value in (0.7, 0.8, 0.9):
        planner = replace(bench.params.planner, discount=jnp.float32(value))
        sensor = replace(first.sensor, range_max=jnp.float32(10.0 * value))
        params = replace(bench.params, planner=planner)
        jax.block_until_ready(one(replace(first, sensor=sensor), params))
    return count - 1
