"""Running many episodes: batches of one shape, pieces, threads (section 4.2).

Every batch has the same shape, so one compiled program serves the whole grid, and a result does
not depend on how many episodes are asked for or how they are split.
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
from jaxlangnav.pytree import strong

CHUNK = 1024  # most episodes a device takes in one call; fewer are padded, and padding is not run
LANES = 32  # episodes under way at once on a device
_AXIS = "episodes"  # the mesh's only axis

_programs: dict[Any, Any] = {}
_programs_lock = threading.Lock()
_AHEAD = 2  # jobs handed out for each thread: none waits for the one that yields
Job = TypeVar("Job")
Done = TypeVar("Done")
OnProgress = Callable[[int], None]  # called with the number of episodes just finished


@dataclasses.dataclass(frozen=True, kw_only=True)
class Work:
    """What one device does in one call."""

    tasks: Task  # leaves [CHUNK, …], see ``fill``
    count: int  # how many of them to run
    params: Any  # of the course


def usable_cores() -> int:
    """Count the cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def num_calls() -> int:
    """Choose how many calls are under way at once: all cores busy, or one call ahead of a GPU."""
    if jax.default_backend() != "cpu":
        return 2
    return max(1, usable_cores() // mesh().size)


@functools.cache
def mesh() -> Mesh:
    """Line up the devices of this process."""
    devices = jax.local_devices()
    return jax.make_mesh((len(devices),), (_AXIS,), axis_types=(AxisType.Auto,), devices=devices)


def join_devices(
    coordinator: str | None = None, processes: int | None = None, process: int | None = None
) -> tuple[int, int]:
    """Find out which of how many processes this is, from 0; before anything is computed.

    ``jax.distributed`` asks the launcher (SLURM, Open MPI, Kubernetes, cloud TPUs) for whatever is
    not given: ``coordinator``, host:port of the first process; how many ``processes`` there are;
    which ``process`` this is, from 0. All meet at the first one, and then they part: a process that
    dies later takes no peer along. ``ValueError``: no launcher is known, something is missing or
    does not fit together, or the others did not come.
    """
    if coordinator is not None and not re.fullmatch(r".+:\d+", coordinator):
        raise ValueError(f'coordinator is "{coordinator}", but must be HOST:PORT')
    try:
        jax.distributed.initialize(coordinator, processes, process)
        place = jax.process_index(), jax.process_count()
        jax.distributed.shutdown()
    except (ValueError, RuntimeError, TypeError) as error:
        reason = str(error).strip().split("\n")[0]
        raise ValueError(
            f"cannot join the other processes: {reason} (under a launcher that JAX does not "
            "know, give --coordinator HOST:PORT, --processes and --process)"
        ) from None
    return place


def fill(tasks: Task, first: int, size: int) -> Task:
    """Cut ``size`` tasks from ``first`` on, filled up to the shape of a call: leaves [CHUNK, …]."""
    place = np.arange(CHUNK)
    return take_tasks(tasks, first + np.where(place < size, place, 0))


def run_round(
    works: Sequence[Work],
    instructions: Any,
    *,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
    course: EpisodeProgram = EPISODE,
) -> list[Any]:
    """Run one call of the program, a chunk on each device; arguments as ``run_tasks``.

    ``works``: at most as many as there are devices; the other devices rest. For each of them its
    results as NumPy arrays, leaves [count, …].
    """
    idle = dataclasses.replace(works[0], count=0)
    padded = [*works, *[idle] * (mesh().size - len(works))]
    given = [(one.tasks, one.params, jnp.int32(one.count)) for one in padded]
    stacked = strong(jax.tree.map(lambda *leaves: jnp.stack(leaves), *given))
    tasks, params, count = jax.device_put(stacked, NamedSharding(mesh(), PartitionSpec(_AXIS)))
    everywhere = NamedSharding(mesh(), PartitionSpec())
    inputs = (tasks, jax.device_put(strong(instructions), everywhere), params, count)
    kinds = tuple(jax.typeof(leaf) for leaf in jax.tree.leaves(inputs))
    name = (config, max_steps, course, LANES, mesh(), kinds)
    # Compiled once for these shapes, whichever thread asks first.
    with _programs_lock:
        if name not in _programs:
            _programs[name] = jax.jit(_sharded(config, max_steps, course)).lower(*inputs).compile()
    results = jax.tree.map(np.asarray, _programs[name](*inputs))
    return [
        jax.tree.map(lambda leaf, at=at, size=one.count: leaf[at, :size], results)
        for at, one in enumerate(works)
    ]


def _sharded(config: NavigatorConfig, max_steps: int, course: EpisodeProgram) -> Any:
    """Spread the batch of one device over all of them."""

    def on_one_device(tasks: Task, instructions: Any, params: Any, count: jax.Array) -> Any:
        own, numbers, size = jax.tree.map(lambda leaf: leaf[0], (tasks, params, count))
        sizes: dict[str, Any] = {"config": config, "num_lanes": LANES, "max_steps": max_steps}
        results = run_batch(own, instructions, params=numbers, count=size, course=course, **sizes)
        return jax.tree.map(lambda leaf: leaf[None], results)

    split = PartitionSpec(_AXIS)
    # Nothing is replicated and nothing is exchanged, so there is nothing to check; the check
    # would reject the loop, whose carry starts the same on all devices and then differs.
    return jax.shard_map(
        on_one_device,
        mesh=mesh(),
        in_specs=(split, PartitionSpec(), split, split),
        out_specs=split,
        check_vma=False,
    )


def _pieces(number: int, capacity: int, threads: int) -> list[tuple[int, int]]:
    """Split episodes into pieces of about one size, so that all threads end together."""
    count = max(1, -(-number // capacity))
    if number >= 2 * LANES * threads:
        count = -(-count // threads) * threads
    bounds = [number * index // count for index in range(count + 1)]
    return [(low, high - low) for low, high in itertools.pairwise(bounds)]


def run_ahead(work: Callable[[Job], Done], jobs: Iterable[Job], threads: int) -> Iterator[Done]:
    """Do jobs in threads, taken as these come free; yields in order, the first failure ends it."""
    running: collections.deque[concurrent.futures.Future[Done]] = collections.deque()
    with concurrent.futures.ThreadPoolExecutor(threads) as pool:
        try:
            for job in jobs:
                running.append(pool.submit(work, job))
                if len(running) >= _AHEAD * threads:
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
    course: EpisodeProgram = EPISODE,
) -> Any:
    """Run tasks of any number through one compiled program, on all cores and devices.

    Arguments and results are those of ``lanes.run_batch``; results are NumPy arrays.
    ``on_progress`` is called with the number of episodes just finished; ``num_threads``: calls
    under way at once, by default as many as keep all cores busy.
    """
    number, abreast = tasks.instruction_index.shape[0], mesh().size
    threads = num_threads or num_calls()
    parts = _pieces(number, CHUNK, threads * abreast)
    rounds = [parts[at : at + abreast] for at in range(0, len(parts), abreast)]

    def work(places: list[tuple[int, int]]) -> list[Any]:
        filled = [(fill(tasks, first, size), size) for first, size in places]
        works = [Work(tasks=own, count=size, params=params) for own, size in filled]
        return run_round(works, instructions, config=config, max_steps=max_steps, course=course)

    results: list[Any] = []
    for places, done in zip(rounds, run_ahead(work, rounds, threads), strict=True):
        results += done
        if on_progress is not None:
            on_progress(sum(size for _, size in places))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *results)
