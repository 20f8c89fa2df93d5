"""What a sweep found: a row for every arm in every setting, and paired tests (section 4.2)."""

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from jaxlangnav import plain_text
from jaxlangnav.episode import EpisodeResult
from jaxlangnav.experiments.metrics import compare, summarize, timeouts_text
from jaxlangnav.experiments.shards import ShardError, read_shard
from jaxlangnav.experiments.sweep_folder import files_there, identity, read_manifest
from jaxlangnav.experiments.table import Document, Table

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


_ALWAYS = ("world", "relation", "range", "policy")
_RESULTS = ("Episodes", "Success % (95 %)", "Distance m (σ)", "Known m", "SPL", "Time-outs")
_TESTS = ("Pairs", "Only 1st, 2nd", "p", "Distance, 2nd − 1st m (95 %)", "p")


def _rows_table(document: Document) -> Table:
    """Lay out the rows of a summary."""
    names = _names(document)
    cells = [
        [*(_text(row[name]) for name in names), *_result_cells(row)] for row in document["rows"]
    ]
    return Table(
        headings=[*names, *_RESULTS], rows=cells, title=document["name"], caption=_state(document)
    )


def _comparisons_table(document: Document) -> Table:
    """Lay out the paired tests of a summary."""
    comparisons = document["comparisons"]
    names = [name for name in _names(document) if comparisons and name in comparisons[0]]
    cells = []
    for one in comparisons:
        low, high = one["distance_ci"]
        first, second = (_arm(one[side], document["varied"]) for side in ("first", "second"))
        cells.append(
            [
                *(_text(one[name]) for name in names),
                first,
                second,
                str(one["pairs"]),
                f"{one['success_only_first']}, {one['success_only_second']}",
                f"{one['success_p']:.3g}",
                f"{one['distance_difference']:+.2f} ({low:+.2f} to {high:+.2f})",
                f"{one['distance_p']:.3g}",
            ]
        )
    headings = [*names, "1st", "2nd", *_TESTS]
    return Table(headings=headings, rows=cells, title="Paired tests", caption=_METHOD)


def summary_markdown(document: Document) -> str:
    """Write a summary as Markdown.

    Args:
        document: of ``summarize_directory``.

    Returns:
        Heading, rows, paired tests.
    """
    rows = _rows_table(document)
    parts = [f"# {plain_text.markdown(rows.title)}", rows.caption, rows.markdown().rstrip()]
    if document["comparisons"]:
        tests = _comparisons_table(document)
        parts += [f"## {tests.title}", tests.markdown().rstrip(), tests.caption]
    return "\n\n".join(parts) + "\n"


_METHOD = (
    "Pairs ran the same world with the same noise. Success: exact McNemar test. Distance: mean "
    "difference, sign-flip permutation test."
)


def render(document: Document) -> Any:
    """Draw a summary for the terminal.

    Args:
        document: of ``summarize_directory``.

    Returns:
        A rich group of tables.
    """
    from rich.console import Group

    tables = [_rows_table(document)]
    if document["comparisons"]:
        tables.append(_comparisons_table(document))
    return Group(*(one.text() for one in tables))


def _names(document: Document) -> list[str]:
    """Choose the columns worth showing, in the order of the files."""
    row = document["rows"][0]
    return [
        name
        for name in row
        if name in _ALWAYS or (name in document["varied"] and name != "command")
    ]


def _arm(arm: dict[str, Any], varied: Sequence[str]) -> str:
    """Name an arm by its policy and whatever else varies."""
    extra = [
        f"{name.split('.')[-1]} {_text(value)}"
        for name, value in arm.items()
        if name != "policy" and name in varied and value is not None
    ]
    return " ".join([arm["policy"], *extra])


def _result_cells(row: dict[str, Any]) -> list[str]:
    """Write the results of one row."""
    low, high = row["success_ci"]
    return [
        str(row["episodes"]),
        f"{row['success_rate']:.1f} ({low:.1f}-{high:.1f})",
        f"{row['distance_mean']:.2f} ({row['distance_sd']:.2f})",
        f"{row['known_distance_mean']:.2f}",
        f"{row['spl']:.2f}",
        timeouts_text(row),
    ]


def _text(value: Any) -> str:
    """Write a value of a column."""
    if value is None:
        return "-"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _state(document: Document) -> str:
    """Say how much of the sweep is there."""
    missing = f"; {document['missing']} files are still missing" if document["missing"] else ""
    if document["damaged"]:
        missing += f", {len(document['damaged'])} of them because they are damaged"
    return f"{document['episodes']} episodes in {document['files']} files{missing}."
