"""Running many episodes: batches of one shape, pieces, threads (section 4.2).

Every batch has the same shape, so one compiled program serves the whole grid, and a result does
not depend on how many episodes are asked for or how they are split.
"""

import concurrent.futures
import itertools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import numpy as np

from jaxlangnav.episode import MAX_STEPS, Task
from jaxlangnav.experiments.devices import (
    CHUNK,
    LANES,
    Work,
    fill,
    mesh,
    num_calls,
    run_round,
    usable_cores,
)
from jaxlangnav.experiments.tasks import take_tasks
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.lanes import EPISODE, Course
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams

Result = TypeVar("Result")
"""Any record of arrays that lead with the episodes."""
OnProgress = Callable[[int], None]
"""Called with the number of episodes just finished."""


def pieces(number: int, capacity: int, threads: int) -> list[tuple[int, int]]:
    """Split episodes into pieces of about one size, so that all threads end together.

    Args:
        number: episodes.
        capacity: most episodes of a piece.
        threads: pieces under way at once.

    Returns:
        First episode and length of each piece.
    """
    count = max(1, -(-number // capacity))
    if number >= 2 * LANES * threads:
        count = -(-count // threads) * threads
    bounds = [number * index // count for index in range(count + 1)]
    return [(low, high - low) for low, high in itertools.pairwise(bounds)]


def map_pieces(
    run: Callable[[Task, int], Result],
    tasks: Task,
    *,
    capacity: int,
    on_progress: OnProgress | None = None,
    num_threads: int | None = None,
) -> Result:
    """Cut tasks into pieces, filled up to one shape, and run them, several at once.

    Args:
        run: runs one piece: tasks, leaves [capacity, …], and how many of them count.
        tasks: leaves [E, …].
        capacity: tasks in the shape that ``run`` takes.
        on_progress: called with the number of episodes just finished.
        num_threads: pieces under way at once; the number of usable cores by default.

    Returns:
        Results as NumPy arrays, leaves [E, …], in the order of the tasks.
    """
    number = tasks.instruction_index.shape[0]
    threads = num_threads or usable_cores()

    def work(piece: tuple[int, int]) -> Result:
        first, size = piece
        place = np.arange(capacity)
        chunk = take_tasks(tasks, first + np.where(place < size, place, 0))
        return jax.tree.map(lambda leaf: np.asarray(leaf)[:size], run(chunk, size))

    results: list[Result] = []
    parts = pieces(number, capacity, threads)
    with concurrent.futures.ThreadPoolExecutor(threads) as pool:
        for (_, size), result in zip(parts, pool.map(work, parts), strict=True):
            results.append(result)
            if on_progress is not None:
                on_progress(size)
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *results)


def run_tasks(
    tasks: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    on_progress: OnProgress | None = None,
    num_threads: int | None = None,
    max_steps: int = MAX_STEPS,
    course: Course = EPISODE,
) -> Any:
    """Run tasks of any number through one compiled program, on all cores and devices.

    Args:
        tasks: leaves [E, …].
        instructions: leaves [I, …].
        params: the navigator's numbers.
        config: sizes and policy.
        on_progress: called with the number of episodes just finished.
        num_threads: calls under way at once; as many as keep all cores busy by default.
        max_steps: cycles until a time-out.
        course: what is kept of an episode; its result by default.

    Returns:
        Results as NumPy arrays, leaves [E, …], in the order of the tasks: an ``EpisodeResult``, or
        what the course finishes with.
    """
    number = tasks.instruction_index.shape[0]
    calls, devices = num_threads or num_calls(), mesh().size
    parts = pieces(number, CHUNK, calls * devices)
    rounds = [parts[at : at + devices] for at in range(0, len(parts), devices)]

    def work(places: list[tuple[int, int]]) -> list[Any]:
        works = [
            Work(tasks=fill(tasks, first, size), count=size, params=params)
            for first, size in places
        ]
        return run_round(works, instructions, config=config, max_steps=max_steps, course=course)

    results: list[Any] = []
    with concurrent.futures.ThreadPoolExecutor(calls) as pool:
        for places, done in zip(rounds, pool.map(work, rounds), strict=True):
            results += done
            if on_progress is not None:
                on_progress(sum(size for _, size in places))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *results)
