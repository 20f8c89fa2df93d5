"""Results: distance and success against the sensing range (Figure 5)."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxlangnav.experiments.grid import Row
from jaxlangnav.experiments.metrics import wilson_interval
from jaxlangnav.experiments.rows import PAPER_RUNS
from jaxlangnav.viz import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Mark = tuple[str, str, str]
POLICY_LOOKS = {
    "informed": (style.SERIES[0], "o", "informed (ours)"),
    "faithful": (style.SERIES[1], "s", "faithful (the paper's method)"),
    "frontier": (style.SERIES[2], "^", "nearest frontier, no language"),
    "lawnmower": (style.SERIES[3], "v", "lawnmower, no language"),
    "arc": (style.SERIES[4], "<", "sweep that knows the worlds' law"),
    "known": (style.MUTED, "", "known map"),
}
"""Colour, marker and name of each policy."""
PAPER_NAME = "paper, as printed"
PAPER_BARS = f"paper: ± 1 σ of the distance, 95 % of a rate of {PAPER_RUNS} runs"
_Z95 = 1.96
_APART = 1.025
"""Factor on the range between the points of two policies."""


def range_figure(document: Mapping[str, Any]) -> "Figure":
    """Draw distance and success against the sensing range, as Figure 5 of the paper.

    Args:
        document: of ``experiments.figure5``: ``rows`` by world, relation, policy and range, and
            ``paper``, the printed rows that match. Rates in percent, distances in metres.

    Returns:
        The figure: a column for each world and relation, distance above, success below. Our error
        bars are 95 % intervals of the mean; the paper prints one standard deviation.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ValueError: the document has no rows.
    """
    rows: Sequence[Row] = document["rows"]
    columns = list(dict.fromkeys((row["world"], row["relation"]) for row in rows))
    if not columns:
        raise ValueError("the document has no rows, so there is nothing to draw")
    with style.house_style():
        from matplotlib.figure import Figure

        width, height = 0.9 + 3.7 * len(columns), 6.4
        figure = Figure(figsize=(max(width, 6.2), height))
        grid = figure.subplots(2, len(columns), squeeze=False, sharex="col", sharey="row")
        figure.subplots_adjust(
            left=0.62 / figure.get_figwidth(), right=0.98, top=0.845, bottom=0.185,
            hspace=0.12, wspace=0.08,
        )  # fmt: skip
        for (world, relation), above, below in zip(columns, grid[0], grid[1], strict=True):
            mine = [row for row in rows if (row["world"], row["relation"]) == (world, relation)]
            paper = [
                row
                for row in document.get("paper", ())
                if (row["world"], row["relation"]) == (world, relation)
            ]
            _draw_column(above, below, mine, paper)
            above.set_title(f"{world}, {sentence_of(document, relation)}")
            below.set_xlabel("sensing range (m, logarithmic)")
        grid[0][0].set_ylabel("distance travelled (m)")
        grid[1][0].set_ylabel("success (%)")
        grid[0][0].set_ylim(bottom=0)
        grid[1][0].set_ylim(0, 104)
        number = document.get("episodes", "?")
        style.title(
            figure,
            "Distance and success against the sensing range",
            f"{number} episodes a point; bars: 95 % interval of the mean; {PAPER_BARS}.",
        )
        handles, labels = legend_of(grid)
        figure.legend(handles, labels, loc="lower center", ncols=min(len(labels), 3))
    return figure


def looks_of(arms: Sequence[str]) -> dict[str, Mark]:
    """Give each arm its colour, marker and name.

    Args:
        arms: policies, or names of somebody's own.

    Returns:
        Looks by arm; policies have their own, others take the colours of a chart in turn.
    """
    markers = "os^vDPXh"
    return {
        arm: POLICY_LOOKS.get(
            arm, (style.SERIES[index % len(style.SERIES)], markers[index % len(markers)], arm)
        )
        for index, arm in enumerate(arms)
    }


def sentence_of(document: Mapping[str, Any], relation: str | None) -> str:
    """Look up the sentence behind a relation, in quotation marks."""
    said = document.get("sentences", {}).get(relation or "null")
    return f"“{said}”" if said else f"“{relation or 'no relation'}”"


def _draw_column(above: "Axes", below: "Axes", rows: list[Row], paper: list[Row]) -> None:
    """Draw all policies of one world and relation, and the paper's points."""
    policies = list(dict.fromkeys(row["policy"] for row in rows))
    for index, policy in enumerate(policies):
        mine = sorted(
            (row for row in rows if row["policy"] == policy), key=lambda row: row["range"]
        )
        # A little apart, so that error bars can be told from each other.
        apart = _APART ** (index - (len(policies) - 1) / 2)
        color, marker, name = POLICY_LOOKS.get(policy, (style.INK, "D", policy))
        reach = [row["range"] * (1.0 if policy == "known" else apart) for row in mine]
        way = [row["distance_mean"] for row in mine]
        look: dict[str, Any] = {"color": color, "marker": marker, "markersize": 5, "capsize": 2}
        if policy == "known":
            above.plot(reach, way, color=color, linestyle="--", linewidth=1.2, label=name)
            below.plot(
                reach, [row["success_rate"] for row in mine],
                color=color, linestyle="--", linewidth=1.2, label=name,
            )  # fmt: skip
            continue
        above.errorbar(reach, way, yerr=[half_interval(row) for row in mine], label=name, **look)
        below.errorbar(
            reach,
            [row["success_rate"] for row in mine],
            yerr=success_bars(mine),
            label=name,
            **look,
        )
    for row in paper:
        point: dict[str, Any] = paper_look()
        above.errorbar([row["range"]], [row["distance_mean"]], yerr=[row["distance_sd"]], **point)
        bars = paper_success_bars(row)
        below.errorbar([row["range"]], [row["success_rate"]], yerr=bars, **point)
    for axes in (above, below):
        axes.grid()
        axes.set_xscale("log")
        axes.set_xticks(sorted({row["range"] for row in rows}))
        axes.set_xticks([], minor=True)
    below.xaxis.set_major_formatter(lambda value, _: f"{value:g}")


def half_interval(row: Row) -> float:
    """Compute half of the 95 % interval of a row's mean distance, metres."""
    return _Z95 * float(row["distance_sd"]) / math.sqrt(max(1, int(row["episodes"])))


def success_bars(rows: list[Row]) -> np.ndarray:
    """Compute error bars of success rates from their intervals, f64[2, n], percent."""
    rate = np.array([row["success_rate"] for row in rows], float)
    ends = np.array([row["success_ci"] for row in rows], float).T
    return np.maximum(np.stack([rate - ends[0], ends[1] - rate]), 0.0)


def paper_success_bars(row: Row) -> np.ndarray:
    """Compute the 95 % interval of a printed success rate, f64[2, 1], percent."""
    rate = float(row["success_rate"])
    low, high = wilson_interval(round(rate * PAPER_RUNS / 100), PAPER_RUNS)
    return np.maximum([[rate - 100 * low], [100 * high - rate]], 0.0)


def paper_look() -> dict[str, Any]:
    """Build the look of a printed point: an empty diamond."""
    return {
        "color": style.INK, "marker": "D", "markersize": 6, "markerfacecolor": "none",
        "linestyle": "none", "capsize": 3, "linewidth": 1.0, "zorder": 5, "label": PAPER_NAME,
    }  # fmt: skip


def legend_of(grid: Any) -> tuple[list[Any], list[str]]:
    """Gather the legend over several axes, each label once."""
    found: dict[str, Any] = {}
    for line in grid:
        for axes in line:
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                found.setdefault(label, handle)
    return list(found.values()), list(found)
