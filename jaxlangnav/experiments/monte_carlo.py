"""Running many episodes: keys, tasks, chunks of fixed shape, threads (section 4.2).

Every chunk has the same shape, so one compiled program serves the whole grid, and a result does
not depend on how many episodes are asked for: episode i of a (world, relation) has its scenario
and its noise from (seed, world, relation, i) alone, whatever the policy, range or batch.
"""

import concurrent.futures
import dataclasses
import os
import zlib
from collections.abc import Callable, Sequence

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

CHUNK = 256
"""Episodes in one call of the compiled program."""
LANES = 32
"""Episodes under way at once in one call."""

Progress = Callable[[int], None]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cell:
    """One cell of a grid: episodes that share everything but their seed."""

    world: str
    relation: str
    instruction_index: int
    sensor: SensorParams
    motion: MotionParams
    episodes: int
    seed: int
    first_episode: int = 0


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
    law = scenario_law(template=one.world, relation=one.relation)
    label = zlib.crc32(f"{one.world}|{one.relation}".encode())
    root = jax.random.fold_in(jax.random.key(one.seed), label)
    # Scenarios are drawn in chunks of one shape as well: one program for any number of episodes.
    parts = []
    for start in range(0, one.episodes, CHUNK):
        offsets = jnp.arange(CHUNK, dtype=jnp.uint32)
        first = jnp.uint32(one.first_episode + start)
        scenario_keys, episode_keys = _keys(root, first, offsets)
        scenarios = jax.vmap(draw_scenario, in_axes=(0, None))(scenario_keys, law)
        shared = jax.tree.map(
            lambda leaf: jnp.broadcast_to(leaf, (CHUNK,)), (one.sensor, one.motion)
        )
        parts.append(
            Task(
                key=episode_keys,
                scenario=scenarios,
                instruction_index=jnp.full(CHUNK, one.instruction_index, jnp.int32),
                sensor=shared[0],
                motion=shared[1],
            )
        )
    whole = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)
    return jax.tree.map(lambda leaf: leaf[: one.episodes], whole)


def _chunks(tasks: Task, size: int) -> list[Task]:
    """Cut tasks into chunks of one shape; the last is filled up with its first task."""
    number = tasks.instruction_index.shape[0]
    chunks = []
    for start in range(0, number, size):
        index = np.arange(start, start + size)
        index = jnp.asarray(np.where(index < number, index, start))
        chunks.append(jax.tree.map(lambda leaf: leaf[index], tasks))  # noqa: B023
    return chunks


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
    number = tasks.instruction_index.shape[0]
    chunks = _chunks(tasks, CHUNK)

    def work(chunk: Task) -> EpisodeResult:
        result = run_batch(
            chunk, instructions, params=params, config=config, num_lanes=LANES, max_steps=max_steps
        )
        return jax.tree.map(np.asarray, result)

    results: list[EpisodeResult] = []
    threads = num_threads or len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    with concurrent.futures.ThreadPoolExecutor(max(1, threads)) as pool:
        for index, result in enumerate(pool.map(work, chunks)):
            results.append(result)
            if on_progress is not None:
                on_progress(min(CHUNK, number - index * CHUNK))
    whole = jax.tree.map(lambda *leaves: np.concatenate(leaves), *results)
    return jax.tree.map(lambda leaf: leaf[:number], whole)


def concatenate(parts: Sequence[Task]) -> Task:
    """Put the tasks of several cells behind one another."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


def known_distances(tasks: Task) -> np.ndarray:
    """Measure the straight way from start to goal of each task, f32[E] metres."""
    return np.asarray(jax.vmap(known_distance)(tasks.scenario))
