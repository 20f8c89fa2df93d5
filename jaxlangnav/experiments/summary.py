"""Summary of a sweep: metrics per arm and setting, and paired tests of arms (section 4.2)."""

import dataclasses
import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.experiments.metrics import compare, summarize, timeouts_text
from jaxlangnav.experiments.shards import FileError, read_rows
from jaxlangnav.experiments.sweep import episode_files, identity, read_manifest
from jaxlangnav.experiments.table import SUCCESS_FORMAT, Document, Row, Table, TableColumns
from jaxlangnav.inputs import sanitize

_ARM_COLUMNS = ("policy", "particles")
_PAIR_COLUMNS = ("seed", "episode")
_ALL_PAIRS_LIMIT = 6
"""Number of arms up to which all pairs are tested; with more, each against the first."""


def summarize_directory(path: str | Path) -> dict[str, Any]:
    """Summarise the files of a sweep's folder, complete or not; damaged files count as missing.

    ``name``, ``rows`` (one per setting and arm, rates in percent, distances in metres),
    ``comparisons`` (second arm against first in one setting), ``varied`` (columns that take more
    than one value), ``episodes``, ``files``, ``missing`` files and, of those, the ``damaged``: a
    line for each with its path and fault. ``ValueError``: the folder has no sweep, or no valid file
    yet.
    """
    folder = Path(path)
    manifest = read_manifest(folder)
    sweep_config, sweep = manifest["settings"], identity(manifest)
    tables, damaged = list[pa.Table](), list[str]()
    for index, file in sorted(episode_files(folder)):
        try:
            tables.append(read_rows(file, sweep=sweep, index=index))
        except FileError as error:
            damaged.append(f"{file} {error}")
    if not tables:
        more_files = f" (and {len(damaged) - 1} others)" if len(damaged) > 1 else ""
        reason = f": {damaged[0]}{more_files}" if damaged else " yet"
        raise ValueError(f"{folder} holds no {'sound ' if damaged else ''}episodes{reason}")
    table = pa.concat_tables(tables)
    labels = table.column_names[: table.column_names.index("episode")]
    names = [name for name in labels if name not in _PAIR_COLUMNS]
    arm_names = [name for name in names if _is_arm_column(name)]
    setting_names = [name for name in names if not _is_arm_column(name)]
    rows, comparisons = list[Row](), list[Row]()
    for setting, setting_table in _group(table, setting_names):
        arms = _group(setting_table, arm_names)
        rows += [setting | arm | _metrics(episodes) for arm, episodes in arms]
        comparisons += [setting | comparison for comparison in _comparisons(arms)]
    return {
        "name": sweep_config["name"],
        "rows": rows,
        "comparisons": comparisons,
        "varied": [name for name in names if len(table[name].unique()) > 1],
        "episodes": table.num_rows,
        "files": len(tables),
        "missing": sweep_config["files"] - len(tables),
        "damaged": damaged,
    }


def _is_arm_column(name: str) -> bool:
    return name in _ARM_COLUMNS or name.startswith(("map.", "planner."))


def _group(table: pa.Table, names: Sequence[str]) -> list[tuple[dict[str, Any], pa.Table]]:
    """Group a table by the values of some columns, in order of appearance."""
    indexed = table.append_column("row", pa.array(range(table.num_rows)))
    groups = indexed.group_by(names, use_threads=False).aggregate([("row", "list")]).to_pylist()
    return [({name: g[name] for name in names}, table.take(g["row_list"])) for g in groups]


def _metrics(table: pa.Table) -> dict[str, Any]:
    names = [field.name for field in dataclasses.fields(EpisodeResult) if field.name != "final"]
    leaves: dict[str, Any] = {name: table[name].to_numpy() for name in names}
    leaves["final"] = np.stack([table[f"final_{axis}"].to_numpy() for axis in "xy"], axis=1)
    metrics = summarize(EpisodeResult(**leaves), table["known_distance"].to_numpy())
    return dataclasses.asdict(metrics)


def _comparisons(arms: list[tuple[dict[str, Any], pa.Table]]) -> list[dict[str, Any]]:
    """Test the arms of one setting in pairs, over the valid episodes that both ran."""
    pairs = list(itertools.combinations(arms, 2))
    if len(arms) > _ALL_PAIRS_LIMIT:
        pairs = [(arms[0], other) for other in arms[1:]]
    comparisons = []
    for (first, first_table), (second, second_table) in pairs:
        valid = (table.filter(table["is_valid"]) for table in (first_table, second_table))
        a, b = (table.select([*_PAIR_COLUMNS, "is_success", "distance"]) for table in valid)
        joined = a.join(b, keys=[*_PAIR_COLUMNS], join_type="inner", right_suffix=" 2")
        joined = joined.sort_by([(name, "ascending") for name in _PAIR_COLUMNS])
        if joined.num_rows:
            names = ("is_success", "is_success 2", "distance", "distance 2")
            comparison = compare(*(joined[name].to_numpy() for name in names))
            comparisons.append({"first": first, "second": second, **comparison._asdict()})
    return comparisons


_LABELS = ("world", "relation", "range", "policy")
_RESULT_COLUMNS: TableColumns = (
    ("Episodes", "{episodes}"),
    ("Success % (95 %)", SUCCESS_FORMAT),
    ("Distance m (σ)", "{distance_mean:.2f} ({distance_sd:.2f})"),
    ("Known m", "{known_distance_mean:.2f}"),
    ("SPL", "{spl:.2f}"),
    ("Time-outs", timeouts_text),
)
_TEST_COLUMNS: TableColumns = (
    ("Pairs", "{pairs}"),
    ("Only 1st, 2nd", "{success_only_first}, {success_only_second}"),
    ("p", "{success_p:.3g}"),
    ("Distance, 2nd − 1st m (95 %)",
     "{distance_difference:+.2f} ({distance_ci[0]:+.2f} to {distance_ci[1]:+.2f})"),
    ("p", "{distance_p:.3g}"),
)  # fmt: skip
_TEST_NOTE = (
    "Pairs ran the same world with the same noise. Success: exact McNemar test. Distance: mean "
    "difference, sign-flip permutation test."
)


def _tables(summary: Document) -> list[Table]:
    """Build the tables of a summary: its rows, and the paired tests if any."""
    varied, row, tests = summary["varied"], summary["rows"][0], summary["comparisons"]
    labels = [name for name in row if name in _LABELS or (name in varied and name != "command")]

    def text(value: Any) -> str:
        if value is None:
            return "-"
        return f"{value:g}" if isinstance(value, float) else str(value)

    def columns_of(names: Iterable[str]) -> TableColumns:
        return [(name, lambda row, name=name: text(row[name])) for name in names]

    def arm_label(row: dict[str, Any]) -> str:
        varied_values = [
            f"{name.split('.')[-1]} {text(value)}"
            for name, value in row.items()
            if name != "policy" and name in varied and value is not None
        ]
        return " ".join([row["policy"], *varied_values])

    missing = f"; {summary['missing']} files are still missing" if summary["missing"] else ""
    if summary["damaged"]:
        missing += f", {len(summary['damaged'])} of them because they are damaged"
    caption = f"{summary['episodes']} episodes in {summary['files']} files{missing}."
    columns = [*columns_of(labels), *_RESULT_COLUMNS]
    tables = [Table.of(summary["rows"], columns, title=summary["name"], caption=caption)]
    if tests:
        arm_columns: TableColumns = [
            (heading, lambda row, side=side: arm_label(row[side]))
            for heading, side in (("1st", "first"), ("2nd", "second"))
        ]
        setting_columns = columns_of(name for name in labels if name in tests[0])
        columns = [*setting_columns, *arm_columns, *_TEST_COLUMNS]
        tables.append(Table.of(tests, columns, title="Paired tests", caption=_TEST_NOTE))
    return tables


def summary_markdown(summary: Document) -> str:
    """Format a summary of ``summarize_directory`` in Markdown: title, rows, paired tests."""
    rows, *tests = _tables(summary)
    parts = [f"# {sanitize.markdown(rows.title)}", rows.caption, rows.markdown().rstrip()]
    for table in tests:
        parts += [f"## {table.title}", table.markdown().rstrip(), table.caption]
    return "\n\n".join(parts) + "\n"


def render(summary: Document) -> Any:
    """Render a summary of ``summarize_directory`` for the terminal: a group of rich tables."""
    from rich.console import Group

    return Group(*(table.text() for table in _tables(summary)))
