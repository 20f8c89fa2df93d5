"""How the time of a cycle grows with particles, slots, frontier nodes and episodes.

    python benchmarks/scaling.py [--quick] [--json]

Sizes grow tenfold, slots as far as the behavior model takes them; the exponent p of
time ~ size^p between the two largest says how bad the worst term is: 1 is linear. Time of a cycle
is that of one lane of a batch after five cycles; episodes are whole ones. Memory is XLA's own
account of the compiled batch, over its lanes.
"""

import pinning  # noqa: I001 - before JAX and NumPy start their threads

import math
from typing import Any

import jax
import numpy as np
import record
from record import Measurement, entry

from jaxlangnav.episode import advance, begin
from bench import Workbench, set_up
from jaxlangnav.experiments.timing import POLICY, measure
from jaxlangnav.experiments.monte_carlo import LANES, run_tasks
from jaxlangnav.experiments.tasks import take_tasks
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.navigator import NavigatorConfig
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.semantic_map.params import MapConfig

LINEAR = 1.1
"""Exponent that still counts as linear: a tenth for caches and for noise."""
_WARM_UP, _CALLS = 5, 10


def config(*, particles: int = 64, slots: int = 8, blocks: int = 6) -> NavigatorConfig:
    """Build sizes; the blocks must divide the 36 cells of the coverage."""
    return NavigatorConfig(
        map=MapConfig(num_particles=particles, num_objects=slots, num_cells=36),
        planner=PlannerConfig(policy=POLICY, num_blocks=blocks),
    )


def cycle(bench: Workbench, sizes: NavigatorConfig, repetitions: int) -> tuple[float, float]:
    """Measure one cycle of one lane: µs CPU, and bytes of state and scratch."""
    tasks = take_tasks(bench.tasks, np.arange(LANES))

    def one(progress: Any) -> Any:
        return advance(progress, params=bench.params, config=sizes)[0]

    progress = jax.vmap(lambda task: begin(task, bench.instructions, config=sizes))(tasks)
    program = jax.jit(jax.vmap(one)).lower(progress).compile()
    memory = program.memory_analysis()
    assert memory is not None, "this backend does not say how much memory a program takes"
    for _ in range(_WARM_UP):
        progress = program(progress)

    def calls() -> Any:
        return [program(progress) for _ in range(_CALLS)][-1]

    cost = measure(calls, repetitions, patience=20.0).cpu / _CALLS / LANES
    taken = memory.temp_size_in_bytes + memory.argument_size_in_bytes
    return 1e6 * cost, taken / LANES


def grown(name: str, sizes: list[int], costs: list[float], unit: str) -> list[Measurement]:
    """Say how a cost grows from one size to the next."""
    entries = [entry(f"{name} {size}", cost, unit) for size, cost in zip(sizes, costs, strict=True)]
    power = math.log(costs[-1] / costs[-2]) / math.log(sizes[-1] / sizes[-2])
    # Asked of particles and episodes only: the Gaussian of n slots costs n³ by nature.
    target = LINEAR if name.split()[0] in ("particles", "episodes") else None
    label = f"exponent of {name}, {sizes[-2]} to {sizes[-1]}"
    return [*entries, entry(label, power, "", target=target, is_limit=True)]


def entries(*, is_quick: bool) -> list[Measurement]:
    """Measure everything.

    Args:
        is_quick: particles and episodes only, threefold.

    Returns:
        Entries of the bench's document.
    """
    bench = set_up()
    repetitions = 1 if is_quick else 3
    counts = [100, 300] if is_quick else [100, 316, 1000]
    cycles = [cycle(bench, config(particles=count), repetitions) for count in counts]
    found = grown("particles a cycle", counts, [cost for cost, _ in cycles], "µs CPU")
    found += [
        entry(f"memory of an episode under way, {count} particles", memory / 1024, "KiB")
        for count, (_, memory) in zip(counts, cycles, strict=True)
    ]
    batches = [50, 150] if is_quick else [51, 160, 512]
    costs = [whole(bench, size) for size in batches]
    found += grown("episodes of a batch", batches, costs, "s CPU")
    waiting = sum(leaf.nbytes for leaf in jax.tree.leaves(bench.tasks))
    found.append(
        entry("memory of an episode waiting", waiting / len(bench.tasks.key) / 1024, "KiB")
    )
    if is_quick:
        return found
    slots = [2, 4, 8]  # with the mentions and the robot the behavior model takes no more
    costs = [cycle(bench, config(slots=size), repetitions)[0] for size in slots]
    found += grown("slots a cycle", slots, costs, "µs CPU")
    blocks = [6, 12, 18]
    costs = [cycle(bench, config(blocks=size), repetitions)[0] for size in blocks]
    nodes = [size * size for size in blocks]
    return found + grown("frontier nodes a cycle", nodes, costs, "µs CPU")


def whole(bench: Workbench, size: int) -> float:
    """Measure whole episodes: CPU seconds of a batch."""
    tasks = take_tasks(bench.tasks, np.arange(size))

    def work() -> Any:
        return run_tasks(
            tasks, bench.instructions, params=bench.params, config=navigator_config(POLICY)
        )

    work()
    return measure(work, 3, patience=10.0).cpu


if __name__ == "__main__":
    record.main(entries, __doc__, pinning.CORE)
