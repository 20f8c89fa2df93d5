"""Work is sized before it is begun: what memory cannot hold is refused, with what it could.

The sizes are the engine's own: the records of an episode under way, traced without being made
(``jax.eval_shape``), and the arrays of its task and its result.
"""

import functools
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.episode import Task, begin, finish
from jaxlangnav.experiments.monte_carlo import LANES, concurrent_calls, mesh
from jaxlangnav.grounding.instruction import pack_instruction
from jaxlangnav.grounding.readings import pad_readings
from jaxlangnav.messages import default_motion, default_sensor
from jaxlangnav.navigator import NavigatorConfig
from jaxlangnav.world.state import Scenario, empty_scenario

SCRATCH = 8.5
"""Bytes a compiled step works with for each byte of an episode's records: XLA's own count of a
batch of 32 lanes on a CPU, policy ``informed``, grows by 4,763 bytes a particle and lane, the
records by 562 (``compiled.memory_analysis()``, between 64 and 512 particles)."""
_INDEX_LIMIT = 2**31  # sizes lie below it: arrays are indexed with 32 bits
_GROUP = Path("/sys/fs/cgroup")
_LIMITS = (_GROUP / "memory.max", _GROUP / "memory" / "memory.limit_in_bytes")
"""Where Linux says what a container may use."""


def _memory() -> int:
    """Find how much memory there is for arrays: the device's, or what this process may use."""
    if jax.default_backend() == "cpu":
        return _host_memory()
    return int((jax.local_devices()[0].memory_stats() or {}).get("bytes_limit", _host_memory()))


def _bytes_of(tree: Any) -> int:
    """Count the bytes of arrays, whether they are there or only their shapes."""
    total = 0
    for leaf in jax.tree.leaves(tree):
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            leaf = jax.eval_shape(jax.random.key_data, leaf)
        # As Python's integers: NumPy's would wrap.
        total += np.dtype(leaf.dtype).itemsize * math.prod(map(int, leaf.shape))
    return total


def _episode_bytes(config: NavigatorConfig) -> tuple[int, int]:
    """Count the records of an episode under way."""
    small, double = (
        _bytes_of(_progress(replace(config, map=replace(config.map, num_particles=number))))
        for number in (2, 4)
    )
    return 2 * small - double, (double - small) // 2


def task_bytes() -> int:
    """Count the bytes of one task."""
    return _bytes_of(jax.eval_shape(any_task))


def result_bytes() -> int:
    """Count the bytes of one episode's result."""
    return _bytes_of(jax.eval_shape(finish, _progress(NavigatorConfig())))


def readable_count(number: int) -> str:
    """Write a number of at least 0 for people: all digits in threes, or two and the exponent."""
    digits = str(number)
    return f"{number:,}" if number < 10**15 else f"{digits[0]}.{digits[1]}·10^{len(digits) - 1}"


def check_count(name: str, count: int, *, each: int, fixed: int = 0, beside: str = "") -> None:
    """Refuse more of something than memory holds; ``ValueError`` says how many would fit.

    ``name`` says what is counted and ``beside`` what else makes up the size; ``each``: bytes of
    one, ``fixed``: bytes that they need besides.
    """
    limit, need = _memory(), fixed + count * each
    if need <= limit:
        return
    fit = max(0, (limit - fixed) // each)
    remedy = f"at most {fit:,} fit" if fit else "lower the other sizes: not even one fits"
    with_it = f" with {beside}" if beside else ""
    raise ValueError(
        f"{name} is {readable_count(count)}{with_it}, which takes {readable_count(need >> 20)} "
        f"MiB of memory, but there are {readable_count(limit >> 20)}: {remedy}"
    )


def check_engine(config: NavigatorConfig) -> None:
    """Refuse sizes with which a batch of episodes does not fit into memory, as ``check_count``."""
    # On a CPU all calls share one memory, on accelerators each device has its own.
    devices = mesh().size if jax.default_backend() == "cpu" else 1
    _check_lanes(config, LANES * concurrent_calls() * devices)


def check_recording(config: NavigatorConfig, max_steps: int) -> None:
    """Refuse sizes with which a recorded episode of ``max_steps`` does not fit into memory."""
    _check_lanes(config, 1)
    number, (fixed, each) = config.map.num_particles, _episode_bytes(config)
    state, beside = fixed + number * each, f"{number:,} particles"
    check_count("max steps", max_steps, each=state, fixed=int(SCRATCH * state), beside=beside)


def _check_lanes(config: NavigatorConfig, lanes: int) -> None:
    """Refuse sizes with which some episodes under way at once do not fit."""
    sizes = config.map
    objects, cells = readable_count(sizes.num_objects), readable_count(sizes.num_cells)
    beside = f"{objects} objects and {cells} cells a side"
    if max(sizes.num_objects, sizes.num_cells, config.planner.num_visited) >= _INDEX_LIMIT:
        raise ValueError(f"the sizes are too large for any memory: {beside}")
    fixed, each = (int(SCRATCH * lanes * one) for one in _episode_bytes(config))
    check_count("particles", sizes.num_particles, each=each, fixed=fixed, beside=beside)


def _progress(config: NavigatorConfig) -> Any:
    """Trace the records of an episode under way, without making them."""
    one = pack_instruction(pad_readings(()), ())  # all sentences have the same shapes
    some = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((1, *leaf.shape), leaf.dtype), one)
    return jax.eval_shape(functools.partial(begin, config=config), jax.eval_shape(any_task), some)


def any_task(scenario: Scenario | None = None) -> Task:
    """Build a task, in an empty world by default: all of as many slots have the same shapes."""
    return Task(
        key=jax.random.key(0),
        scenario=empty_scenario() if scenario is None else scenario,
        instruction_index=jax.device_put(np.int32(0)),
        sensor=default_sensor(),
        motion=default_motion(),
    )


@functools.cache
def _host_memory() -> int:
    """Find how much memory the machine has, or the container if that is less."""
    least = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for path in _LIMITS:
        try:
            least = min(least, int(path.read_text()))
        except (OSError, ValueError):
            continue
    return least
