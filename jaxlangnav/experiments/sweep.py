"""Parameter sweeps: resumable, and split over any number of processes (section 4.2).

Every file holds the episodes of one chunk of the plan, is written atomically, and contains the hash
of its bytes (``shards``): a killed process or a full disk loses the chunks in progress, and a
damaged file is detected and made again. A file depends on the configuration alone, so a resumed or
split sweep ends with the same bytes as an uninterrupted one on the same kind of machine.
The manifest of the folder is written once and identifies its sweep.
"""

import dataclasses
import functools
import hashlib
import json
import re
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.experiments.archive import CompileClock, json_text, manifest
from jaxlangnav.experiments.monte_carlo import (
    CHUNK_SIZE,
    NUM_LANES,  # concurrent episodes on a device
    DeviceBatch,
    OnProgress,
    concurrent_calls,
    mesh,
    pad_chunk,
    run_ahead,
    run_round,
)
from jaxlangnav.experiments.shards import FileError, FileId, OnNote, check_rows, lock, write_rows
from jaxlangnav.experiments.sweep_config import SweepConfig
from jaxlangnav.experiments.sweep_plan import SweepPlan, make_plan, parse_shard
from jaxlangnav.experiments.tasks import GroundedSentences, ground_sentences, known_distances
from jaxlangnav.inputs.atomic_files import write_once
from jaxlangnav.inputs.documents import parse_json, read_text
from jaxlangnav.inputs.sanitize import name_fault
from jaxlangnav.navigator import NavigatorConfig

MANIFEST = "manifest.json"
_IDENTITY = ("settings", "jaxlangnav", "libraries", "models_sha256", "device")
"""Manifest entries that files of one sweep must share; the number of devices is excluded."""
_FILE = re.compile(r"episodes-(\d{6,})\.parquet")
_TEMPORARY = re.compile(r"\.episodes-(\d{6,})\..*")
_MAX_MANIFEST_BYTES = 16 << 20
"""Limit of a manifest's size; the configuration in it may have a million bytes."""
_REMEDY = "restore it, or run the sweep in another folder"


def episode_files(folder: Path) -> Iterator[tuple[int, Path]]:
    """Yield index and path of the episode files in a sweep's folder, valid or not, unordered."""
    for path in folder.iterdir():
        if match := _FILE.fullmatch(path.name):
            yield int(match[1]), path


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read the manifest of a sweep's folder; ``ValueError`` where it is missing or invalid."""
    path = folder / MANIFEST
    if not path.exists():
        raise ValueError(f"{folder} holds no sweep: there is no {MANIFEST}")
    document: dict[str, Any] = {}
    try:
        document = parse_json(read_text(path, max_bytes=_MAX_MANIFEST_BYTES))
        name, files = document["settings"]["name"], document["settings"]["files"]
        is_valid = isinstance(name, str) and name_fault(name) is None and type(files) is int
    except (ValueError, KeyError, TypeError):
        is_valid = False
    if not is_valid:
        raise ValueError(f"{path} is not the manifest of a sweep, or is damaged: {_REMEDY}")
    return document


def identity(document: dict[str, Any]) -> str:
    """Hash what identifies a sweep, and the metrics of this version: SHA-256.

    Files of a version with other metrics cannot be combined with these in one table.
    """
    measured = [field.name for field in dataclasses.fields(EpisodeResult)]
    shared = _identifying(document) | {"measured": measured}
    return hashlib.sha256(json.dumps(shared, sort_keys=True).encode()).hexdigest()


def _identifying(document: dict[str, Any]) -> dict[str, Any]:
    """Select what identifies a sweep: not the number of devices, on which no result depends."""
    shared = {key: document.get(key) for key in _IDENTITY}
    if isinstance(device := shared["device"], dict):
        shared["device"] = {key: value for key, value in device.items() if key != "count"}
    return shared


def _open_folder(
    folder: Path, plan: SweepPlan, indices: Sequence[int], models: Any, *, is_resumed: bool
) -> str:
    """Write the manifest, or check that the existing one is of this sweep; return its identity."""
    sizes = {"files": plan.num_files, "rows": len(plan.grid.arms) * plan.episodes_of_arm}
    settings = plan.config.document() | {"chunk": CHUNK_SIZE, "lanes": NUM_LANES} | sizes
    required = json.loads(json.dumps(manifest(settings, models=models)))
    path = folder / MANIFEST
    # In this order because other processes may be writing the manifest at the same time.
    has_episodes = any(True for _ in episode_files(folder))
    if not path.exists():
        if has_episodes:
            raise ValueError(f"{folder} holds episodes without a manifest: choose another folder")
        write_once(json_text(required).encode(), path)
    # Read back in any case: of several sweeps that start here at once, one has written it.
    theirs, ours = _identifying(read_manifest(folder)), _identifying(required)
    if theirs != ours:
        difference = _difference(theirs, ours)
        raise ValueError(f"{folder} holds another sweep ({difference}): choose another folder")
    if not is_resumed and any(index in indices for index, _ in episode_files(folder)):
        raise ValueError(f"{folder} already holds episodes of this sweep: add --resume")
    return identity(required)


def _valid_files(
    folder: Path, plan: SweepPlan, indices: Sequence[int], sweep_id: str, on_note: OnNote
) -> set[int]:
    """Find the indices of those of our files that exist and are valid."""
    valid = set()
    for index, path in sorted(item for item in episode_files(folder) if item[0] in indices):
        try:
            check_rows(path, FileId(sweep=sweep_id, index=index, rows=plan.size(index)))
        except FileError as fault:
            if path.is_dir():
                raise ValueError(f"{path}: is a folder where a file belongs: remove it") from None
            on_note(f"note: {path} {fault}; it is made again")
        else:
            valid.add(index)
    return valid


def _difference(theirs: Any, ours: Any, name: str = "") -> str:
    """Describe the first difference between two manifests, at their part ``name``."""
    if isinstance(theirs, dict) and isinstance(ours, dict):
        for key in {**ours, **theirs}:
            if theirs.get(key) != ours.get(key):
                path = key if name in ("", "settings") else f"{name}.{key}"
                return _difference(theirs.get(key), ours.get(key), path)
    return f"{name}: {theirs} there, {ours} here"


def total_episodes(config: SweepConfig, *, shard: str = "1/1") -> int:
    """Count the episodes of a shard "i/n", finished ones included; raises as ``make_plan``."""
    return make_plan(config).episodes_of(shard)


def run_sweep(
    config: SweepConfig,
    out: str | Path,
    *,
    resume: bool = False,
    shard: str = "1/1",
    on_progress: OnProgress = lambda _: None,
    on_note: OnNote = lambda _: None,
    num_threads: int | None = None,
) -> dict[str, Any]:
    """Run a sweep, or a shard of it.

    Args:
        config: the grid; see ``read_config``.
        out: folder of the files, created if missing; shared by all shards.
        resume: keep existing valid files, and make the rest.
        shard: "i/n", the i-th of n parts.
        on_progress: called with the number of episodes just finished; first, of existing ones.
        on_note: called with a line for each damaged file, and for a dead process's lock.
        num_threads: concurrent calls; by default as many as keep all cores busy.

    Returns:
        ``out``, ``episodes`` run now, ``kept`` from before, ``files``, ``is_complete`` (files of
        all shards exist), ``wall_s`` with compilation, ``compile_s`` of it. Refused are a
        folder of another sweep, this one's without ``resume``, files that a living process works
        on, and a sweep larger than a folder or memory.
    """
    begin, folder = time.perf_counter(), Path(out)
    plan = make_plan(config)
    indices = plan.files(shard)
    with CompileClock() as clock:
        sentences = ground_sentences([command.text for command in config.commands])
        with lock(folder, parse_shard(shard), on_note=on_note) as is_locked:
            sweep_id = _open_folder(folder, plan, indices, sentences.models, is_resumed=resume)
            if is_locked:
                # Temporary files of killed writers; nobody else writes those of this shard.
                for path in folder.iterdir():
                    if (match := _TEMPORARY.fullmatch(path.name)) and int(match[1]) in indices:
                        path.unlink(missing_ok=True)
            valid = _valid_files(folder, plan, indices, sweep_id, on_note)
            num_valid, missing = sum(map(plan.size, valid)), (i for i in indices if i not in valid)
            on_progress(num_valid)
            run_files = functools.partial(_run_files, plan, folder, sweep_id, sentences)
            rounds = _rounds(plan, missing)
            for done in run_ahead(run_files, rounds, num_threads or concurrent_calls()):
                on_progress(done)
    return {
        "out": str(folder),
        "name": config.name,
        "shard": shard,
        "episodes": plan.episodes_of(shard) - num_valid,
        "kept": num_valid,
        "files": len(indices),
        "is_complete": sum(i < plan.num_files for i, _ in episode_files(folder)) == plan.num_files,
        "wall_s": time.perf_counter() - begin,
        "compile_s": clock.seconds,
    }


def _rounds(plan: SweepPlan, files: Iterable[int]) -> Iterator[list[int]]:
    """Group file indices into rounds of one program, one file per device."""
    groups: dict[tuple[str, int | None], list[int]] = {}
    for index in files:
        arm = plan.arm(index)
        key = arm.policy, arm.labels["particles"]  # a baseline has none
        group = groups.setdefault(key, [])
        group.append(index)
        if len(group) == mesh().size:
            yield groups.pop(key)
    yield from groups.values()


def _run_files(
    plan: SweepPlan, folder: Path, sweep_id: str, sentences: GroundedSentences, files: list[int]
) -> int:
    """Run the episodes of a round, write its files and return the number of episodes."""
    grid, arms = plan.grid, [plan.arm(index) for index in files]
    all_ids = [plan.episode_indices(index) for index in files]
    tasks = [arm.tasks(grid.draw(part)) for arm, part in zip(arms, all_ids, strict=True)]
    # Files of one policy and size run together, each with the Params of its arm.
    batches = [
        DeviceBatch(tasks=pad_chunk(part, 0, size), count=size, params=arm.params)
        for arm, part, size in zip(arms, tasks, map(plan.size, files), strict=True)
    ]
    config = arms[0].config or NavigatorConfig()
    results = run_round(batches, sentences.instructions, config=config, program=arms[0].program)
    for index, arm, ids, part, result in zip(files, arms, all_ids, tasks, results, strict=True):
        columns = grid.columns(arm, ids, result, known_distances(part))
        path = folder / f"episodes-{index:06d}.parquet"
        try:
            write_rows(columns, path, FileId(sweep=sweep_id, index=index, rows=len(ids)))
        except OSError as error:
            raise OSError(
                f"{path} cannot be written: {error}; the other files stay, go on with --resume"
            ) from error
    return sum(map(plan.size, files))
