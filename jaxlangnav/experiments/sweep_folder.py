"""The folder of a sweep: its manifest, its files, and what a killed process has left there.

The manifest is written once and never changed; it says which sweep the folder holds. Each file
says of itself which it is and what its bytes must be (``shards``).
"""

import dataclasses
import hashlib
import json
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.experiments.archive import json_text, manifest
from jaxlangnav.experiments.holding import Note
from jaxlangnav.experiments.monte_carlo import CHUNK, LANES
from jaxlangnav.experiments.shards import Shard, ShardError, check_shard
from jaxlangnav.experiments.sweep_plan import SweepPlan
from jaxlangnav.files.documents import parse_json, read_text
from jaxlangnav.files.whole import write_once
from jaxlangnav.plain_text import fault_of_name

MANIFEST = "manifest.json"
_IDENTITY = ("settings", "jaxlangnav", "libraries", "models_sha256", "device")
"""What must be the same for files of one sweep to belong together; not how many devices."""
_FILE = re.compile(r"episodes-(\d{6,})\.parquet")
_LEFT = re.compile(r"\.episodes-(\d{6,})\..*")
_LARGEST_MANIFEST = 16 << 20
"""Bytes of a manifest; it holds the configuration, of a million bytes at most, written out."""
_UNREADABLE = "restore it, or run the sweep in another folder"


def file_path(folder: Path, index: int) -> Path:
    """Name a file of a sweep."""
    return folder / f"episodes-{index:06d}.parquet"


def files_there(folder: Path) -> Iterator[tuple[int, Path]]:
    """Find the files of episodes that are there, sound or not.

    Args:
        folder: of the sweep.

    Yields:
        Number and path, in no order.
    """
    for path in folder.iterdir():
        match = _FILE.fullmatch(path.name)
        if match is not None:
            yield int(match[1]), path


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read which sweep a folder holds.

    Args:
        folder: of the sweep.

    Returns:
        The manifest.

    Raises:
        ValueError: none is there, or it is not one of a sweep.
    """
    path = folder / MANIFEST
    if not path.exists():
        raise ValueError(f"{folder} holds no sweep: there is no {MANIFEST}")
    document: dict[str, Any] = {}
    try:
        document = parse_json(read_text(path, at_most=_LARGEST_MANIFEST))
        name, files = document["settings"]["name"], document["settings"]["files"]
        is_sound = isinstance(name, str) and fault_of_name(name) is None and type(files) is int
    except (ValueError, KeyError, TypeError):
        is_sound = False
    if not is_sound:
        raise ValueError(f"{path} is not the manifest of a sweep, or is damaged: {_UNREADABLE}")
    return document


def identity(document: dict[str, Any]) -> str:
    """Hash what the files of a sweep share, and what this version measures of an episode.

    Files of a version that measured something else are those of another sweep: they cannot stand
    in one table with these.

    Args:
        document: the manifest.

    Returns:
        SHA-256 in hexadecimal.
    """
    shared = {key: _uncounted(document.get(key)) for key in _IDENTITY}
    shared["measured"] = [field.name for field in dataclasses.fields(EpisodeResult)]
    return hashlib.sha256(json.dumps(shared, sort_keys=True).encode()).hexdigest()


def claim_folder(
    folder: Path, plan: SweepPlan, mine: Sequence[int], models: Any, *, is_resumed: bool
) -> str:
    """Write the manifest, or see that the one that is there is ours.

    Args:
        folder: of the sweep.
        plan: of the sweep.
        mine: numbers of the files to be made.
        models: the trained weights, for their hash.
        is_resumed: whether files may be there already.

    Returns:
        The sweep's identity.

    Raises:
        ValueError: the folder holds another sweep, or this one and it is not resumed.
    """
    settings = plan.config.document() | {
        "chunk": CHUNK,
        "lanes": LANES,
        "files": plan.num_files,
        "rows": plan.episodes(),
    }
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


def sweep_up(folder: Path, mine: Sequence[int]) -> None:
    """Remove the temporary files that killed writers have left; only while the part is held.

    Args:
        folder: of the sweep.
        mine: numbers of the files that nobody else writes.
    """
    for path in folder.iterdir():
        match = _LEFT.fullmatch(path.name)
        if match is not None and int(match[1]) in mine:
            path.unlink(missing_ok=True)


def sound_files(
    folder: Path,
    plan: SweepPlan,
    mine: Sequence[int],
    sweep: str,
    *,
    on_note: Note,
    on_kept: Callable[[int], None],
) -> set[int]:
    """Find the files that are there and are what was written.

    Args:
        folder: of the sweep.
        plan: of the sweep.
        mine: numbers of the files to look at.
        sweep: its identity.
        on_note: told of each file that is there and is not sound.
        on_kept: called with the number of episodes of each sound one.

    Returns:
        Their numbers.
    """
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
        on_kept(plan.size(index))
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
