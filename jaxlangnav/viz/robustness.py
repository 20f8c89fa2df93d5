"""Results: every scenario of the robustness suite at a look, with the targets that it has."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from jaxlangnav.experiments.grid import Row
from jaxlangnav.experiments.robustness import ECE_TARGET, ROBUSTNESS
from jaxlangnav.viz import style
from jaxlangnav.viz.sweep import half_interval, legend_of, looks_of, success_bars

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDE, _LINE, _HEAD, _FOOT = 11.0, 0.27, 0.95, 0.95
"""Inches: the figure, a scenario, what is above and below them."""
_WITH_BELIEF = 0.4
"""Largest ECE that the panel shows; beyond it a point stands at its border."""


def robustness_figure(document: Mapping[str, Any]) -> "Figure":
    """Draw success, distance and calibration of every scenario.

    Args:
        document: of ``experiments.robustness``.

    Returns:
        The figure: a line for each scenario. Its name is green where ``informed`` meets all of its
        targets, red where it misses one, and black where it has none.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ValueError: the document has no rows.
    """
    rows: Sequence[Row] = document["rows"]
    if not rows:
        raise ValueError("the document has no rows, so there is nothing to draw")
    names = list(dict.fromkeys(row["scenario"] for row in rows))
    arms = list(dict.fromkeys(row["policy"] for row in rows))
    looks = looks_of(arms)
    with style.house_style():
        from matplotlib.figure import Figure

        tall = _HEAD + _FOOT + _LINE * len(names)
        figure = Figure(figsize=(_WIDE, tall))
        panels = figure.subplots(1, 3, sharey=True, width_ratios=(5, 4, 3))
        figure.subplots_adjust(
            left=0.185, right=0.985, top=1 - _HEAD / tall, bottom=_FOOT / tall, wspace=0.05
        )
        for place in range(0, len(names), 2):
            for axes in panels:
                axes.axhspan(place - 0.5, place + 0.5, color="#f4f5f7", zorder=0)
        for row in rows:
            shift = 0.66 * ((arms.index(row["policy"]) + 0.5) / len(arms) - 0.5)
            place = names.index(row["scenario"])
            _draw_scenario(panels, row, looks[row["policy"]], place, shift)
        _label_panels(panels, names, rows)
        style.title(
            figure,
            ROBUSTNESS.title,
            f"{document['episodes']} episodes a row; bars: 95 % interval of the mean. Vertical "
            "strokes: targets of informed.\nNames: green, all targets met; red, one is missed; "
            "black, none is set. Empty points of ECE: the belief was not told the truth.",
        )
        handles, labels = legend_of([[panels[0]]])
        figure.legend(handles, labels, loc="lower center", ncols=3)
    return figure


def _draw_scenario(
    panels: "Sequence[Axes]", row: Row, looks: tuple[str, str, str], place: int, shift: float
) -> None:
    """Draw one row into the three panels."""
    rates, ways, scores = panels
    color, marker, name = looks
    look: dict[str, Any] = {
        "color": color, "marker": marker or "|", "markersize": 4.5, "linestyle": "none",
        "linewidth": 1.0, "label": name,
    }  # fmt: skip
    at = [place + shift]
    rates.errorbar([row["success_rate"]], at, xerr=success_bars([row]), **look)
    ways.errorbar([row["distance_mean"]], at, xerr=[half_interval(row)], **look)
    if row["ece"] is not None:
        fill: dict[str, Any] = {} if row["is_told"] else {"markerfacecolor": style.PAPER}
        scores.plot([min(row["ece"], _WITH_BELIEF)], at, **(look | fill))
    mark: dict[str, Any] = {"color": style.INK, "linewidth": 1.4, "zorder": 4}
    if row["target"] is not None:
        rates.plot([row["target"]] * 2, [place - 0.42, place + 0.42], **mark)
    if row.get("longest"):
        ways.plot([row["longest"]] * 2, [place - 0.42, place + 0.42], **mark)


def _label_panels(panels: "Sequence[Axes]", names: Sequence[str], rows: Sequence[Row]) -> None:
    """Name axes and scenarios, and colour the names by their targets."""
    rates, ways, scores = panels
    rates.set_yticks(range(len(names)), names)
    rates.set_ylim(len(names) - 0.5, -0.5)
    for place, text in enumerate(rates.get_yticklabels()):
        judged = [
            one.get(key)
            for one in rows
            if one["scenario"] == names[place]
            for key in ("is_met", "is_calibrated")
        ]
        set_ones = [one for one in judged if one is not None]
        met = style.GOOD if all(set_ones) else style.BAD
        text.set_color(met if set_ones else style.INK)
    rates.set_xlim(0, 103)
    ways.set_xlim(left=0)
    scores.set_xlim(0, 1.02 * _WITH_BELIEF)
    scores.axvline(ECE_TARGET, color=style.INK, linewidth=1.0, linestyle=":", zorder=1)
    for axes, label in zip(panels, ("success (%)", "distance travelled (m)", "ECE"), strict=True):
        axes.set_xlabel(label)
        axes.grid(axis="x")
        axes.tick_params(axis="y", length=0)
