"""Sweeps: any grid of episodes, resumable, split over any number of processes (section 4.2).

Every file holds the episodes of one chunk of the plan, is written whole or not at all, and says
of itself what its bytes must be: a killed process or a full disk loses the chunks under way and
nothing else, and a damaged file is found and made again. Which episodes a file holds, and what
they give, depends on the configuration alone, so a resumed or split sweep ends with the same
bytes as an undisturbed one on the same kind of machine.
"""

import concurrent.futures
import dataclasses
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from jaxlangnav.episode import EpisodeResult, Task
from jaxlangnav.experiments.archive import CompileClock
from jaxlangnav.experiments.grid import result_columns, typed
from jaxlangnav.experiments.holding import Note, held
from jaxlangnav.experiments.monte_carlo import OnProgress, Work, fill, mesh, num_calls, run_round
from jaxlangnav.experiments.shards import Shard, write_shard
from jaxlangnav.experiments.sweep_config import SweepConfig
from jaxlangnav.experiments.sweep_folder import (
    claim_folder,
    file_path,
    files_there,
    sound_files,
    sweep_up,
)
from jaxlangnav.experiments.sweep_plan import (
    Chunk,
    SweepPlan,
    make_plan,
    parse_shard,
    shard_episodes,
    shard_files,
)
from jaxlangnav.experiments.tasks import GroundedSentences, ground_sentences, known_distances
from jaxlangnav.planner.config import POLICIES

_AHEAD = 2
"""Rounds handed out for each call under way: no core waits, and no plan is laid out whole."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Run:
    """What all rounds of a run share."""

    plan: SweepPlan
    folder: Path
    sweep: str
    """Identity of the sweep."""
    sentences: GroundedSentences


def total_episodes(config: SweepConfig, *, shard: str = "1/1") -> int:
    """Count the episodes of a shard, for a progress bar.

    Args:
        config: the grid.
        shard: "i/n".

    Returns:
        Episodes, those already done included.

    Raises:
        ValueError: the shard is not of this form, Params that cannot be, or more than fits.
    """
    return shard_episodes(make_plan(config), shard)


def run_sweep(
    config: SweepConfig,
    out: str | Path,
    *,
    resume: bool = False,
    shard: str = "1/1",
    on_progress: OnProgress | None = None,
    on_note: Note | None = None,
    num_threads: int | None = None,
) -> dict[str, Any]:
    """Run a sweep, or a shard of it.

    Args:
        config: the grid, see ``read_config``.
        out: folder of the files; made if it is not there. All shards share it.
        resume: keep the files that are there and sound, and make the rest.
        shard: "i/n", the i-th of n parts.
        on_progress: called with the number of episodes just finished, kept ones at once.
        on_note: called with a line for each damaged file, and for a dead process's lock.
        num_threads: calls under way at once; as many as keep all cores busy by default.

    Returns:
        ``out``, ``episodes`` run now, ``kept`` from before, ``files``, ``is_complete`` (files of
        all shards are there), ``wall_s`` with compilation, ``compile_s`` of it.

    Raises:
        ValueError: the folder holds another sweep, or this one and ``resume`` is not set; a
            living process works on these files; the sweep is larger than a folder or memory.
    """
    begin, folder = time.perf_counter(), Path(out)
    plan = make_plan(config)
    mine = shard_files(plan, shard)
    advance: OnProgress = on_progress or (lambda _done: None)
    note: Note = on_note or (lambda _line: None)
    with CompileClock() as clock:
        sentences = ground_sentences([one.text for one in config.commands])
        with held(folder, parse_shard(shard), on_note=note) as is_held:
            sweep = claim_folder(folder, plan, mine, sentences.models, is_resumed=resume)
            if is_held:
                sweep_up(folder, mine)
            kept = sound_files(folder, plan, mine, sweep, on_note=note, on_kept=advance)
            run = _Run(plan=plan, folder=folder, sweep=sweep, sentences=sentences)
            todo = (index for index in mine if index not in kept)
            _run_files(run, todo, advance, num_threads)
        num_kept = sum(plan.size(index) for index in kept)
        there = sum(index < plan.num_files for index, _ in files_there(folder))
    return {
        "out": str(folder),
        "name": config.name,
        "shard": shard,
        "episodes": shard_episodes(plan, shard) - num_kept,
        "kept": num_kept,
        "files": len(mine),
        "is_complete": there == plan.num_files,
        "wall_s": time.perf_counter() - begin,
        "compile_s": clock.seconds,
    }


def _run_files(
    run: _Run, todo: Iterable[int], on_progress: OnProgress, num_threads: int | None
) -> None:
    """Make files, several at once; the first failure ends the run and keeps what is written."""
    calls = num_threads or num_calls()
    with concurrent.futures.ThreadPoolExecutor(calls) as pool:
        running: dict[concurrent.futures.Future[int], None] = {}

        def collect() -> None:
            done, _ = concurrent.futures.wait(
                running, return_when=concurrent.futures.FIRST_COMPLETED
            )
            for one in done:
                del running[one]
                on_progress(one.result())

        try:
            for files in _rounds(todo, run.plan.kind, mesh().size):
                running[pool.submit(_run_together, run, files)] = None
                if len(running) >= _AHEAD * calls:
                    collect()
            while running:
                collect()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _rounds(
    files: Iterable[int], kind: Callable[[int], tuple[str, int | None]], devices: int
) -> Iterator[list[int]]:
    """Gather files that one call can make, one on each device."""
    alike: dict[tuple[str, int | None], list[int]] = {}
    for index in files:
        policy, particles = kind(index)
        group = alike.setdefault((policy, particles), [])
        group.append(index)
        if len(group) == (devices if policy in POLICIES else 1):
            yield alike.pop((policy, particles))
    yield from alike.values()


def _run_together(run: _Run, files: list[int]) -> int:
    """Run the episodes of a round and write its files; how many episodes they were."""
    grid, chunks = run.plan.grid, [run.plan.chunk(index) for index in files]
    tasks = [one.arm.tasks(grid.draw(one.places)) for one in chunks]
    results = _results(chunks, tasks, run.sentences)
    for chunk, own, result in zip(chunks, tasks, results, strict=True):
        columns = typed(grid.labels(chunk.arm, chunk.places))
        columns |= result_columns(result, known_distances(own))
        path = file_path(run.folder, chunk.index)
        shard = Shard(sweep=run.sweep, index=chunk.index, rows=chunk.size)
        try:
            write_shard(columns, path, shard)
        except OSError as error:
            raise OSError(
                f"{path} cannot be written: {error}; the other files stay, go on with --resume"
            ) from error
    return sum(one.size for one in chunks)


def _results(
    chunks: list[Chunk], tasks: list[Task], sentences: GroundedSentences
) -> list[EpisodeResult]:
    """Run chunks of one policy and size, each with the Params of its own arm."""
    arms = [one.arm for one in chunks]
    works = [
        Work(tasks=fill(own, 0, one.size), count=one.size, params=one.arm.params)
        for one, own in zip(chunks, tasks, strict=True)
        if one.arm.params is not None
    ]
    if arms[0].config is None or not works:
        return [
            arm.run(own, sentences.instructions, num_threads=1)
            for arm, own in zip(arms, tasks, strict=True)
        ]
    return run_round(works, sentences.instructions, config=arms[0].config)
