"""Memory checks: reject work that does not fit into memory before it starts, with what would fit.

Sizes are those of the records of a running episode, traced abstractly (``jax.eval_shape``), and of
the arrays of its task and its result.
"""

import contextlib
import functools
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxlangnav.episode import Task, begin, finish
from jaxlangnav.experiments.monte_carlo import NUM_LANES, concurrent_calls, mesh
from jaxlangnav.grounding.instruction import pack_instruction
from jaxlangnav.grounding.readings import pad_readings
from jaxlangnav.messages import default_motion, default_sensor
from jaxlangnav.navigator import NavigatorConfig
from jaxlangnav.world.state import make_scenario

SCRATCH_RATIO = 8.5
"""Bytes a compiled step works with for each byte of an episode's records: XLA's own count of a
batch of 32 episodes on a CPU, policy ``informed``, grows by 4,763 bytes a particle and episode, the
records by 562 (``compiled.memory_analysis()``, between 64 and 512 particles)."""
_INDEX_LIMIT = 2**31  # sizes lie below it: arrays are indexed with 32 bits
_CGROUP = Path("/sys/fs/cgroup")
_CGROUP_LIMITS = (_CGROUP / "memory.max", _CGROUP / "memory" / "memory.limit_in_bytes")
"""Files with a container's memory limit on Linux."""


@functools.cache
def _memory() -> int:
    """Return the memory for arrays, bytes: the device's, or that of the machine or container."""
    limit = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for path in _CGROUP_LIMITS:
        with contextlib.suppress(OSError, ValueError):
            limit = min(limit, int(path.read_text()))
    stats = jax.local_devices()[0].memory_stats() or {}  # a CPU has none
    return int(stats.get("bytes_limit", limit))


def _bytes_of(tree: Any) -> int:
    """Count the bytes of arrays, concrete or abstract."""
    # Python integers, since NumPy's would overflow.
    leaves = jax.tree.leaves(tree)
    return sum(leaf.dtype.itemsize * math.prod(map(int, leaf.shape)) for leaf in leaves)


def _episode_bytes(config: NavigatorConfig) -> tuple[int, int]:
    """Compute the bytes of a running episode: fixed ones, and those per particle."""
    bytes_2, bytes_4 = (
        _bytes_of(_episode_shapes(replace(config, map=replace(config.map, num_particles=count))))
        for count in (2, 4)
    )
    return 2 * bytes_2 - bytes_4, (bytes_4 - bytes_2) // 2


def task_bytes() -> int:
    """Count the bytes of one task."""
    return _bytes_of(jax.eval_shape(any_task))


def result_bytes() -> int:
    """Count the bytes of one episode's result."""
    return _bytes_of(jax.eval_shape(finish, _episode_shapes(NavigatorConfig())))


def readable_count(count: int) -> str:
    """Format a number of at least 0: grouped digits, or two digits and the exponent."""
    digits = str(count)
    return f"{count:,}" if count < 10**15 else f"{digits[0]}.{digits[1]}·10^{len(digits) - 1}"


def check_count(name: str, count: int, *, each: int, fixed: int = 0, context: str = "") -> None:
    """Raise ``ValueError`` if ``count`` items do not fit into memory; it says how many would.

    ``name``: what is counted; ``context``: the other sizes; ``each``: bytes of one,
    ``fixed``: bytes independent of the count.
    """
    limit, need = _memory(), fixed + count * each
    if need <= limit:
        return
    max_n = max(0, (limit - fixed) // each)
    remedy = f"at most {max_n:,} fit" if max_n else "lower the other sizes: not even one fits"
    suffix = f" with {context}" if context else ""
    raise ValueError(
        f"{name} is {readable_count(count)}{suffix}, which takes {readable_count(need >> 20)} "
        f"MiB of memory, but there are {readable_count(limit >> 20)}: {remedy}"
    )


def check_engine(config: NavigatorConfig) -> None:
    """Raise ``ValueError`` if a batch of episodes does not fit into memory (``check_count``)."""
    # On a CPU all calls share one memory, on accelerators each device has its own.
    devices = mesh().size if jax.default_backend() == "cpu" else 1
    _check_concurrent(config, NUM_LANES * concurrent_calls() * devices)


def check_recording(config: NavigatorConfig, max_steps: int) -> None:
    """Raise ``ValueError`` if a recorded episode of ``max_steps`` does not fit into memory."""
    _check_concurrent(config, 1)
    count, (fixed, each) = config.map.num_particles, _episode_bytes(config)
    step, context = fixed + count * each, f"{count:,} particles"
    check_count("max steps", max_steps, each=step, fixed=int(SCRATCH_RATIO * step), context=context)


def _check_concurrent(config: NavigatorConfig, count: int) -> None:
    """Raise ``ValueError`` if ``count`` concurrent episodes do not fit into memory."""
    sizes = config.map
    objects, cells = readable_count(sizes.num_objects), readable_count(sizes.num_cells)
    context = f"{objects} objects and {cells} cells a side"
    if max(sizes.num_objects, sizes.num_cells, config.planner.num_visited) >= _INDEX_LIMIT:
        raise ValueError(f"the sizes are too large for any memory: {context}")
    fixed, each = (int(SCRATCH_RATIO * count * size) for size in _episode_bytes(config))
    check_count("particles", sizes.num_particles, each=each, fixed=fixed, context=context)


def _episode_shapes(config: NavigatorConfig) -> Any:
    """Compute the shapes of a running episode's records (``jax.eval_shape``)."""
    packed = pack_instruction(pad_readings(()), ())  # all instructions have the same shapes
    batch = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((1, *leaf.shape), leaf.dtype), packed)
    return jax.eval_shape(functools.partial(begin, config=config), jax.eval_shape(any_task), batch)


def any_task() -> Task:
    """Build a task in an empty world; tasks of equal slots have equal shapes."""
    return Task(
        key=jax.random.key(0),
        scenario=make_scenario(),
        instruction_index=jax.device_put(np.int32(0)),
        sensor=default_sensor(),
        motion=default_motion(),
    )
