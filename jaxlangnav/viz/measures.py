"""Measures of quality: calibration of probabilities, and where the time goes."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxlangnav.experiments.metrics import wilson_interval
from jaxlangnav.viz import style
from jaxlangnav.viz.words import percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


Curve = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Of each bin: mean prediction, share that came true, ends of its 95 % interval, predictions."""


def calibration_figure(
    predictions: Mapping[str, tuple[np.ndarray, np.ndarray]], *, num_bins: int = 10
) -> "Figure":
    """Draw how often what was predicted with a probability came true.

    Args:
        predictions: name of a curve to predicted probabilities f[n] in [0, 1] and outcomes
            bool[n], independent of each other.
        num_bins: equal parts of [0, 1]; empty ones are left out.

    Returns:
        The figure: curves with 95 % Wilson intervals, and beneath how many predictions a bin has.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ValueError: no curve, or lengths that differ.
    """
    curves = {
        f"{name} (n = {len(predicted)})": calibration_bins(predicted, outcome, num_bins)
        for name, (predicted, outcome) in predictions.items()
    }
    return reliability_figure({"": curves}, title="Calibration")


def reliability_figure(
    panels: Mapping[str, Mapping[str, Curve]], *, title: str, subtitle: str = ""
) -> "Figure":
    """Draw reliability curves side by side.

    Args:
        panels: heading of each panel to its curves by name.
        title: the headline.
        subtitle: a line beneath it, before the word on how to read the figure.

    Returns:
        The figure: a column a panel, curves above, and beneath how many predictions a bin has.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ValueError: no curve.
    """
    if not any(panels.values()):
        raise ValueError("no predictions given, so there is nothing to draw")
    names = list(dict.fromkeys(name for curves in panels.values() for name in curves))
    with style.house_style():
        from matplotlib.figure import Figure

        wide, number = 1.0 + 4.1 * len(panels), len(panels)
        columns = 1 if number == 1 else 2
        foot = 0.58 + 0.19 * -(-len(names) // columns)
        tall = 5.6 + foot
        figure = Figure(figsize=(wide, tall))
        grid = figure.subplots(
            2, number, sharex=True, sharey="row", height_ratios=(3.4, 1), squeeze=False
        )
        figure.subplots_adjust(
            left=0.66 / wide, right=1 - 0.14 / wide, top=1 - 1.0 / tall, bottom=foot / tall,
            hspace=0.08, wspace=0.07,
        )  # fmt: skip
        for column, (heading, curves) in enumerate(panels.items()):
            above, below = grid[0][column], grid[1][column]
            _draw_reliability(above, below, curves, names)
            above.set_title(heading)
        most = max(float(curve[4].max()) for curves in panels.values() for curve in curves.values())
        grid[1][0].set_ylim(0, 2 * most)
        grid[0][0].set_ylabel("share that came true")
        grid[1][0].set_ylabel("predictions")
        handles, labels = _merged_legend(grid[0], names)
        figure.legend(handles, labels, loc="lower center", ncols=columns)
        text = "On the dotted line probabilities mean what they say; bars: 95 %."
        style.title(figure, title, f"{subtitle}\n{text}" if subtitle else text)
    return figure


def _draw_reliability(
    above: "Axes", below: "Axes", curves: Mapping[str, Curve], names: list[str]
) -> None:
    """Draw the curves of one panel and how many predictions they rest on."""
    above.plot([0, 1], [0, 1], color=style.MUTED, linestyle=":", linewidth=1)
    for name, (mean, rate, low, high, number) in curves.items():
        index = names.index(name)
        color, marker = style.SERIES[index % len(style.SERIES)], "os^vDP"[index % 6]
        # What is drawn first is larger, so that it shows behind a curve that equals it.
        size = 4 + 3 / (1 + index)
        above.errorbar(
            mean, rate, yerr=(rate - low, high - rate), color=color, marker=marker,
            markersize=size, capsize=2, linewidth=1.3, label=name,
        )  # fmt: skip
        below.plot(mean, number, color=color, marker=marker, markersize=size - 1, linewidth=1.0)
    above.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
    below.set_yscale("symlog", linthresh=1)
    below.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    below.set_xlabel("predicted probability")
    for axes in (above, below):
        axes.grid()


def _merged_legend(row: "Sequence[Axes]", names: list[str]) -> tuple[list[Any], list[str]]:
    """Gather the legend of several panels, each name once."""
    found: dict[str, Any] = {}
    for axes in row:
        found |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    return [found[name] for name in names], names


def calibration_bins(
    predicted: np.ndarray, outcome: np.ndarray, num_bins: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Sort predictions into bins.

    Args:
        predicted: f[n] probabilities in [0, 1].
        outcome: bool[n].
        num_bins: equal parts of [0, 1], at least 1.

    Returns:
        Of each bin that is not empty: mean prediction, rate of success, lower and upper end of its
        95 % Wilson interval, number of predictions.

    Raises:
        ValueError: lengths differ, a probability is outside [0, 1], or there are no bins.
    """
    predicted, outcome = np.asarray(predicted, float), np.asarray(outcome, bool)
    if predicted.shape != outcome.shape or num_bins < 1:
        raise ValueError(
            f"{predicted.size} predictions, {outcome.size} outcomes and {num_bins} bins do not fit"
        )
    if predicted.size and not (predicted.min() >= 0.0 and predicted.max() <= 1.0):
        raise ValueError("a predicted probability lies outside [0, 1]")
    place = np.minimum((predicted * num_bins).astype(int), num_bins - 1)
    number = np.bincount(place, minlength=num_bins)
    used = number > 0
    total = np.maximum(number, 1)
    mean = np.bincount(place, weights=predicted, minlength=num_bins) / total
    hits = np.bincount(place, weights=outcome, minlength=num_bins)
    ends = np.array([wilson_interval(int(h), int(n)) for h, n in zip(hits, number, strict=True)])
    return mean[used], (hits / total)[used], ends[used, 0], ends[used, 1], number[used]


def time_figure(parts: Mapping[str, float], *, what: str = "one decision cycle") -> "Figure":
    """Draw where the time goes.

    Args:
        parts: microseconds by part.
        what: the parts are parts of this.

    Returns:
        The figure: a bar for each part, the longest first, with its share.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ValueError: no parts, or no time at all.
    """
    total = sum(parts.values())
    if not parts or total <= 0.0:
        raise ValueError("no time was measured, so there is nothing to draw")
    ranked = sorted(parts.items(), key=lambda one: -one[1])
    with style.house_style():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.6, 1.35 + 0.3 * len(ranked)))
        tall = figure.get_figheight()
        axes = figure.subplots()
        figure.subplots_adjust(left=0.3, right=0.9, top=1 - 0.62 / tall, bottom=0.5 / tall)
        values = [value for _, value in ranked]
        axes.barh(range(len(ranked)), values, height=0.7, color=style.SERIES[0])
        for place, value in enumerate(values):
            axes.annotate(
                f"{value:.3g} µs · {percent(value / total)}", (value, place), xytext=(4, 0),
                textcoords="offset points", va="center", fontsize=7.5, color=style.MUTED,
                annotation_clip=False,
            )  # fmt: skip
        axes.set_yticks(range(len(ranked)), [name for name, _ in ranked])
        axes.set_ylim(len(ranked) - 0.5, -0.5)
        axes.set_xlim(0, 1.12 * max(values))
        axes.set_xlabel("time (µs)")
        axes.tick_params(axis="y", length=0)
        style.title(figure, "Where the time goes", f"{what}: {total:.4g} µs")
    return figure
