"""Sweeps: any grid of episodes, resumable, split over any number of processes (section 4.2).

Every file holds the episodes of one chunk of the plan, is written whole or not at all, and says of
itself what its bytes must be (``shards``): a killed process or a full disk loses the chunks under
way, and a damaged file is found and made again. A file depends on the configuration alone, so a
resumed or split sweep ends with the same bytes as an undisturbed one on the same kind of machine.
The manifest of the folder is written once; it says which sweep the folder holds.
"""

import dataclasses
import functools
import hashlib
import json
import re
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.experiments.archive import CompileClock, json_text, manifest
from jaxlangnav.experiments.monte_carlo import (
    CHUNK,
    LANES,
    OnProgress,
    Work,
    fill,
    mesh,
    num_calls,
    run_ahead,
    run_round,
)
from jaxlangnav.experiments.shards import Note, Shard, ShardError, check_shard, lock, write_shard
from jaxlangnav.experiments.sweep_config import SweepConfig
from jaxlangnav.experiments.sweep_plan import SweepPlan, make_plan, parse_shard
from jaxlangnav.experiments.tasks import GroundedSentences, ground_sentences, known_distances
from jaxlangnav.inputs.documents import parse_json, read_text
from jaxlangnav.inputs.sanitize import name_fault
from jaxlangnav.inputs.whole_files import write_once
from jaxlangnav.navigator import NavigatorConfig

MANIFEST = "manifest.json"
_IDENTITY = ("settings", "jaxlangnav", "libraries", "models_sha256", "device")
"""What must be the same for files of one sweep to belong together; not how many devices."""
_FILE = re.compile(r"episodes-(\d{6,})\.parquet")
_LEFT = re.compile(r"\.episodes-(\d{6,})\..*")
_LARGEST_MANIFEST = 16 << 20
"""Bytes of a manifest; it holds the configuration, of a million bytes at most, written out."""
_UNREADABLE = "restore it, or run the sweep in another folder"


def files_there(folder: Path) -> Iterator[tuple[int, Path]]:
    """Find the files of episodes in a sweep's folder, sound or not, in no order: number, path."""
    for path in folder.iterdir():
        match = _FILE.fullmatch(path.name)
        if match is not None:
            yield int(match[1]), path


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read which sweep a folder holds; ``ValueError`` where there is no sound manifest of one."""
    path = folder / MANIFEST
    if not path.exists():
        raise ValueError(f"{folder} holds no sweep: there is no {MANIFEST}")
    document: dict[str, Any] = {}
    try:
        document = parse_json(read_text(path, at_most=_LARGEST_MANIFEST))
        name, files = document["settings"]["name"], document["settings"]["files"]
        is_sound = isinstance(name, str) and name_fault(name) is None and type(files) is int
    except (ValueError, KeyError, TypeError):
        is_sound = False
    if not is_sound:
        raise ValueError(f"{path} is not the manifest of a sweep, or is damaged: {_UNREADABLE}")
    return document


def identity(document: dict[str, Any]) -> str:
    """Hash what the files of a manifest's sweep share, and what this version measures: SHA-256.

    Files of a version that measured something else cannot stand in one table with these.
    """
    shared = {key: _uncounted(document.get(key)) for key in _IDENTITY}
    shared["measured"] = [field.name for field in dataclasses.fields(EpisodeResult)]
    return hashlib.sha256(json.dumps(shared, sort_keys=True).encode()).hexdigest()


def _claim_folder(
    folder: Path, plan: SweepPlan, mine: Sequence[int], models: Any, *, is_resumed: bool
) -> str:
    """Write the manifest, or see that the one that is there is ours; the sweep's identity."""
    sizes = {"chunk": CHUNK, "lanes": LANES, "files": plan.num_files}
    sizes["rows"] = plan.episodes_of("1/1")
    settings = plan.config.document() | sizes
    ours = json.loads(json.dumps(manifest(settings, models=models)))
    path = folder / MANIFEST
    # Looked at in this order because peers may be claiming the folder too: manifest first.
    has_episodes = any(True for _ in files_there(folder))
    if not path.exists():
        if has_episodes:
            raise ValueError(f"{folder} holds episodes without a manifest: choose another folder")
        write_once(json_text(ours).encode(), path)
    # Read back in any case: of several sweeps that begin at once here, one has written it.
    theirs = read_manifest(folder)
    for key in _IDENTITY:
        there, here = _uncounted(theirs.get(key)), _uncounted(ours[key])
        if there != here:
            what = _difference(there, here, key)
            raise ValueError(f"{folder} holds another sweep ({what}): choose another folder")
    if not is_resumed and any(index in mine for index, _ in files_there(folder)):
        raise ValueError(f"{folder} already holds episodes of this sweep: add --resume")
    return identity(ours)


def _sound_files(
    folder: Path, plan: SweepPlan, mine: Sequence[int], sweep: str, on_note: Note
) -> set[int]:
    """Find the numbers of those of our files that are there and are what was written."""
    kept = set()
    for index, path in sorted(files_there(folder)):
        if index not in mine:
            continue
        try:
            check_shard(path, Shard(sweep=sweep, index=index, rows=plan.size(index)))
        except ShardError as fault:
            if path.is_dir():
                raise ValueError(f"{path}: is a folder where a file belongs: remove it") from None
            on_note(f"note: {path} {fault}; it is made again")
            continue
        kept.add(index)
    return kept


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


def total_episodes(config: SweepConfig, *, shard: str = "1/1") -> int:
    """Count the episodes of a shard "i/n", those done included; refuses as ``make_plan``."""
    return make_plan(config).episodes_of(shard)


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
        all shards are there), ``wall_s`` with compilation, ``compile_s`` of it. Refused are a
        folder of another sweep, this one's without ``resume``, files that a living process works
        on, and a sweep larger than a folder or memory.
    """
    begin, folder = time.perf_counter(), Path(out)
    plan = make_plan(config)
    mine = plan.files(shard)
    advance: OnProgress = on_progress or (lambda _done: None)
    note: Note = on_note or (lambda _line: None)
    with CompileClock() as clock:
        sentences = ground_sentences([one.text for one in config.commands])
        with lock(folder, parse_shard(shard), on_note=note) as is_held:
            sweep = _claim_folder(folder, plan, mine, sentences.models, is_resumed=resume)
            if is_held:
                # What killed writers have left, of files that nobody else writes.
                for path in folder.iterdir():
                    if (match := _LEFT.fullmatch(path.name)) and int(match[1]) in mine:
                        path.unlink(missing_ok=True)
            kept = _sound_files(folder, plan, mine, sweep, note)
            num_kept = sum(map(plan.size, kept))
            advance(num_kept)
            make = functools.partial(_make_files, plan, folder, sweep, sentences)
            todo = _rounds((at for at in mine if at not in kept), plan.kind, mesh().size)
            for done in run_ahead(make, todo, num_threads or num_calls()):
                advance(done)
    return {
        "out": str(folder),
        "name": config.name,
        "shard": shard,
        "episodes": plan.episodes_of(shard) - num_kept,
        "kept": num_kept,
        "files": len(mine),
        "is_complete": sum(at < plan.num_files for at, _ in files_there(folder)) == plan.num_files,
        "wall_s": time.perf_counter() - begin,
        "compile_s": clock.seconds,
    }


def _rounds(
    files: Iterable[int], kind: Callable[[int], tuple[str, int | None]], devices: int
) -> Iterator[list[int]]:
    """Gather files that one call can make, one on each device."""
    alike: dict[tuple[str, int | None], list[int]] = {}
    for index in files:
        group = alike.setdefault(of := kind(index), [])
        group.append(index)
        if len(group) == devices:
            yield alike.pop(of)
    yield from alike.values()


def _make_files(
    plan: SweepPlan, folder: Path, sweep: str, sentences: GroundedSentences, files: list[int]
) -> int:
    """Run the episodes of a round and write its files; how many episodes they were."""
    grid, arms = plan.grid, [plan.arm(index) for index in files]
    places = [plan.places(index) for index in files]
    tasks = [arm.tasks(grid.draw(own)) for arm, own in zip(arms, places, strict=True)]
    # Files of one policy and size run together, each with the Params of its own arm.
    works = [
        Work(tasks=fill(own, 0, size), count=size, params=arm.params)
        for arm, own, size in zip(arms, tasks, map(plan.size, files), strict=True)
    ]
    config = arms[0].config or NavigatorConfig()
    results = run_round(works, sentences.instructions, config=config, course=arms[0].course)
    for index, arm, at, own, result in zip(files, arms, places, tasks, results, strict=True):
        columns = grid.columns(arm, at, result, known_distances(own))
        path = folder / f"episodes-{index:06d}.parquet"
        try:
            write_shard(columns, path, Shard(sweep=sweep, index=index, rows=len(at)))
        except OSError as error:
            raise OSError(
                f"{path} cannot be written: {error}; the other files stay, go on with --resume"
            ) from error
    return sum(map(plan.size, files))
