"""Figures of result tables: Table 2, sweep summaries, reliability diagrams, timings.

All raise ``MissingExtraError`` without matplotlib, and ``ValueError`` for an empty document.
"""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxlangnav.experiments.paper import min_distance
from jaxlangnav.experiments.table import Row
from jaxlangnav.viz import style
from jaxlangnav.viz.sentences import percent
from jaxlangnav.viz.style import policy_styles
from jaxlangnav.viz.sweep import PAPER_BARS, draw_row, row_panels, rows_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LIMIT_NAME = "limit, map unknown"
MAX_LINES = 48  # settings of a sweep that one figure can show
Curve = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Per bin: mean prediction, observed frequency, ends of its 95 % interval, predictions."""


def table_figure(document: Mapping[str, Any]) -> "Figure":
    """Draw success and distance of ``paper.table_2`` beside the paper's printed values."""
    return _rows_figure(
        [(_row_name(row), row["policy"], row) for row in [*rows_of(document), *document["paper"]]],
        title="Table 2: ours beside the paper's",
        subtitle=f"{document['episodes']} episodes a row; bars: 95 % interval of the mean; "
        f"{PAPER_BARS}.",
        bounds={_row_name(bound): bound for bound in document["bounds"]},
    )


def summary_figure(document: Mapping[str, Any]) -> "Figure":
    """Draw the summary of a sweep (``summarize_directory``), at most ``MAX_LINES`` settings."""
    lines = summary_lines(document)
    count = len({setting for setting, _, _ in lines})
    if count > MAX_LINES:
        raise ValueError(
            f"the sweep has {count} settings, but a figure can show {MAX_LINES}: sweep fewer at "
            "once, or draw what you need from the Parquet files"
        )
    return _rows_figure(
        lines,
        title=str(document["name"]),
        subtitle=f"{document['episodes']} episodes in all; bars: 95 % interval of the mean.",
        bounds={},
    )


def _rows_figure(
    lines: Sequence[tuple[str, str, Row]], *, title: str, subtitle: str, bounds: Mapping[str, Row]
) -> "Figure":
    """Draw rows (name, series, results) as points with error bars, and bounds as dotted lines."""
    names = list(dict.fromkeys([*(name for name, _, _ in lines), *bounds]))
    series = list(dict.fromkeys(label for _, label, _ in lines))
    styles = policy_styles(series)
    with style.house_style():
        foot = 0.66 + 0.17 * math.ceil((len(series) + bool(bounds)) / 3)
        figure, (rates, distances) = row_panels(
            names,
            ("success (%)", "distance travelled (m)"),
            size=(9.2, 0.92 + foot + (0.3 + 0.055 * len(series)) * len(names)),
            margins=(min(0.4 * 9.2, 0.3 + 0.06 * max(map(len, names))), 0.72, foot),
            widths=(1, 1),
        )
        for name, label, row in lines:
            y = names.index(name) + 0.72 * ((series.index(label) + 0.5) / len(series) - 0.5)
            draw_row((rates, distances), row, styles[label], y, markersize=5.5, capsize=2)
        for name, bound in bounds.items():
            span = [names.index(name) - 0.46, names.index(name) + 0.46]
            line_style = {"color": style.INK, "linewidth": 1.0, "linestyle": ":", "zorder": 1}
            for axes, value in ((rates, bound["success"]), (distances, min_distance(bound))):
                axes.plot([value, value], span, label=LIMIT_NAME, **line_style)
        distances.set_xlim(left=0)
        style.title(figure, title, subtitle)
        style.add_legend(figure, [rates])
    return figure


def summary_lines(document: Mapping[str, Any]) -> list[tuple[str, str, Row]]:
    """Name the setting and series of each row of a sweep's summary by the varied parameters."""
    varied = document["varied"]
    # Baselines have no particles; that alone does not distinguish two series.
    sizes = {row["particles"] for row in document["rows"] if row.get("particles") is not None}
    lines = []
    for row in rows_of(document):
        setting, series = [_row_name(row)], [row["policy"]]
        for name in varied:
            if isinstance(row[name], float) and name != "range":
                labels = series if name.startswith(("map.", "planner.")) else setting
                labels.append(f"{name.rpartition('.')[2].replace('_', ' ')} {row[name]:g}")
        if len(sizes) > 1 and row["particles"] is not None:
            series.append(f"{row['particles']} particles")
        lines.append((", ".join(setting), ", ".join(series), row))
    return lines


def _row_name(row: Row) -> str:
    """Format the name of a table row: "2H1C, 3 m, behind"."""
    relation = row["relation"] if row["relation"] not in (None, "null") else "no relation"
    return f"{row['world']}, {row['range']:g} m, {relation}"


def reliability_figure(
    panels: Mapping[str, Mapping[str, Curve]], *, title: str, subtitle: str = ""
) -> "Figure":
    """Draw reliability diagrams side by side, with the number of predictions of each bin below.

    ``panels``: heading of each panel to its curves by name; ``subtitle``: a line before the hint on
    how to read the figure.
    """
    if not any(panels.values()):
        raise ValueError("no predictions given, so there is nothing to draw")
    names = list(dict.fromkeys(name for curves in panels.values() for name in curves))
    with style.house_style():
        columns = 1 if len(panels) == 1 else 2
        foot = 0.58 + 0.19 * -(-len(names) // columns)
        size, margins = (1.0 + 4.1 * len(panels), 5.6 + foot), (0.66, 0.14, 1.0, foot)
        options: dict[str, Any] = {"sharex": True, "sharey": "row", "height_ratios": (3.4, 1)}
        options |= {"hspace": 0.08, "wspace": 0.07}
        figure, grid = style.panels(size, 2, len(panels), margins, **options)
        for above, below, (heading, curves) in zip(*grid, panels.items(), strict=True):
            _draw_reliability(above, below, curves, names)
            above.set_title(heading)
        peak = max(float(curve[4].max()) for curves in panels.values() for curve in curves.values())
        grid[1][0].set_ylim(0, 2 * peak)
        grid[0][0].set_ylabel("share that came true")
        grid[1][0].set_ylabel("predictions")
        style.add_legend(figure, grid[0], columns=columns)
        text = "On the dotted line probabilities mean what they say; bars: 95 %."
        style.title(figure, title, f"{subtitle}\n{text}" if subtitle else text)
    return figure


def _draw_reliability(
    above: "Axes", below: "Axes", curves: Mapping[str, Curve], names: list[str]
) -> None:
    """Draw the reliability curves of one panel and the counts of predictions below."""
    above.plot([0, 1], [0, 1], color=style.MUTED, linestyle=":", linewidth=1)
    for name, (mean, rate, low, high, counts) in curves.items():
        index = names.index(name)
        color, marker = style.SERIES[index % len(style.SERIES)], "os^vDP"[index % 6]
        # Earlier markers are larger, so that they show behind an equal curve.
        size = 4 + 3 / (1 + index)
        above.errorbar(
            mean, rate, yerr=(rate - low, high - rate), color=color, marker=marker,
            markersize=size, capsize=2, linewidth=1.3, label=name,
        )  # fmt: skip
        below.plot(mean, counts, color=color, marker=marker, markersize=size - 1, linewidth=1.0)
    above.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
    below.set_yscale("symlog", linthresh=1)
    below.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    below.set_xlabel("predicted probability")
    for axes in (above, below):
        axes.grid()


def time_figure(parts: Mapping[str, float]) -> "Figure":
    """Draw the run time of each part of a decision cycle as bars, microseconds, longest first."""
    total = sum(parts.values())
    if not parts or total <= 0.0:
        raise ValueError("no time was measured, so there is nothing to draw")
    ranked = sorted(parts.items(), key=lambda part: -part[1])
    with style.house_style():
        size = 6.6, 1.35 + 0.3 * len(ranked)
        figure, ((axes,),) = style.panels(size, 1, 1, (1.98, 0.66, 0.62, 0.5))
        values = [value for _, value in ranked]
        axes.barh(range(len(ranked)), values, height=0.7, color=style.SERIES[0])
        for row, value in enumerate(values):
            axes.annotate(
                f"{value:.3g} µs · {percent(value / total)}", (value, row), xytext=(4, 0),
                textcoords="offset points", va="center", fontsize=7.5, color=style.MUTED,
                annotation_clip=False,
            )  # fmt: skip
        axes.set_yticks(range(len(ranked)), [name for name, _ in ranked])
        axes.set_ylim(len(ranked) - 0.5, -0.5)
        axes.set_xlim(0, 1.12 * max(values))
        axes.set_xlabel("time (µs)")
        axes.tick_params(axis="y", length=0)
        style.title(figure, "Where the time goes", f"one decision cycle: {total:.4g} µs")
    return figure
