"""Figures of success and distance: the range sweep (Figure 5), robustness, unknown parameters.

All raise ``MissingExtraError`` without matplotlib, and ``ValueError`` for a document without rows.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxlangnav.experiments.metrics import wilson_interval
from jaxlangnav.experiments.robustness import ECE_TARGET, ROBUSTNESS
from jaxlangnav.experiments.rows import MAX_Z, PAPER_RUNS, distance_error, rate_error
from jaxlangnav.experiments.table import Row
from jaxlangnav.experiments.unknowns import UNKNOWNS, row_name
from jaxlangnav.viz import style
from jaxlangnav.viz.style import POLICY_STYLES, SeriesStyle, policy_styles

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPER_NAME = "paper, as printed"
PAPER_BARS = f"paper: ± 1 σ of the distance, 95 % of a rate of {PAPER_RUNS} runs"
_PAPER_STYLE: dict[str, Any] = {
    "color": style.INK, "marker": "D", "markersize": 6, "markerfacecolor": "none",
    "linestyle": "none", "capsize": 3, "linewidth": 1.0, "zorder": 5, "label": PAPER_NAME,
}  # fmt: skip
"""Style of the paper's printed points: a hollow diamond."""
_Z95 = 1.96
_JITTER = 1.025  # range factor that separates the error bars of two policies
_FIGURE_WIDTH, _LINE, _HEAD, _FOOT = 11.0, 0.27, 0.95, 0.95
"""Inches: figure width, height of a scenario, top and bottom margins."""
_MAX_ECE = 0.4  # axis limit of the ECE panel; larger values are clipped to it
_LABEL_MARGIN, _COLUMN, _STRIP = 2.05, 1.4, 0.155  # inches: label margin, panel, variation


def rows_of(document: Mapping[str, Any]) -> Sequence[Row]:
    """Return the rows of a document; ``ValueError`` if there are none."""
    if not document["rows"]:
        raise ValueError("the document has no rows, so there is nothing to draw")
    return document["rows"]


def range_figure(document: Mapping[str, Any]) -> "Figure":
    """Plot distance (top) and success against the sensing range, as Figure 5 of the paper.

    ``document``: of ``paper.figure_5``: ``rows`` by world, relation, policy and range, and
    ``paper``, the printed rows that match. Our error bars are 95 % intervals of the mean; the paper
    prints one standard deviation.
    """
    rows = rows_of(document)
    columns = list(dict.fromkeys((row["world"], row["relation"]) for row in rows))
    with style.house_style():
        size, margins = (max(0.9 + 3.7 * len(columns), 6.2), 6.4), (0.62, 0.16, 0.99, 1.18)
        kwargs: dict[str, Any] = {"sharex": "col", "sharey": "row", "hspace": 0.12, "wspace": 0.08}
        figure, grid = style.panels(size, 2, len(columns), margins, **kwargs)
        for (world, relation), above, below in zip(columns, grid[0], grid[1], strict=True):
            ours, paper = (
                [row for row in group if (row["world"], row["relation"]) == (world, relation)]
                for group in (rows, document.get("paper", ()))
            )
            _draw_column(above, below, ours, paper)
            sentence = document.get("sentences", {}).get(relation or "null")
            above.set_title(f"{world}, “{sentence or relation or 'no relation'}”")
            below.set_xlabel("sensing range (m, logarithmic)")
        grid[0][0].set_ylabel("distance travelled (m)")
        grid[0][0].set_ylim(bottom=0)
        grid[1][0].set(ylabel="success (%)", ylim=(0, 104))
        episodes = document.get("episodes", "?")
        style.title(
            figure,
            "Distance and success against the sensing range",
            f"{episodes} episodes a point; bars: 95 % interval of the mean; {PAPER_BARS}.",
        )
        style.add_legend(figure, grid.flat)
    return figure


def _draw_column(above: "Axes", below: "Axes", rows: list[Row], paper: list[Row]) -> None:
    """Plot all policies of one world and relation, and the paper's points."""
    policies = list(dict.fromkeys(row["policy"] for row in rows))
    for index, policy in enumerate(policies):
        points = [row for row in rows if row["policy"] == policy]
        points.sort(key=lambda row: row["range"])
        distance, rate = ([row[key] for row in points] for key in ("distance_mean", "success_rate"))
        # A small offset separates the error bars.
        offset = _JITTER ** (index - (len(policies) - 1) / 2)
        color, marker, name = POLICY_STYLES.get(policy, (style.INK, "D", policy))
        ranges = [row["range"] * (1.0 if policy == "known" else offset) for row in points]
        kwargs: dict[str, Any] = {"color": color, "label": name}
        if policy == "known":
            kwargs |= {"linestyle": "--", "linewidth": 1.2}
            above.plot(ranges, distance, **kwargs)
            below.plot(ranges, rate, **kwargs)
            continue
        kwargs |= {"marker": marker, "markersize": 5, "capsize": 2}
        above.errorbar(ranges, distance, yerr=[half_interval(row) for row in points], **kwargs)
        below.errorbar(ranges, rate, yerr=np.hstack([*map(_success_bars, points)]), **kwargs)
    for row in paper:
        x, error = [row["range"]], _success_bars(row)
        above.errorbar(x, [row["distance_mean"]], yerr=[half_interval(row)], **_PAPER_STYLE)
        below.errorbar(x, [row["success_rate"]], yerr=error, **_PAPER_STYLE)
    for axes in (above, below):
        axes.grid()
        axes.set_xscale("log")
        axes.set_xticks(sorted({row["range"] for row in rows}))
        axes.set_xticks([], minor=True)
    below.xaxis.set_major_formatter(lambda value, _: f"{value:g}")


def half_interval(row: Row) -> float:
    """Compute the 95 % half-width of a row's mean distance, metres; σ for a row of the paper."""
    return row["distance_sd"] if row["policy"] == "paper" else _Z95 * distance_error(row)


def _success_bars(row: Row) -> np.ndarray:
    """Compute the 95 % error bars of a success rate, f64[2, 1], percent (Wilson)."""
    rate = float(row["success_rate"])
    if row["policy"] == "paper":
        ends = np.multiply(100, wilson_interval(round(rate * PAPER_RUNS / 100), PAPER_RUNS))
    else:
        ends = row["success_ci"]
    return np.maximum([[rate - ends[0]], [ends[1] - rate]], 0.0)


def row_panels(
    names: Sequence[str],
    labels: Sequence[str],
    *,
    size: tuple[float, float],
    margins: tuple[float, float, float],
    widths: Sequence[float],
) -> "tuple[Figure, list[Axes]]":
    """Create side-by-side panels that share the rows of the y axis, with zebra striping.

    ``margins``: at the left, above and below, inches. The first panel shows success in percent.
    """
    left, head, foot = margins
    kwargs: dict[str, Any] = {"sharey": True, "width_ratios": widths, "wspace": 0.055}
    figure, grid = style.panels(size, 1, len(labels), (left, 0.017 * size[0], head, foot), **kwargs)
    panels = list(grid[0])
    for axes, label in zip(panels, labels, strict=True):
        for row in range(0, len(names), 2):
            axes.axhspan(row - 0.5, row + 0.5, color="#f4f5f7", zorder=0)
        axes.set_xlabel(label)
        axes.grid(axis="x")
        axes.tick_params(axis="y", length=0)
    panels[0].set_yticks(range(len(names)), names)
    panels[0].set_ylim(len(names) - 0.5, -0.5)
    panels[0].set_xlim(right=103)
    return figure, panels


def draw_row(
    panels: "Sequence[Axes]", row: Row, series: SeriesStyle, y: float, **kwargs: Any
) -> dict[str, Any]:
    """Plot success and distance of a row with 95 % intervals at height y; returns the style."""
    color, marker, name = series
    kwargs |= {"color": color, "marker": marker or "|", "linestyle": "none", "label": name}
    kwargs = _PAPER_STYLE if row["policy"] == "paper" else kwargs
    panels[0].errorbar([row["success_rate"]], [y], xerr=_success_bars(row), **kwargs)
    panels[1].errorbar([row["distance_mean"]], [y], xerr=[half_interval(row)], **kwargs)
    return kwargs


def robustness_figure(document: Mapping[str, Any]) -> "Figure":
    """Plot success, distance and calibration of the scenarios of a ``robustness`` document.

    A scenario's name is green where ``informed`` meets all of its targets, red where it misses one,
    and black where it has none.
    """
    rows = rows_of(document)
    names = list(dict.fromkeys(row["scenario"] for row in rows))
    policies = list(dict.fromkeys(row["policy"] for row in rows))
    styles = policy_styles(policies)
    with style.house_style():
        figure, panels = row_panels(
            names,
            ("success (%)", "distance travelled (m)", "ECE"),
            size=(_FIGURE_WIDTH, _HEAD + _FOOT + _LINE * len(names)),
            margins=(0.185 * _FIGURE_WIDTH, _HEAD, _FOOT),
            widths=(5, 4, 3),
        )
        mark: dict[str, Any] = {"color": style.INK, "linewidth": 1.4, "zorder": 4}
        for row in rows:
            row_index = names.index(row["scenario"])
            y = row_index + 0.66 * ((policies.index(row["policy"]) + 0.5) / len(policies) - 0.5)
            kwargs = draw_row(panels, row, styles[row["policy"]], y, markersize=4.5, linewidth=1.0)
            if row["ece"] is not None:
                kwargs |= {} if row["is_told"] else {"markerfacecolor": style.PAPER}
                panels[2].plot([min(row["ece"], _MAX_ECE)], [y], **kwargs)
            for axes, target in zip(panels, (row["target"], row.get("longest")), strict=False):
                if target is not None:
                    axes.plot([target] * 2, [row_index - 0.42, row_index + 0.42], **mark)
        for name, text in zip(names, panels[0].get_yticklabels(), strict=True):
            scenario_rows = [row for row in rows if row["scenario"] == name]
            checks = [row.get(key) for row in scenario_rows for key in ("is_met", "is_calibrated")]
            targets = [check for check in checks if check is not None]
            color = style.GOOD if all(targets) else style.BAD
            text.set_color(color if targets else style.INK)
        panels[0].set_xlim(left=0)
        panels[1].set_xlim(left=0)
        panels[2].set_xlim(0, 1.02 * _MAX_ECE)
        panels[2].axvline(ECE_TARGET, color=style.INK, linewidth=1.0, linestyle=":", zorder=1)
        style.title(
            figure,
            ROBUSTNESS.title,
            f"{document['episodes']} episodes a row; bars: 95 % interval of the mean. Vertical "
            "strokes: targets of informed.\nNames: green, all targets met; red, one is missed; "
            "black, none is set. Empty points of ECE: the belief was not told the truth.",
        )
        style.add_legend(figure, panels[:1])
    return figure


def unknowns_figure(document: Mapping[str, Any]) -> "Figure":
    """Plot every variation of an ``unknowns`` document beside the printed results.

    A column for each row of Table 2, success above, distance below; a line for each variation. A
    band spans two standard errors of the printed figure, a bar two of ours; filled points agree
    with it.
    """
    paper, variations, all_rows = document["paper"], document["variations"], rows_of(document)
    with style.house_style():
        height = _STRIP * len(variations)
        size = _LABEL_MARGIN + _COLUMN * len(paper) + 0.1, 2 * height + 1.95
        kwargs: dict[str, Any] = {"sharey": True, "wspace": 0.1, "hspace": 0.62 / height}
        figure, grid = style.panels(size, 2, len(paper), (_LABEL_MARGIN, 0.1, 0.85, 0.42), **kwargs)
        for index, printed in enumerate(paper):
            rows = all_rows[index :: len(paper)]
            above, below = grid[:, index]
            _draw_panel(above, rows, printed, "success_rate")
            _draw_panel(below, rows, printed, "distance_mean")
            above.set(title=row_name(printed), xlabel="success (%)")
            below.set_xlabel("distance (m)")
        names = [f"{row['unknown']}  {row['value']}".strip() for row in variations]
        grid[0][0].set_yticks(range(len(variations)), names)
        grid[0][0].set_ylim(len(variations) - 0.4, -0.6)
        for i, (before, after) in enumerate(itertools.pairwise(variations)):
            if before["unknown"] != after["unknown"]:
                for axes in grid.flat:
                    axes.axhline(i + 0.5, color=style.LINE, linewidth=0.6, zorder=0)
        style.title(
            figure,
            UNKNOWNS.title,
            f"{document['policy']}, {document['episodes']} episodes a point, bars ± {MAX_Z:g} "
            f"standard errors. Band: the paper's figure ± {MAX_Z:g} standard errors of "
            f"{PAPER_RUNS} runs. Filled green: they agree.",
        )
    return figure


def _draw_panel(axes: "Axes", rows: Sequence[Row], printed: Row, key: str) -> None:
    """Plot one metric of one row of Table 2 for all variations."""
    name = key.partition("_")[0]
    value, error = printed[key], printed["distance_sd"] / math.sqrt(PAPER_RUNS)
    if name == "success":
        error = rate_error(value, PAPER_RUNS)
    axes.axvspan(value - MAX_Z * error, value + MAX_Z * error, color="#e6ecf1", zorder=0)
    axes.axvline(value, color=style.INK, linewidth=0.9, linestyle=":", zorder=1)
    for y, row in enumerate(rows):
        agrees = row[f"is_{name}_near"]
        bar = MAX_Z * row[f"{name}_se"]
        # No rate is above 100 %.
        upper = min(bar, 100.0 - row[key]) if name == "success" else bar
        axes.errorbar(
            [row[key]], [y], xerr=[[bar], [upper]],
            color=style.GOOD if agrees else style.MUTED, marker="o", markersize=4,
            markerfacecolor=style.GOOD if agrees else style.PAPER, linewidth=1.0, capsize=0,
        )  # fmt: skip
    axes.grid(axis="x")
    axes.tick_params(axis="y", length=0)
