"""Speed of the engine, as ratios against baselines measured in the same run (section 4.2's runs).

On a CPU costs are CPU seconds, all threads counted, so that other work on the machine disturbs
them little; rates are by the clock on the wall. Every figure is the median of several repetitions
after a first one that warms up; compilation is measured apart.
"""

import dataclasses
import os
import platform
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
from jaxlangnav.experiments.monte_carlo import (
    CHUNK,
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

MONTE_CARLO = 4 * 3 * 6 * 100
"""Episodes of the paper's simulations: templates, commands, ranges, runs."""
_POLICY = "informed"
_EPISODES = 256
"""Episodes of one repetition on one core."""
Entry = dict[str, Any]
Tell = Callable[[str], None]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cost:
    """What something took."""

    cpu: float
    """CPU seconds; seconds on the wall where the work is on another device."""
    wall: float
    """Seconds."""


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
    entries.append(_refilling(bench))
    if not is_quick:
        for lanes in (1, 8, 128):
            tell(f"{lanes} lanes")
            entries.append(_lanes(bench, lanes))
    tell("compilation")
    entries += _compilation(bench)
    return {"machine": machine, "entries": entries}


def describe_machine() -> dict[str, Any]:
    """Say on what the figures were measured."""
    device = jax.devices()[0]
    return {
        "platform": device.platform,
        "device": device.device_kind,
        "devices": jax.device_count(),
        "cpu": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "threads": usable_cores(),
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "jax": jax.__version__,
        "numpy": np.__version__,
        "chunk": CHUNK,
        "lanes": LANES,
        "policy": _POLICY,
    }


def entry(
    name: str,
    value: float,
    unit: str,
    *,
    baseline: float | None = None,
    ratio: float | None = None,
    target: float | None = None,
    is_limit: bool = False,
) -> Entry:
    """Build an entry.

    Args:
        name: what was measured.
        value: ours.
        unit: of value and baseline.
        baseline: theirs, in the same run.
        ratio: how many times better ours is.
        target: of the ratio, or of the value where there is no ratio.
        is_limit: the value is to stay below the target.

    Returns:
        The entry; ``holds`` says whether the target is reached, None without one.
    """
    judged = value if ratio is None else ratio
    holds = None if target is None else bool(judged <= target if is_limit else judged >= target)
    return {
        "name": name,
        "value": value,
        "unit": unit,
        "baseline": baseline,
        "ratio": ratio,
        "target": target,
        "holds": holds,
    }


def measure(work: Callable[[], Any], repetitions: int) -> Cost:
    """Time some work, warmed up by the caller.

    Args:
        work: returns arrays, which are waited for.
        repetitions: how often; the medians count.

    Returns:
        Its cost.
    """
    is_local = jax.default_backend() == "cpu"
    costs = []
    for _ in range(repetitions):
        cpu, wall = time.process_time(), time.perf_counter()
        jax.block_until_ready(work())
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        costs.append((cpu if is_local else wall, wall))
    return Cost(
        cpu=statistics.median(cost[0] for cost in costs),
        wall=statistics.median(cost[1] for cost in costs),
    )


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
    config = navigator_config(_POLICY, particles)
    many = concatenate([bench.tasks] * 2 * usable_cores())
    number = int(many.instruction_index.shape[0])

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
        | _against(ours, looping, 150.0),
        entry(f"cycle against NumPy over all particles at once, {label}", ours, "ms CPU")
        | _against(ours, vectorised, 3.0),
    ]
    if particles == navigator_config(_POLICY).map.num_particles:
        name = f"the paper's {MONTE_CARLO} simulations, {label}"
        alone = MONTE_CARLO * cost.cpu / number / usable_cores()
        entries[1:1] = [
            entry(f"{name}, at this rate", MONTE_CARLO / rate, "s", target=60.0, is_limit=True),
            entry(f"{name}, CPU over threads", alone, "s", target=60.0, is_limit=True),
        ]
    return entries


def _against(ours: float, theirs: float, target: float) -> Entry:
    """Fill in a comparison of costs."""
    ratio = theirs / ours
    return {"baseline": theirs, "ratio": ratio, "target": target, "holds": ratio >= target}


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


def _refilling(bench: Bench) -> Entry:
    """Set refilled lanes against ``vmap`` of the loop over cycles, which waits for the slowest."""
    config = navigator_config(_POLICY)

    def refilled() -> EpisodeResult:
        return run_batch(
            bench.tasks, bench.instructions, params=bench.params, config=config, num_lanes=LANES
        )

    @jax.jit
    def waiting(tasks: Task) -> EpisodeResult:
        def one(task: Task) -> EpisodeResult:
            return run(task, bench.instructions, params=bench.params, config=config)

        return jax.vmap(one)(tasks)

    jax.block_until_ready((refilled(), waiting(bench.tasks)))
    ours = 1e3 * measure(refilled, bench.repetitions).cpu / _EPISODES
    theirs = 1e3 * measure(lambda: waiting(bench.tasks), bench.repetitions).cpu / _EPISODES
    name = f"refilled lanes against vmap of the loop, {_EPISODES} episodes"
    return entry(name, ours, "ms CPU an episode") | _against(ours, theirs, 4.0)


def _lanes(bench: Bench, lanes: int) -> Entry:
    """Measure another number of lanes against the default one."""
    config = navigator_config(_POLICY)
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
    config = navigator_config(_POLICY)
    was_kept = _is_cache_on()
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


def _is_cache_on() -> bool:
    """Tell whether compiled programs are kept on disk."""
    flags: Any = jax.config
    return bool(flags.jax_enable_compilation_cache)


def _recompilations(bench: Bench) -> int:
    """Count programs built while numbers vary; a single cycle stands for all."""
    config = navigator_config(_POLICY)
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


def render(document: dict[str, Any]) -> Any:
    """Draw the figures for people.

    Args:
        document: of ``run_bench``.

    Returns:
        A rich table.
    """
    from rich.table import Table

    machine = document["machine"]
    caption = (
        f"{machine['device']}, {machine['threads']} threads, load {machine['load']} at the start; "
        f"JAX {machine['jax']}; policy {machine['policy']}, at most {MAX_STEPS} cycles an episode; "
        f"at most {machine['chunk']} episodes a call, in {machine['lanes']} lanes."
    )
    table = Table(title="Speed", caption=caption, caption_justify="left")
    table.add_column("Measured")
    for heading in ("Ours", "Baseline", "Ratio", "Target", "Holds"):
        table.add_column(heading, justify="right", no_wrap=True)
    for one in document["entries"]:
        holds = {True: "yes", False: "no", None: ""}[one["holds"]]
        table.add_row(
            one["name"],
            f"{one['value']:.3g} {one['unit']}".strip(),
            _number(one["baseline"]),
            _number(one["ratio"]),
            _number(one["target"]),
            holds,
        )
    return table


def _number(value: float | None) -> str:
    """Write a number, or nothing."""
    return "" if value is None else f"{value:.3g}"
