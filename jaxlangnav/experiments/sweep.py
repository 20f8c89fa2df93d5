"""Sweeps: any grid of episodes, resumable, split over any number of processes (section 4.2).

Every file holds the episodes of one chunk of the plan and is written whole or not at all: a
killed process or a full disk loses the chunks under way and nothing else. Which episodes a file
holds, and what they give, depends on the configuration alone, so a resumed or split sweep ends
with the same bytes as an undisturbed one on the same kind of machine.
"""

import concurrent.futures
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from jaxlangnav.episode import EpisodeResult, Task
from jaxlangnav.experiments.archive import manifest, write_manifest, write_table
from jaxlangnav.experiments.compilation import CompileClock
from jaxlangnav.experiments.devices import (
    CHUNK,
    LANES,
    Work,
    fill,
    mesh,
    num_calls,
    run_round,
)
from jaxlangnav.experiments.monte_carlo import Progress, known_distances
from jaxlangnav.experiments.policies import DEFAULT_PARTICLES, navigator_config, run_policy
from jaxlangnav.experiments.rows import result_columns
from jaxlangnav.experiments.sentences import GroundedSentences, ground_sentences
from jaxlangnav.experiments.sweep_config import SweepConfig
from jaxlangnav.experiments.sweep_plan import (
    Arm,
    Chunk,
    Plan,
    chunk_columns,
    chunk_tasks,
    make_plan,
    shard_chunks,
)
from jaxlangnav.planner.params import POLICIES

MANIFEST = "manifest.json"
_IDENTITY = ("settings", "jaxlangnav", "libraries", "models_sha256", "device")
"""What must be the same for files of one sweep to belong together; not how many devices."""


def chunk_path(out: Path, chunk: Chunk) -> Path:
    """Name the file of a chunk."""
    return out / f"episodes-{chunk.index:06d}.parquet"


def total_episodes(config: SweepConfig, *, shard: str = "1/1") -> int:
    """Count the episodes of a shard, for a progress bar.

    Args:
        config: the grid.
        shard: "i/n".

    Returns:
        Episodes, those already done included.

    Raises:
        ValueError: the shard is not of this form, or Params that cannot be.
    """
    return sum(one.size for one in shard_chunks(make_plan(config), shard))


def run_sweep(
    config: SweepConfig,
    out: str | Path,
    *,
    resume: bool = False,
    shard: str = "1/1",
    on_progress: Progress | None = None,
    num_threads: int | None = None,
) -> dict[str, Any]:
    """Run a sweep, or a shard of it.

    Args:
        config: the grid, see ``read_config``.
        out: folder of the files; made if it is not there. All shards share it.
        resume: keep the chunks that are there and run the rest.
        shard: "i/n", the i-th of n parts.
        on_progress: called with the number of episodes just finished, kept ones at once.
        num_threads: calls under way at once; as many as keep all cores busy by default.

    Returns:
        ``out``, ``episodes`` run now, ``kept`` from before, ``files``, ``is_complete`` (all
        shards together), ``wall_s`` with compilation, ``compile_s`` of it.

    Raises:
        ValueError: the folder holds another sweep, or this one and ``resume`` is not set.
    """
    begin, folder = time.perf_counter(), Path(out)
    plan = make_plan(config)
    mine = shard_chunks(plan, shard)
    with CompileClock() as clock:
        sentences = ground_sentences([one.text for one in config.commands])
        _claim(folder, plan, mine, sentences, is_resumed=resume)
        done = [one for one in mine if chunk_path(folder, one).exists()]
        todo = [one for one in mine if not chunk_path(folder, one).exists()]
        kept = sum(one.size for one in done)
        if kept and on_progress is not None:
            on_progress(kept)
        _run_chunks(plan, todo, folder, sentences, on_progress, num_threads)
    return {
        "out": str(folder),
        "name": config.name,
        "shard": shard,
        "episodes": sum(one.size for one in todo),
        "kept": kept,
        "files": len(mine),
        "is_complete": all(chunk_path(folder, one).exists() for one in plan.chunks),
        "wall_s": time.perf_counter() - begin,
        "compile_s": clock.seconds,
    }


def _claim(
    folder: Path, plan: Plan, mine: list[Chunk], sentences: GroundedSentences, *, is_resumed: bool
) -> None:
    """Write the manifest, or see that the one that is there is ours; sweep up torn files."""
    settings = plan.config.document() | {
        "chunk": CHUNK,
        "lanes": LANES,
        "files": len(plan.chunks),
        "rows": plan.episodes(),
    }
    ours = json.loads(json.dumps(manifest(settings, models=sentences.models)))
    path = folder / MANIFEST
    # Looked at in this order because peers may be claiming the folder too: manifest first.
    has_episodes = any(folder.glob("episodes-*.parquet"))
    if path.exists():
        theirs = json.loads(path.read_text("utf-8"))
        for key in _IDENTITY:
            there, here = _uncounted(theirs.get(key)), _uncounted(ours[key])
            if there != here:
                what = _difference(there, here, key)
                raise ValueError(f"{folder} holds another sweep ({what}): choose another folder")
        if not is_resumed and any(chunk_path(folder, one).exists() for one in mine):
            raise ValueError(f"{folder} already holds episodes of this sweep: add --resume")
    else:
        if has_episodes:
            raise ValueError(f"{folder} holds episodes without a manifest: choose another folder")
        write_manifest(ours, path)
    for one in mine:
        whole = chunk_path(folder, one)
        whole.with_name(f".{whole.name}.partial").unlink(missing_ok=True)


def _uncounted(value: Any) -> Any:
    """Leave out how many devices there are: the results do not depend on it."""
    if isinstance(value, dict):
        return {key: one for key, one in value.items() if key != "count"}
    return value


def _difference(theirs: Any, ours: Any, name: str) -> str:
    """Say in a few words in what two manifests differ first."""
    if isinstance(theirs, dict) and isinstance(ours, dict):
        for key in {**ours, **theirs}:
            if theirs.get(key) != ours.get(key):
                where = key if name == "settings" else f"{name}.{key}"
                return _difference(theirs.get(key), ours.get(key), where)
    return f"{name}: {theirs} there, {ours} here"


def _run_chunks(
    plan: Plan,
    todo: list[Chunk],
    folder: Path,
    sentences: GroundedSentences,
    on_progress: Progress | None,
    num_threads: int | None,
) -> None:
    """Run chunks, several at once; the first failure ends the run and keeps what is written."""
    with concurrent.futures.ThreadPoolExecutor(num_threads or num_calls()) as pool:
        running = {
            pool.submit(_run_together, plan, chunks, folder, sentences): chunks
            for chunks in rounds(todo, mesh().size)
        }
        try:
            for finished in concurrent.futures.as_completed(running):
                finished.result()
                if on_progress is not None:
                    on_progress(sum(one.size for one in running[finished]))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def rounds(chunks: list[Chunk], devices: int) -> list[list[Chunk]]:
    """Gather chunks that one call can run, one on each device.

    Args:
        chunks: to be run.
        devices: how many there are.

    Returns:
        Every chunk once; those of a round share policy and particles. A baseline's chunk, which
        is computed in no time, is a round of its own.
    """
    alike: dict[tuple[str, int | None], list[Chunk]] = {}
    for one in chunks:
        alike.setdefault((one.arm.policy, one.arm.particles), []).append(one)
    gathered = []
    for (policy, _), group in alike.items():
        width = devices if policy in POLICIES else 1
        gathered += [group[at : at + width] for at in range(0, len(group), width)]
    return gathered


def _run_together(
    plan: Plan, chunks: list[Chunk], folder: Path, sentences: GroundedSentences
) -> None:
    """Run the episodes of a round and write its files."""
    tasks = [chunk_tasks(plan, one) for one in chunks]
    arm = chunks[0].arm
    if arm.policy in POLICIES:
        results = _run_navigator(chunks, tasks, sentences, arm)
    else:
        results = [run_policy(arm.policy, tasks[0], sentences.instructions, num_threads=1)]
    for chunk, own, result in zip(chunks, tasks, results, strict=True):
        columns = chunk_columns(plan, chunk) | result_columns(result, known_distances(own))
        path = chunk_path(folder, chunk)
        try:
            write_table(_typed(columns), path)
        except OSError as error:
            raise OSError(
                f"{path} cannot be written: {error}; the other files stay, go on with --resume"
            ) from error


def _run_navigator(
    chunks: list[Chunk], tasks: list[Task], sentences: GroundedSentences, arm: Arm
) -> list[EpisodeResult]:
    """Run chunks of one policy and size, each with the Params of its own arm."""
    works = [
        Work(tasks=fill(own, 0, one.size), count=one.size, params=one.arm.params())
        for one, own in zip(chunks, tasks, strict=True)
    ]
    config = navigator_config(arm.policy, arm.particles or DEFAULT_PARTICLES)
    return run_round(works, sentences.instructions, config=config)


def _typed(columns: dict[str, Any]) -> dict[str, Any]:
    """Give columns that may be empty in a file the type they have in the others."""
    import pyarrow as pa

    typed: dict[str, Any] = {}
    for name, values in columns.items():
        if isinstance(values, np.ndarray):
            typed[name] = values
        elif name in ("particles", "seed", "episode"):
            typed[name] = pa.array(values, pa.int64())
        elif isinstance(values[0], str):
            typed[name] = pa.array(values, pa.string())
        else:
            typed[name] = pa.array(values, pa.float64())
    return typed
