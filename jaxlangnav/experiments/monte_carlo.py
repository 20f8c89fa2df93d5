"""Monte Carlo runner: episodes in fixed-shape batches, on all devices and threads (section 4.2).

Every batch has the same shape, so one compiled program serves the whole grid, and a result does
not depend on the number of episodes or how they are split.
"""

import collections
import concurrent.futures
import dataclasses
import functools
import itertools
import os
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from jaxlangnav.episode import MAX_STEPS, Task
from jaxlangnav.episode.lanes import EPISODE, EpisodeProgram, run_batch
from jaxlangnav.experiments.tasks import take_tasks
from jaxlangnav.navigator import NavigatorConfig
from jaxlangnav.pytree import strong_types

CHUNK_SIZE = 1024  # maximum of episodes a device takes in one call; padding is not run
NUM_LANES = 32  # concurrent episodes on a device
_AXIS = "episodes"  # the mesh's only axis

_programs: dict[Any, Any] = {}
_programs_lock = threading.Lock()
_JOBS_PER_THREAD = 2  # pending jobs, so that no thread waits for the consumer
Job = TypeVar("Job")
Out = TypeVar("Out")
OnProgress = Callable[[int], None]  # called with the number of episodes just finished


@dataclasses.dataclass(frozen=True, kw_only=True)
class DeviceBatch:
    """Input of one device in one call."""

    tasks: Task  # leaves [CHUNK_SIZE, …], see ``pad_chunk``
    count: int  # of them to run; the rest is padding
    params: Any  # of the program


def usable_cores() -> int:
    """Count the cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def concurrent_calls() -> int:
    """Choose the number of concurrent calls: as many as keep all cores, or an accelerator, busy."""
    return 2 if jax.default_backend() != "cpu" else max(1, usable_cores() // mesh().size)


@functools.cache
def mesh() -> Mesh:
    """Build the one-dimensional mesh of this process's devices."""
    devices = jax.local_devices()
    return jax.make_mesh((len(devices),), (_AXIS,), axis_types=(AxisType.Auto,), devices=devices)


def join_devices(
    coordinator: str | None = None, processes: int | None = None, process: int | None = None
) -> tuple[int, int]:
    """Determine this process's rank, from 0, and the number of processes; call it first.

    ``jax.distributed`` asks the launcher (SLURM, Open MPI, Kubernetes, cloud TPUs) for whatever is
    not given: ``coordinator``, host:port of the first process; how many ``processes`` there are;
    which ``process`` this is, from 0. The connection is closed again, so a process that dies later
    stops no other. ``ValueError``: no launcher is known, an argument is missing or inconsistent,
    or the other processes did not connect.
    """
    if coordinator is not None and not re.fullmatch(r".+:\d+", coordinator):
        raise ValueError(f'coordinator is "{coordinator}", but must be HOST:PORT')
    try:
        jax.distributed.initialize(coordinator, processes, process)
        rank = jax.process_index(), jax.process_count()
        jax.distributed.shutdown()
    except (ValueError, RuntimeError, TypeError) as error:
        reason = str(error).strip().split("\n")[0]
        raise ValueError(
            f"cannot join the other processes: {reason} (under a launcher that JAX does not "
            "know, give --coordinator HOST:PORT, --processes and --process)"
        ) from None
    return rank


def pad_chunk(tasks: Task, first: int, size: int) -> Task:
    """Slice ``size`` tasks from ``first`` on and pad to a call's shape: leaves [CHUNK_SIZE, …]."""
    index = np.arange(CHUNK_SIZE)
    return take_tasks(tasks, first + np.where(index < size, index, 0))


def run_round(
    batches: Sequence[DeviceBatch],
    instructions: Any,
    *,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
    program: EpisodeProgram = EPISODE,
) -> list[Any]:
    """Run one call of the program, a chunk on each device; arguments as ``run_tasks``.

    ``batches``: at most one per device; the other devices stay idle. Returns the results of each as
    NumPy arrays, leaves [count, …].
    """
    idle = dataclasses.replace(batches[0], count=0)
    padded = [*batches, *[idle] * (mesh().size - len(batches))]
    inputs = [(item.tasks, item.params, jnp.int32(item.count)) for item in padded]
    stacked = strong_types(jax.tree.map(lambda *leaves: jnp.stack(leaves), *inputs))
    tasks, params, count = jax.device_put(stacked, NamedSharding(mesh(), PartitionSpec(_AXIS)))
    replicated = NamedSharding(mesh(), PartitionSpec())
    args = (tasks, jax.device_put(strong_types(instructions), replicated), params, count)
    avals = tuple(jax.typeof(leaf) for leaf in jax.tree.leaves(args))
    key = (config, max_steps, program, NUM_LANES, mesh(), avals)
    # Compiled once for these shapes, whichever thread asks first.
    with _programs_lock:
        if key not in _programs:
            _programs[key] = jax.jit(_sharded(config, max_steps, program)).lower(*args).compile()
    results = jax.tree.map(np.asarray, _programs[key](*args))
    return [
        jax.tree.map(lambda leaf, i=i, size=item.count: leaf[i, :size], results)
        for i, item in enumerate(batches)
    ]


def _sharded(config: NavigatorConfig, max_steps: int, program: EpisodeProgram) -> Any:
    """Map the program of one device over the mesh (``shard_map``)."""

    def on_one_device(tasks: Task, instructions: Any, params: Any, count: jax.Array) -> Any:
        batch, values, size = jax.tree.map(lambda leaf: leaf[0], (tasks, params, count))
        sizes: dict[str, Any] = {"config": config, "num_lanes": NUM_LANES, "max_steps": max_steps}
        result = run_batch(batch, instructions, params=values, count=size, program=program, **sizes)
        return jax.tree.map(lambda leaf: leaf[None], result)

    split = PartitionSpec(_AXIS)
    specs = split, PartitionSpec(), split, split
    # Nothing is replicated and nothing is exchanged, so there is nothing to check; the check
    # would reject the loop, whose carry starts the same on all devices and then differs.
    return jax.shard_map(
        on_one_device, mesh=mesh(), in_specs=specs, out_specs=split, check_vma=False
    )


def _split_episodes(num_episodes: int, capacity: int, threads: int) -> list[tuple[int, int]]:
    """Split episodes into pieces of similar size, so that all threads finish together."""
    num_pieces = max(1, -(-num_episodes // capacity))
    if num_episodes >= 2 * NUM_LANES * threads:
        num_pieces = -(-num_pieces // threads) * threads
    bounds = [num_episodes * i // num_pieces for i in range(num_pieces + 1)]
    return [(low, high - low) for low, high in itertools.pairwise(bounds)]


def run_ahead(call: Callable[[Job], Out], jobs: Iterable[Job], threads: int) -> Iterator[Out]:
    """Run jobs in a thread pool and yield their results in order; the first failure ends it."""
    running: collections.deque[concurrent.futures.Future[Out]] = collections.deque()
    with concurrent.futures.ThreadPoolExecutor(threads) as pool:
        try:
            for job in jobs:
                running.append(pool.submit(call, job))
                if len(running) >= _JOBS_PER_THREAD * threads:
                    yield running.popleft().result()
            while running:
                yield running.popleft().result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def run_tasks(
    tasks: Task,
    instructions: Any,
    *,
    params: Any,
    config: NavigatorConfig,
    on_progress: OnProgress | None = None,
    num_threads: int | None = None,
    max_steps: int = MAX_STEPS,
    program: EpisodeProgram = EPISODE,
) -> Any:
    """Run tasks, at least one, with one compiled program, on all cores and devices.

    Arguments and results are those of ``lanes.run_batch``; results are NumPy arrays.
    ``on_progress`` is called with the number of episodes just finished; ``num_threads``: concurrent
    calls, by default as many as keep all cores busy.
    """
    num_tasks, devices = tasks.instruction_index.shape[0], mesh().size
    threads = num_threads or concurrent_calls()
    pieces = _split_episodes(num_tasks, CHUNK_SIZE, threads * devices)
    rounds = [pieces[start : start + devices] for start in range(0, len(pieces), devices)]

    def run(slices: list[tuple[int, int]]) -> list[Any]:
        filled = [(pad_chunk(tasks, first, size), size) for first, size in slices]
        batches = [DeviceBatch(tasks=padded, count=size, params=params) for padded, size in filled]
        return run_round(batches, instructions, config=config, max_steps=max_steps, program=program)

    results: list[Any] = []
    for slices, done in zip(rounds, run_ahead(run, rounds, threads), strict=True):
        results += done
        if on_progress is not None:
            on_progress(sum(size for _, size in slices))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *results)
