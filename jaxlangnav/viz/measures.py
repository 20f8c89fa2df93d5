"""Measures of quality: calibration of probabilities, and where the time goes."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from jaxlangnav.experiments.metrics import wilson_interval
from jaxlangnav.viz import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def calibration_figure(
    predictions: Mapping[str, tuple[np.ndarray, np.ndarray]], *, num_bins: int = 10
) -> "Figure":
    """Draw how often what was predicted with a probability came true.

    Args:
        predictions: name of a curve to predicted probabilities f[n] in [0, 1] and outcomes
            bool[n].
        num_bins: equal parts of [0, 1]; empty ones are left out.

    Returns:
        The figure: curves with 95 % Wilson intervals, and beneath how many predictions a bin has.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ValueError: no curve, or lengths that differ.
    """
    if not predictions:
        raise ValueError("no predictions given, so there is nothing to draw")
    with style.house_style():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(5.0, 6.0))
        curves, counts = figure.subplots(2, 1, sharex=True, height_ratios=(3.2, 1))
        figure.subplots_adjust(left=0.13, right=0.97, top=0.875, bottom=0.085, hspace=0.08)
        curves.plot([0, 1], [0, 1], color=style.MUTED, linestyle=":", linewidth=1)
        for index, (name, (predicted, outcome)) in enumerate(predictions.items()):
            color = style.SERIES[index % len(style.SERIES)]
            mean, rate, low, high, number = calibration_bins(predicted, outcome, num_bins)
            curves.errorbar(
                mean, rate, yerr=(rate - low, high - rate), color=color, marker="os^vDP"[index % 6],
                markersize=5, capsize=2, linewidth=1.3, label=f"{name} (n = {len(predicted)})",
            )  # fmt: skip
            counts.step(mean, number, where="mid", color=color, linewidth=1.3)
        curves.set_ylabel("share that came true")
        counts.set_ylabel("predictions")
        counts.set_xlabel("predicted probability")
        counts.set_yscale("symlog", linthresh=1)
        curves.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
        for axes in (curves, counts):
            axes.grid()
        curves.legend(loc="upper left")
        style.title(
            figure,
            "Calibration",
            "On the dotted line probabilities mean what they say; bars: 95 %.",
        )
    return figure


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
                f"{value:.3g} µs · {100 * value / total:.0f} %", (value, place), xytext=(4, 0),
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
