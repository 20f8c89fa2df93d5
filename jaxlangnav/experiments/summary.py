"""What a sweep found: a row for every arm in every setting, and paired tests (section 4.2)."""

import dataclasses
import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.experiments.metrics import summarize
from jaxlangnav.experiments.paired import compare
from jaxlangnav.experiments.summary_tables import markdown, render
from jaxlangnav.experiments.sweep import MANIFEST

__all__ = ["markdown", "render", "summarize_directory"]

_ARM = ("policy", "particles")
_PAIR = ("seed", "episode")
_MOST_PAIRS = 6
"""Arms up to which all pairs are compared; with more, each is compared with the first."""


def summarize_directory(path: str | Path) -> dict[str, Any]:
    """Summarise the files of a sweep, complete or not.

    Args:
        path: the sweep's folder.

    Returns:
        ``name``, ``rows`` (one per setting and arm, rates in percent, distances in metres),
        ``comparisons`` (second arm against first in one setting), ``varied`` (columns that take
        more than one value), ``episodes``, ``files`` and ``missing`` files.

    Raises:
        ValueError: no sweep there, or nothing of it is done yet.
    """
    folder = Path(path)
    if not (folder / MANIFEST).is_file():
        raise ValueError(f"{folder} holds no sweep: there is no {MANIFEST}")
    settings = json.loads((folder / MANIFEST).read_text("utf-8"))["settings"]
    files = sorted(folder.glob("episodes-*.parquet"))
    if not files:
        raise ValueError(f"{folder} holds no episodes yet")
    table = pa.concat_tables([pq.read_table(file) for file in files])
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
        "files": len(files),
        "missing": settings["files"] - len(files),
    }


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
    metrics = dataclasses.asdict(summarize(results, table["known_distance"].to_numpy()))
    return metrics | {"success_ci": [*metrics["success_ci"]]}


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
