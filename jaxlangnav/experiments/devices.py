"""Many devices and many processes: a mesh over episodes (section 4.2).

The devices of a process form one mesh. Each runs the same program on one chunk of episodes at a
time, so that what an episode gives does not depend on how many devices there are. Processes share
nothing but a folder: each finds its place among them by ``join_devices`` and does its part of
the files.
"""

import dataclasses
import functools
import os
import re
import threading
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from jaxlangnav.episode import MAX_STEPS, Task
from jaxlangnav.experiments.tasks import take_tasks
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.lanes import EPISODE, Course, run_batch
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams
from jaxlangnav.pytree import strong

CHUNK = 1024
"""Most episodes a device takes in one call; fewer are padded, and padding is not run."""
LANES = 32
"""Episodes under way at once on a device."""
_AXIS = "episodes"
"""The mesh's only axis."""

_programs: dict[Any, Any] = {}
_programs_lock = threading.Lock()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Work:
    """What one device does in one call."""

    tasks: Task
    """Leaves [CHUNK, …], see ``fill``."""
    count: int
    """How many of them to run."""
    params: NavigatorParams


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
    """Find out which of how many processes this is; before anything is computed.

    ``jax.distributed`` asks the launcher (SLURM, Open MPI, Kubernetes, cloud TPUs) for whatever is
    not given, and all processes meet at the first one. Then they part: nothing that is computed
    crosses from one to another, and a process that dies later must not take its peers along.

    Args:
        coordinator: host:port of the first process.
        processes: how many there are.
        process: which one this is, from 0.

    Returns:
        The place of this process, from 0, and how many there are.

    Raises:
        ValueError: no launcher is known, something is missing or does not fit together, or the
            others did not come.
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
    """Cut tasks for one call, filled up to its shape.

    Args:
        tasks: leaves [E, …].
        first: place of the first.
        size: how many, at most CHUNK.

    Returns:
        Tasks, leaves [CHUNK, …]; the first ``size`` count.
    """
    place = np.arange(CHUNK)
    return take_tasks(tasks, first + np.where(place < size, place, 0))


def run_round(
    works: Sequence[Work],
    instructions: Instruction,
    *,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
    course: Course = EPISODE,
) -> list[Any]:
    """Run one call of the program, a chunk on each device.

    Args:
        works: at most as many as there are devices; the other devices rest.
        instructions: leaves [I, …].
        config: sizes and policy.
        max_steps: cycles until a time-out.
        course: what is kept of an episode; its result by default.

    Returns:
        For each of the works its results as NumPy arrays, leaves [count, …].
    """
    idle = mesh().size - len(works)
    padded = [*works, *[works[0]] * idle]
    split = NamedSharding(mesh(), PartitionSpec(_AXIS))
    everywhere = NamedSharding(mesh(), PartitionSpec())
    stacked = strong(_stack([(one.tasks, one.params) for one in padded]))
    tasks, params = jax.device_put(stacked, split)
    counts = [*(one.count for one in works), *[0] * idle]
    count = jax.device_put(jnp.asarray(counts, jnp.int32), split)
    inputs = (tasks, jax.device_put(strong(instructions), everywhere), params, count)
    results = jax.tree.map(np.asarray, _program(inputs, config, max_steps, course)(*inputs))
    return [
        jax.tree.map(lambda leaf, at=at, size=one.count: leaf[at, :size], results)
        for at, one in enumerate(works)
    ]


def _stack(records: Sequence[Any]) -> Any:
    """Put the works of all devices behind one another, leaves [devices, …]."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *records)


def _program(inputs: Any, config: NavigatorConfig, max_steps: int, course: Course) -> Any:
    """Compile the batch for these shapes once, whichever thread asks first."""
    kinds = [jax.typeof(leaf) for leaf in jax.tree.leaves(inputs)]
    name = (config, max_steps, course, LANES, mesh(), tuple(kinds))
    with _programs_lock:
        if name not in _programs:
            _programs[name] = jax.jit(_sharded(config, max_steps, course)).lower(*inputs).compile()
        return _programs[name]


def _sharded(config: NavigatorConfig, max_steps: int, course: Course) -> Any:
    """Spread the batch of one device over all of them."""

    def on_one_device(
        tasks: Task, instructions: Instruction, params: NavigatorParams, count: jax.Array
    ) -> Any:
        own_tasks, own_params, own_count = jax.tree.map(
            lambda leaf: leaf[0], (tasks, params, count)
        )
        results = run_batch(
            own_tasks,
            instructions,
            params=own_params,
            config=config,
            num_lanes=LANES,
            max_steps=max_steps,
            count=own_count,
            course=course,
        )
        return jax.tree.map(lambda leaf: leaf[None], results)

    # Nothing is replicated and nothing is exchanged, so there is nothing to check; the check
    # would reject the loop, whose carry starts the same on all devices and then differs.
    return jax.shard_map(
        on_one_device,
        mesh=mesh(),
        in_specs=(
            PartitionSpec(_AXIS),
            PartitionSpec(),
            PartitionSpec(_AXIS),
            PartitionSpec(_AXIS),
        ),
        out_specs=PartitionSpec(_AXIS),
        check_vma=False,
    )
