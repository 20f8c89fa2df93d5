"""Results: what the paper leaves open, one thing at a time, beside its figures (Table 2)."""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from jaxlangnav.experiments.grid import Row
from jaxlangnav.experiments.rows import AGREEMENT, PAPER_RUNS, rate_error
from jaxlangnav.studies.unknowns_tables import TITLE, row_name
from jaxlangnav.viz import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEFT, _COLUMN, _LINE = 2.05, 1.4, 0.155
"""Inches: labels, a row of Table 2, a variation."""


def unknowns_figure(document: Mapping[str, Any]) -> "Figure":
    """Draw every variation beside the printed figures: success above, distance below.

    Args:
        document: of ``studies.unknowns``.

    Returns:
        The figure: a column for each row of Table 2, a line for each variation. A band spans two
        standard errors of the printed figure, a bar two of ours; filled points agree with it.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ValueError: the document has no rows.
    """
    paper, fits = document["paper"], document["variations"]
    if not document["rows"]:
        raise ValueError("the document has no rows, so there is nothing to draw")
    with style.house_style():
        from matplotlib.figure import Figure

        tall = _LINE * len(fits)
        width, height = _LEFT + _COLUMN * len(paper) + 0.1, 2 * tall + 1.95
        figure = Figure(figsize=(width, height))
        grid = figure.subplots(2, len(paper), squeeze=False, sharey=True)
        figure.subplots_adjust(
            left=_LEFT / width, right=1 - 0.1 / width, top=1 - 0.85 / height,
            bottom=0.42 / height, wspace=0.1, hspace=0.62 / tall,
        )  # fmt: skip
        for index, printed in enumerate(paper):
            mine = document["rows"][index :: len(paper)]
            _draw_panel(grid[0][index], mine, printed, "success_rate", "success")
            _draw_panel(grid[1][index], mine, printed, "distance_mean", "distance")
            grid[0][index].set_title(row_name(printed))
            grid[0][index].set_xlabel("success (%)")
            grid[1][index].set_xlabel("distance (m)")
        for line in grid:
            _label(line[0], fits)
        style.title(
            figure,
            TITLE,
            f"{document['policy']}, {document['episodes']} episodes a point, bars ± {AGREEMENT:g} "
            f"standard errors. Band: the paper's figure ± {AGREEMENT:g} standard errors of "
            f"{PAPER_RUNS} runs. Filled green: they agree.",
        )
    return figure


def _draw_panel(axes: "Axes", rows: Sequence[Row], printed: Row, key: str, name: str) -> None:
    """Draw one figure of one row of Table 2 for all variations."""
    if name == "success":
        error = rate_error(printed[key], PAPER_RUNS)
    else:
        error = printed["distance_sd"] / math.sqrt(PAPER_RUNS)
    value = printed[key]
    axes.axvspan(value - AGREEMENT * error, value + AGREEMENT * error, color="#e6ecf1", zorder=0)
    axes.axvline(value, color=style.INK, linewidth=0.9, linestyle=":", zorder=1)
    for place, row in enumerate(rows):
        is_near = row[f"is_{name}_near"]
        half = AGREEMENT * row[f"{name}_se"]
        # No rate is above 100 %.
        upper = min(half, 100.0 - row[key]) if name == "success" else half
        axes.errorbar(
            [row[key]], [place], xerr=[[half], [upper]],
            color=style.GOOD if is_near else style.MUTED, marker="o", markersize=4,
            markerfacecolor=style.GOOD if is_near else style.PAPER, linewidth=1.0, capsize=0,
        )  # fmt: skip
    axes.grid(axis="x")
    axes.tick_params(axis="y", length=0)


def _label(axes: "Axes", fits: Sequence[Mapping[str, Any]]) -> None:
    """Name the variations, each unknown once, with a line between unknowns."""
    names = [f"{one['unknown']}  {one['value']}".strip() for one in fits]
    axes.set_yticks(range(len(fits)), names)
    axes.set_ylim(len(fits) - 0.4, -0.6)
    figure = axes.get_figure()
    row = axes.get_subplotspec()
    for place, (before, after) in enumerate(itertools.pairwise(fits)):
        if before["unknown"] == after["unknown"] or figure is None or row is None:
            continue
        for other in figure.axes:
            spec = other.get_subplotspec()
            if spec is not None and spec.rowspan == row.rowspan:
                other.axhline(place + 0.5, color=style.LINE, linewidth=0.6, zorder=0)
