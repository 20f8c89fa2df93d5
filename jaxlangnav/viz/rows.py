"""Results: the rows of a table as points with bars (Table 2, the summary of a sweep)."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from jaxlangnav.experiments.grid import Row
from jaxlangnav.experiments.tables import least_distance
from jaxlangnav.viz import style
from jaxlangnav.viz.sweep import (
    PAPER_BARS,
    Mark,
    half_interval,
    legend_of,
    looks_of,
    paper_look,
    paper_success_bars,
    success_bars,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LIMIT_NAME = "limit, map unknown"
MOST_LINES = 48
"""Settings of a sweep that one figure can show."""


def table_figure(document: Mapping[str, Any]) -> "Figure":
    """Draw the rows of a table beside the paper's: success at the left, distance at the right.

    Args:
        document: of ``experiments.table2``.

    Returns:
        The figure, a line for each row of the table.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ValueError: the document has no rows.
    """
    rows: Sequence[Row] = document["rows"]
    names = {_row_name(row) for row in rows}
    printed = [row for row in document.get("paper", ()) if _row_name(row) in names]
    number = document.get("episodes", "?")
    return _rows_figure(
        [(_row_name(row), row["policy"], row) for row in [*rows, *printed]],
        title="Table 2: ours beside the paper's",
        subtitle=f"{number} episodes a row; bars: 95 % interval of the mean; {PAPER_BARS}.",
        bounds={
            _row_name(bound): bound
            for bound in document.get("bounds", ())
            if _row_name(bound) in names
        },
    )


def summary_figure(document: Mapping[str, Any]) -> "Figure":
    """Draw the summary of a sweep: success at the left, distance at the right.

    Args:
        document: of ``experiments.summary.summarize_directory``.

    Returns:
        The figure, a line for each setting, its arms beneath one another.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ValueError: there are more than ``MOST_LINES`` settings.
    """
    lines = summary_lines(document)
    number = len({setting for setting, _, _ in lines})
    if number > MOST_LINES:
        raise ValueError(
            f"the sweep has {number} settings, but a figure can show {MOST_LINES}: sweep fewer at "
            "once, or draw what you need from the Parquet files"
        )
    return _rows_figure(
        lines,
        title=str(document["name"]),
        subtitle=f"{document['episodes']} episodes in all; bars: 95 % interval of the mean.",
        bounds={},
    )


def _rows_figure(
    lines: Sequence[tuple[str, str, Row]],
    *,
    title: str,
    subtitle: str,
    bounds: Mapping[str, Row],
) -> "Figure":
    """Draw rows as points with bars.

    Args:
        lines: what the row is called, the arm, its results; "paper" is an arm.
        title: the headline.
        subtitle: how to read the figure.
        bounds: limits by the row's name.

    Returns:
        The figure.

    Raises:
        ValueError: no lines.
    """
    if not lines:
        raise ValueError("the document has no rows, so there is nothing to draw")
    names = list(dict.fromkeys(name for name, _, _ in lines))
    arms = list(dict.fromkeys(arm for _, arm, _ in lines))
    looks = looks_of(arms)
    with style.house_style():
        from matplotlib.figure import Figure

        foot = 0.66 + 0.17 * math.ceil((len(arms) + bool(bounds)) / 3)
        figure = Figure(figsize=(9.2, 0.92 + foot + (0.3 + 0.055 * len(arms)) * len(names)))
        tall, longest = figure.get_figheight(), max(map(len, names))
        rates, ways = figure.subplots(1, 2, sharey=True)
        left = min(0.4, (0.3 + 0.06 * longest) / 9.2)
        figure.subplots_adjust(
            left=left, right=0.98, top=1 - 0.72 / tall, bottom=foot / tall, wspace=0.06
        )
        for place in range(0, len(names), 2):
            for axes in (rates, ways):
                axes.axhspan(place - 0.5, place + 0.5, color="#f4f5f7", zorder=0)
        for name, arm, row in lines:
            shift = 0.72 * ((arms.index(arm) + 0.5) / len(arms) - 0.5)
            _draw_row(rates, ways, row, looks[arm], names.index(name) + shift)
        for name, bound in bounds.items():
            _draw_limit(rates, bound["success"], names.index(name))
            _draw_limit(ways, least_distance(bound), names.index(name))
        _label_rows(rates, ways, names)
        style.title(figure, title, subtitle)
        handles, labels = legend_of([[rates]])
        figure.legend(handles, labels, loc="lower center", ncols=3)
    return figure


def summary_lines(document: Mapping[str, Any]) -> list[tuple[str, str, Row]]:
    """Name the settings and arms of a sweep's summary by what varies in them.

    Args:
        document: of ``experiments.summary.summarize_directory``.

    Returns:
        Setting, arm and row, in the document's order.
    """
    varied = set(document["varied"])
    # Baselines have no particles: that alone does not tell two arms apart.
    sizes = {row["particles"] for row in document["rows"] if row.get("particles") is not None}
    lines = []
    for row in document["rows"]:
        known = ("world", "range", "relation")
        extra = [
            f"{name.rpartition('.')[2].replace('_', ' ')} {row[name]:g}"
            for name in row
            if name in varied and isinstance(row[name], float) and name not in known
        ]
        is_arm = [name for name in row if name in varied and name.startswith(("map.", "planner."))]
        of_arm = [f"{name.rpartition('.')[2].replace('_', ' ')} {row[name]:g}" for name in is_arm
                  if row[name] is not None]  # fmt: skip
        if len(sizes) > 1 and row["particles"] is not None:
            of_arm.append(f"{row['particles']} particles")
        setting = ", ".join([_row_name(row), *(one for one in extra if one not in of_arm)])
        lines.append((setting, ", ".join([row["policy"], *of_arm]), row))
    return lines


def _row_name(row: Row) -> str:
    """Name a row of a table: "2H1C, 3 m, behind"."""
    relation = row["relation"] if row["relation"] not in (None, "null") else "no relation"
    return f"{row['world']}, {row['range']:g} m, {relation}"


def _label_rows(rates: "Axes", ways: "Axes", names: Sequence[str]) -> None:
    """Name the rows and the axes of a table's figure."""
    rates.set_yticks(range(len(names)), names)
    rates.set_ylim(len(names) - 0.5, -0.5)
    rates.set_xlim(right=103)
    ways.set_xlim(left=0)
    rates.set_xlabel("success (%)")
    ways.set_xlabel("distance travelled (m)")
    for axes in (rates, ways):
        axes.grid(axis="x")
        axes.tick_params(axis="y", length=0)


def _draw_limit(axes: "Axes", value: float, place: int) -> None:
    """Mark across a row what no policy can pass."""
    axes.plot(
        [value, value], [place - 0.46, place + 0.46], color=style.INK, linewidth=1.0,
        linestyle=":", label=LIMIT_NAME, zorder=1,
    )  # fmt: skip


def _draw_row(rates: "Axes", ways: "Axes", row: Row, looks: Mark, place: float) -> None:
    """Draw one row of a table."""
    if row["policy"] == "paper":
        bars = paper_success_bars(row)
        rates.errorbar([row["success_rate"]], [place], xerr=bars, **paper_look())
        ways.errorbar([row["distance_mean"]], [place], xerr=[row["distance_sd"]], **paper_look())
        return
    color, marker, name = looks
    look: dict[str, Any] = {
        "color": color, "marker": marker or "|", "markersize": 5.5, "capsize": 2,
        "linestyle": "none", "label": name,
    }  # fmt: skip
    rates.errorbar([row["success_rate"]], [place], xerr=success_bars([row]), **look)
    ways.errorbar([row["distance_mean"]], [place], xerr=[half_interval(row)], **look)
