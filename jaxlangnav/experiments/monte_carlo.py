"""Running many episodes: keys, tasks, chunks of fixed shape, threads (section 4.2).

Every chunk has the same shape, so one compiled program serves the whole grid, and a result does
not depend on how many episodes are asked for: episode i of a (world, relation) has its scenario
and its noise from (seed, world, relation, i) alone, whatever the policy, range or batch.
"""

import concurrent.futures
import dataclasses
import os
import threading
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.episode import MAX_STEPS, EpisodeResult, Task, run_batch
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.messages import MotionParams, SensorParams, default_motion, default_sensor
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams
from jaxlangnav.world.known import known_distance
from jaxlangnav.world.scenario import draw_scenario, scenario_law
from jaxlangnav.world.state import Scenario

CHUNK = 256
"""Episodes in one call of the compiled program."""
LANES = 32
"""Episodes under way at once in one call."""

Progress = Callable[[int], None]
"""Called with the number of episodes just finished."""

_programs: dict[Any, Any] = {}
_programs_lock = threading.Lock()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cell:
    """One cell of a grid: episodes that share everything but their keys."""

    world: str
    relation: str
    instruction_index: int
    sensor: SensorParams
    motion: MotionParams
    episodes: int
    seed: int
    first_episode: int = 0
    scenario: Scenario | None = None
    """A world of somebody's own; None draws worlds of the template that ``world`` names."""


def cell(
    world: str,
    relation: str,
    instruction_index: int,
    sensing_range: float,
    episodes: int,
    seed: int,
    first_episode: int = 0,
) -> Cell:
    """Build a cell with the default noise."""
    return Cell(
        world=world,
        relation=relation,
        instruction_index=instruction_index,
        sensor=default_sensor(sensing_range),
        motion=default_motion(),
        episodes=episodes,
        seed=seed,
        first_episode=first_episode,
    )


@jax.jit
def _keys(root: Array, first: Array, offsets: Array) -> tuple[Array, Array]:
    """Derive a scenario key and an episode key for each episode number."""

    def one(number: Array) -> tuple[Array, Array]:
        key = jax.random.fold_in(root, first + number)
        scenario_key, episode_key = jax.random.split(key)
        return scenario_key, episode_key

    return jax.vmap(one)(offsets)


def make_tasks(one: Cell) -> Task:
    """Draw the worlds and keys of a cell.

    Args:
        one: the cell.

    Returns:
        Tasks, leaves [E, …].

    Raises:
        ValueError: unknown world or relation, or no episodes.
    """
    if one.episodes < 1:
        raise ValueError(f"episodes is {one.episodes}, but must be at least 1")
    law = None
    if one.scenario is None:
        law = scenario_law(template=one.world, relation=one.relation)
    label = zlib.crc32(f"{one.world}|{one.relation}".encode())
    root = jax.random.fold_in(jax.random.key(one.seed), label)
    # Scenarios are drawn in chunks of one shape as well: one program for any number of episodes.
    parts = []
    for start in range(0, one.episodes, CHUNK):
        offsets = jnp.arange(CHUNK, dtype=jnp.uint32)
        first = jnp.uint32(one.first_episode + start)
        scenario_keys, episode_keys = _keys(root, first, offsets)
        if law is None:
            scenarios = _repeat(one.scenario)
        else:
            scenarios = jax.vmap(draw_scenario, in_axes=(0, None))(scenario_keys, law)
        parts.append(
            Task(
                key=episode_keys,
                scenario=scenarios,
                instruction_index=jnp.full(CHUNK, one.instruction_index, jnp.int32),
                sensor=_repeat(one.sensor),
                motion=_repeat(one.motion),
            )
        )
    whole = concatenate(parts)
    return jax.tree.map(lambda leaf: leaf[: one.episodes], whole)


def _repeat(record: Any) -> Any:
    """Repeat a record for every episode of a chunk."""
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (CHUNK, *jnp.shape(leaf))), record)


def take_tasks(tasks: Task, index: np.ndarray) -> Task:
    """Pick tasks.

    Args:
        tasks: leaves [E, …].
        index: i[n], which of them.

    Returns:
        Tasks, leaves [n, …].
    """
    at = jnp.asarray(index)
    return jax.tree.map(lambda leaf: leaf[at], tasks)


def map_chunks(
    run: Callable[[Task], EpisodeResult],
    tasks: Task,
    *,
    on_progress: Progress | None = None,
    num_threads: int | None = None,
) -> EpisodeResult:
    """Cut tasks into chunks of one shape and run them, several at once.

    The last chunk is filled up with its own first task; what those runs give is dropped.

    Args:
        run: runs one chunk, leaves [CHUNK, …].
        tasks: leaves [E, …].
        on_progress: called with the number of episodes just finished.
        num_threads: chunks under way at once; the number of usable cores by default.

    Returns:
        Results as NumPy arrays, leaves [E, …], in the order of the tasks.
    """
    number = tasks.instruction_index.shape[0]

    def work(start: int) -> EpisodeResult:
        index = np.arange(start, start + CHUNK)
        chunk = take_tasks(tasks, np.where(index < number, index, start))
        return jax.tree.map(np.asarray, run(chunk))

    results: list[EpisodeResult] = []
    with concurrent.futures.ThreadPoolExecutor(num_threads or usable_cores()) as pool:
        for index, result in enumerate(pool.map(work, range(0, number, CHUNK))):
            results.append(result)
            if on_progress is not None:
                on_progress(min(CHUNK, number - index * CHUNK))
    whole = jax.tree.map(lambda *leaves: np.concatenate(leaves), *results)
    return jax.tree.map(lambda leaf: leaf[:number], whole)


def usable_cores() -> int:
    """Count the cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _program(
    chunk: Task,
    instructions: Instruction,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int,
) -> Any:
    """Compile the batch for these shapes once, whichever thread asks first."""
    kinds = [jax.typeof(leaf) for leaf in jax.tree.leaves((chunk, instructions, params))]
    name = (config, max_steps, LANES, tuple(kinds))
    with _programs_lock:
        if name not in _programs:
            lowered = run_batch.lower(
                chunk,
                instructions,
                params=params,
                config=config,
                num_lanes=LANES,
                max_steps=max_steps,
            )
            _programs[name] = lowered.compile()
        return _programs[name]


def run_tasks(
    tasks: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    on_progress: Progress | None = None,
    num_threads: int | None = None,
    max_steps: int = MAX_STEPS,
) -> EpisodeResult:
    """Run tasks of any number through one compiled program, on all cores.

    Args:
        tasks: leaves [E, …].
        instructions: leaves [I, …].
        params: the navigator's numbers.
        config: sizes and policy.
        on_progress: called with the number of episodes just finished.
        num_threads: chunks under way at once; the number of cores by default.
        max_steps: cycles until a time-out.

    Returns:
        Results as NumPy arrays, leaves [E, …], in the order of the tasks.
    """

    def run(chunk: Task) -> EpisodeResult:
        program = _program(chunk, instructions, params, config, max_steps)
        return program(chunk, instructions, params=params)

    return map_chunks(run, tasks, on_progress=on_progress, num_threads=num_threads)


def concatenate(parts: Sequence[Task]) -> Task:
    """Put the tasks of several cells behind one another."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


def known_distances(tasks: Task) -> np.ndarray:
    """Measure the straight way from start to goal of each task, f32[E] metres."""
    return np.asarray(jax.vmap(known_distance)(tasks.scenario))
