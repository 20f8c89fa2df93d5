"""What a sweep found: a row for every arm in every setting, and paired tests (section 4.2)."""

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.experiments.metrics import summarize
from jaxlangnav.experiments.paired import compare
from jaxlangnav.experiments.shards import ShardError, read_shard
from jaxlangnav.experiments.summary_tables import render, summary_markdown
from jaxlangnav.experiments.sweep_folder import files_there, identity, read_manifest

__all__ = ["render", "summarize_directory", "summary_markdown"]

_ARM = ("policy", "particles")
_PAIR = ("seed", "episode")
_MOST_PAIRS = 6
"""Arms up to which all pairs are compared; with more, each is compared with the first."""


def summarize_directory(path: str | Path) -> dict[str, Any]:
    """Summarise the files of a sweep, complete or not; a damaged file counts as missing.

    Args:
        path: the sweep's folder.

    Returns:
        ``name``, ``rows`` (one per setting and arm, rates in percent, distances in metres),
        ``comparisons`` (second arm against first in one setting), ``varied`` (columns that take
        more than one value), ``episodes``, ``files``, ``missing`` files and, of those, the
        ``damaged``: a line for each that names it and says what is wrong.

    Raises:
        ValueError: no sweep there, or nothing of it is done yet, or nothing is sound.
    """
    folder = Path(path)
    document = read_manifest(folder)
    settings = document["settings"]
    table, files, damaged = _read_all(folder, identity(document))
    result_names = {field.name for field in dataclasses.fields(EpisodeResult)}
    names = [
        name
        for name in table.column_names[: table.column_names.index("episode")]
        if name not in result_names and name not in _PAIR
    ]
    arm_names = [name for name in names if _is_of_arm(name)]
    setting_names = [name for name in names if not _is_of_arm(name)]
    groups = _group(table, setting_names)
    rows: list[dict[str, Any]] = []
    comparisons: list[dict[str, Any]] = []
    for setting, part in groups:
        arms = _group(part, arm_names)
        rows += [setting | arm | _metrics(episodes) for arm, episodes in arms]
        comparisons += [setting | one for one in _comparisons(arms)]
    return {
        "name": settings["name"],
        "rows": rows,
        "comparisons": comparisons,
        "varied": [name for name in names if len(table[name].unique()) > 1],
        "episodes": table.num_rows,
        "files": files,
        "missing": settings["files"] - files,
        "damaged": damaged,
    }


def _read_all(folder: Path, sweep: str) -> tuple[pa.Table, int, list[str]]:
    """Read the sound files of a sweep, how many they are, and what is wrong with the others."""
    tables: list[pa.Table] = []
    damaged: list[str] = []
    for index, path in sorted(files_there(folder)):
        try:
            tables.append(read_shard(path, sweep=sweep, index=index))
        except ShardError as fault:
            damaged.append(f"{path} {fault}")
    if not tables:
        others = f" (and {len(damaged) - 1} others)" if len(damaged) > 1 else ""
        most = f": {damaged[0]}{others}" if damaged else " yet"
        raise ValueError(f"{folder} holds no {'sound ' if damaged else ''}episodes{most}")
    return pa.concat_tables(tables), len(tables), damaged


def _is_of_arm(name: str) -> bool:
    """Tell whether a column belongs to what is compared rather than to where."""
    return name in _ARM or name.startswith(("map.", "planner."))


def _group(table: pa.Table, names: Sequence[str]) -> list[tuple[dict[str, Any], pa.Table]]:
    """Split a table by the values of some columns, in the order in which they appear."""
    codes = np.zeros(table.num_rows, np.int64)
    for name in names:
        column = table[name].combine_chunks().dictionary_encode(null_encoding="encode")
        index = column.indices.to_numpy(zero_copy_only=False).astype(np.int64)
        codes = np.unique(codes * (len(column.dictionary) + 1) + index, return_inverse=True)[1]
    groups = []
    _, firsts = np.unique(codes, return_index=True)
    for first in sorted(firsts):
        part = table.filter(pa.array(codes == codes[first]))
        groups.append(({name: table[name][int(first)].as_py() for name in names}, part))
    return groups


def _metrics(table: pa.Table) -> dict[str, Any]:
    """Summarise the episodes of one arm in one setting."""
    leaves: dict[str, Any] = {
        field.name: table[field.name].to_numpy()
        for field in dataclasses.fields(EpisodeResult)
        if field.name != "final"
    }
    leaves["final"] = np.stack([table["final_x"].to_numpy(), table["final_y"].to_numpy()], axis=1)
    results = EpisodeResult(**leaves)
    return summarize(results, table["known_distance"].to_numpy()).row()


def _comparisons(arms: list[tuple[dict[str, Any], pa.Table]]) -> list[dict[str, Any]]:
    """Compare the arms of one setting in pairs."""
    pairs = list(itertools.combinations(arms, 2))
    if len(arms) > _MOST_PAIRS:
        pairs = [(arms[0], other) for other in arms[1:]]
    found = []
    for (first, first_table), (second, second_table) in pairs:
        a, b = _common(first_table, second_table)
        if not a.num_rows:
            continue
        comparison = compare(
            a["is_success"].to_numpy(),
            b["is_success"].to_numpy(),
            a["distance"].to_numpy(),
            b["distance"].to_numpy(),
        )
        found.append({"first": first, "second": second, **dataclasses.asdict(comparison)})
    return found


def _common(first: pa.Table, second: pa.Table) -> tuple[pa.Table, pa.Table]:
    """Keep the valid episodes that both tables hold, in the same order."""
    parts = []
    for table in (first, second):
        table = table.filter(table["is_valid"])
        keys = np.stack([table[name].to_numpy() for name in _PAIR], axis=1)
        parts.append((table, {tuple(key): index for index, key in enumerate(keys.tolist())}))
    (one, one_keys), (two, two_keys) = parts
    shared = sorted(one_keys.keys() & two_keys.keys())
    return (
        one.take(pa.array([one_keys[key] for key in shared], pa.int64())),
        two.take(pa.array([two_keys[key] for key in shared], pa.int64())),
    )
