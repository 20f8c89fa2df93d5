"""What a sweep found: a row for every arm in every setting, and paired tests (section 4.2)."""

import dataclasses
import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.experiments.metrics import compare, summarize, timeouts_text
from jaxlangnav.experiments.shards import ShardError, read_shard
from jaxlangnav.experiments.sweep import episode_files, identity, read_manifest
from jaxlangnav.experiments.table import SUCCESS, Document, Row, Table, TableColumns
from jaxlangnav.inputs import sanitize

__all__ = ["render", "summarize_directory", "summary_markdown"]

_ARM = ("policy", "particles")
_PAIR = ("seed", "episode")
_ALL_PAIRS_LIMIT = 6
"""Arms up to which all pairs are compared; with more, each is compared with the first."""


def summarize_directory(path: str | Path) -> dict[str, Any]:
    """Summarise the files of a sweep's folder, complete or not; a damaged file counts as missing.

    ``name``, ``rows`` (one per setting and arm, rates in percent, distances in metres),
    ``comparisons`` (second arm against first in one setting), ``varied`` (columns that take more
    than one value), ``episodes``, ``files``, ``missing`` files and, of those, the ``damaged``: a
    line for each that names it and says what is wrong. ``ValueError``: no sweep there, or nothing
    sound yet.
    """
    folder = Path(path)
    manifest = read_manifest(folder)
    settings, sweep = manifest["settings"], identity(manifest)
    tables, damaged = list[pa.Table](), list[str]()
    for index, file in sorted(episode_files(folder)):
        try:
            tables.append(read_shard(file, sweep=sweep, index=index))
        except ShardError as fault:
            damaged.append(f"{file} {fault}")
    if not tables:
        others = f" (and {len(damaged) - 1} others)" if len(damaged) > 1 else ""
        most = f": {damaged[0]}{others}" if damaged else " yet"
        raise ValueError(f"{folder} holds no {'sound ' if damaged else ''}episodes{most}")
    table = pa.concat_tables(tables)
    result_names = {field.name for field in dataclasses.fields(EpisodeResult)}
    names = [
        name
        for name in table.column_names[: table.column_names.index("episode")]
        if name not in result_names and name not in _PAIR
    ]
    arm_names = [name for name in names if _is_of_arm(name)]
    setting_names = [name for name in names if not _is_of_arm(name)]
    rows, comparisons = list[Row](), list[Row]()
    for setting, part in _group(table, setting_names):
        arms = _group(part, arm_names)
        rows += [setting | arm | _metrics(episodes) for arm, episodes in arms]
        comparisons += [setting | one for one in _comparisons(arms)]
    return {
        "name": settings["name"],
        "rows": rows,
        "comparisons": comparisons,
        "varied": [name for name in names if len(table[name].unique()) > 1],
        "episodes": table.num_rows,
        "files": len(tables),
        "missing": settings["files"] - len(tables),
        "damaged": damaged,
    }


def _is_of_arm(name: str) -> bool:
    """Tell whether a column belongs to what is compared rather than to where."""
    return name in _ARM or name.startswith(("map.", "planner."))


def _group(table: pa.Table, names: Sequence[str]) -> list[tuple[dict[str, Any], pa.Table]]:
    """Split a table by the values of some columns, in the order in which they appear."""
    numbered = table.append_column("row", pa.array(range(table.num_rows)))
    found = numbered.group_by(names, use_threads=False).aggregate([("row", "list")]).to_pylist()
    return [({name: one[name] for name in names}, table.take(one["row_list"])) for one in found]


def _metrics(table: pa.Table) -> dict[str, Any]:
    names = [field.name for field in dataclasses.fields(EpisodeResult) if field.name != "final"]
    leaves: dict[str, Any] = {name: table[name].to_numpy() for name in names}
    leaves["final"] = np.stack([table[f"final_{axis}"].to_numpy() for axis in "xy"], axis=1)
    return summarize(EpisodeResult(**leaves), table["known_distance"].to_numpy()).row()


def _comparisons(arms: list[tuple[dict[str, Any], pa.Table]]) -> list[dict[str, Any]]:
    """Compare the arms of one setting in pairs, over the valid episodes that both ran."""
    pairs = list(itertools.combinations(arms, 2))
    if len(arms) > _ALL_PAIRS_LIMIT:
        pairs = [(arms[0], other) for other in arms[1:]]
    found = []
    for (first, *one), (second, *two) in pairs:
        valid = (table.filter(table["is_valid"]) for table in (*one, *two))
        a, b = (table.select([*_PAIR, "is_success", "distance"]) for table in valid)
        both = a.join(b, keys=[*_PAIR], join_type="inner", right_suffix=" 2")
        both = both.sort_by([(name, "ascending") for name in _PAIR])
        if both.num_rows:
            names = ("is_success", "is_success 2", "distance", "distance 2")
            comparison = compare(*(both[name].to_numpy() for name in names))
            found.append({"first": first, "second": second, **dataclasses.asdict(comparison)})
    return found


_ALWAYS = ("world", "relation", "range", "policy")
_RESULTS: TableColumns = (
    ("Episodes", "{episodes}"),
    ("Success % (95 %)", SUCCESS),
    ("Distance m (σ)", "{distance_mean:.2f} ({distance_sd:.2f})"),
    ("Known m", "{known_distance_mean:.2f}"),
    ("SPL", "{spl:.2f}"),
    ("Time-outs", timeouts_text),
)
_TESTS: TableColumns = (
    ("Pairs", "{pairs}"),
    ("Only 1st, 2nd", "{success_only_first}, {success_only_second}"),
    ("p", "{success_p:.3g}"),
    ("Distance, 2nd − 1st m (95 %)",
     "{distance_difference:+.2f} ({distance_ci[0]:+.2f} to {distance_ci[1]:+.2f})"),
    ("p", "{distance_p:.3g}"),
)  # fmt: skip
_METHOD = (
    "Pairs ran the same world with the same noise. Success: exact McNemar test. Distance: mean "
    "difference, sign-flip permutation test."
)


def _tables(document: Document) -> list[Table]:
    """Lay out the rows of a summary, and the paired tests if there are any."""
    varied, row, tests = document["varied"], document["rows"][0], document["comparisons"]
    shown = [name for name in row if name in _ALWAYS or (name in varied and name != "command")]

    def text(value: Any) -> str:
        if value is None:
            return "-"
        return f"{value:g}" if isinstance(value, float) else str(value)

    def values(names: Iterable[str]) -> TableColumns:
        return [(name, lambda row, name=name: text(row[name])) for name in names]

    def arm(row: dict[str, Any]) -> str:
        extra = [
            f"{name.split('.')[-1]} {text(value)}"
            for name, value in row.items()
            if name != "policy" and name in varied and value is not None
        ]
        return " ".join([row["policy"], *extra])

    missing = f"; {document['missing']} files are still missing" if document["missing"] else ""
    if document["damaged"]:
        missing += f", {len(document['damaged'])} of them because they are damaged"
    state = f"{document['episodes']} episodes in {document['files']} files{missing}."
    columns = [*values(shown), *_RESULTS]
    tables = [Table.of(document["rows"], columns, title=document["name"], caption=state)]
    if tests:
        sides: TableColumns = [
            (heading, lambda row, side=side: arm(row[side]))
            for heading, side in (("1st", "first"), ("2nd", "second"))
        ]
        of_setting = values(name for name in shown if name in tests[0])
        columns = [*of_setting, *sides, *_TESTS]
        tables.append(Table.of(tests, columns, title="Paired tests", caption=_METHOD))
    return tables


def summary_markdown(document: Document) -> str:
    """Write what ``summarize_directory`` found as Markdown: heading, rows, paired tests."""
    rows, *tests = _tables(document)
    parts = [f"# {sanitize.markdown(rows.title)}", rows.caption, rows.markdown().rstrip()]
    for one in tests:
        parts += [f"## {one.title}", one.markdown().rstrip(), one.caption]
    return "\n\n".join(parts) + "\n"


def render(document: Document) -> Any:
    """Draw what ``summarize_directory`` found for the terminal: a group of rich's tables."""
    from rich.console import Group

    return Group(*(one.text() for one in _tables(document)))
