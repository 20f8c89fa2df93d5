"""Figures of belief and value function over time, as rows of map panels."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxlangnav.episode.recording import Recording, Snapshot
from jaxlangnav.messages import Status
from jaxlangnav.viz import mapping, style
from jaxlangnav.viz.narrative import describe_ending, headline, select_steps
from jaxlangnav.viz.sentences import percent
from jaxlangnav.viz.summary import SAME_NODE_RADIUS, distinct_nodes, goal_field

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

_WIDTH = 10.5  # width of a figure, inches: two columns of a journal, or a screen
NUM_BARS = 5  # waypoints in the chart beneath a map


def _layout(
    recording: Recording, steps: Sequence[int], *, text: str, has_charts: bool = False
) -> "tuple[Figure, list[Axes], list[Axes]]":
    """Create map axes with the area's aspect ratio for each step, and optional charts below them.

    A panel's title is its letter, step, distance so far and headline.
    """
    x_min, x_max, y_min, y_max = recording.scene.area
    aspect, num_panels = (x_max - x_min) / (y_max - y_min), len(steps)
    columns = num_panels if num_panels <= 4 or aspect < 0.5 else math.ceil(num_panels / 2)
    rows = math.ceil(num_panels / columns)
    height = min(3.6, _WIDTH / columns / aspect, 4.4)
    heights = [height + 0.82, 1.25] if has_charts else [height + 0.82]
    # Headline and legend need a minimum width.
    size = max(columns * (height * aspect + 0.16) + 0.74, 8.4), rows * sum(heights) + 1.28
    how = {"height_ratios": rows * heights, "hspace": 0.34 if has_charts else 0.25, "wspace": 0.08}
    figure, grid = style.panels(size, rows * len(heights), columns, (0.62, 0.12, 1.08, 1.02), **how)
    maps = list(grid[:: len(heights)].flat)
    charts = list(grid[1::2].flat) if has_charts else []
    for axes in (*maps[num_panels:], *charts[num_panels:]):
        axes.remove()
    for index, (axes, step) in enumerate(zip(maps, steps, strict=False)):
        axes.set_xlabel("x (m)" if index + columns >= num_panels else "")
        axes.set_ylabel("y (m)" if index % columns == 0 else "")
        axes.tick_params(labelleft=index % columns == 0)
        moment, letter = recording.steps[step], chr(ord("a") + index % 26)
        distance = f"{float(moment.frame.distance):.1f} m"
        axes.set_title(f"({letter}) step {moment.step} · {distance}", pad=16)
        axes.annotate(
            headline(moment), (0, 1), xytext=(0, 5), xycoords="axes fraction",
            textcoords="offset points", fontsize=8, color=style.MUTED,
        )  # fmt: skip
    style.title(
        figure,
        f"“{recording.scene.text}”" if recording.scene.text else "Episode",
        f"{verdict(recording)}.\n{text}",
    )
    return figure, maps[:num_panels], charts[:num_panels]


def outcome(recording: Recording) -> str:
    """Summarize how the episode ended in two or three words."""
    if recording.end_reason:
        return recording.end_reason.partition(":")[0].replace("_", " ")
    return describe_ending(recording.scene, recording.result)[0]


def verdict(recording: Recording) -> str:
    """Summarize in half a line how the episode ended and how far the robot walked."""
    result, ending = recording.result, outcome(recording)
    if not recording.scene.is_scored:
        return f"{recording.scene.policy} policy: {ending}, for {recording.scene.unscored}"
    error, distance = float(result.goal_distance), float(result.distance)
    return (
        f"{recording.scene.policy} policy: {ending}, {error:.1f} m from the meant goal after "
        f"{distance:.1f} m (known map, to the goal itself: {recording.scene.known_distance:.1f} m)"
    )


def _choose_steps(recording: Recording, steps: Sequence[int] | None, count: int) -> list[int]:
    """Validate the requested steps, or by default select the most informative ones."""
    if steps is None:
        return select_steps(recording, count)
    if not steps:
        raise ValueError("steps is empty, but a figure needs at least one moment")
    num_steps = recording.num_steps
    for step in steps:
        if not -num_steps <= step < num_steps:
            raise ValueError(f"step is {step}, but the recording has steps 0 to {num_steps - 1}")
    return [step % num_steps for step in steps]


def _add_legend(figure: "Figure", handles: Sequence[Any]) -> None:
    """Add a legend along the bottom of a figure, in as many columns as fit."""
    columns = min(len(handles), max(3, int(figure.get_figwidth() / 1.55)))
    rows = math.ceil(len(handles) / columns)
    figure.legend(
        handles=list(handles), loc="lower center", ncols=math.ceil(len(handles) / rows),
        bbox_to_anchor=(0.5, 0.02 / figure.get_figheight()), columnspacing=1.4, handletextpad=0.5,
    )  # fmt: skip


def draw_belief(axes: "Axes", recording: Recording, step: int) -> None:
    """Draw the belief at a step and the ground truth into map axes."""
    scene, frame = recording.scene, recording.at(step)
    mapping.draw_ground(axes, scene, frame)
    mapping.draw_truth(axes, scene)
    mapping.draw_hypotheses(axes, frame)
    mapping.draw_objects(axes, frame)
    mapping.draw_path(axes, recording, step)
    mapping.draw_view(axes, scene.sensor, frame)
    mapping.draw_waypoint(axes, frame)
    mapping.draw_robot(axes, frame)


def belief_figure(
    recording: Recording, *, steps: Sequence[int] | None = None, num_panels: int = 6
) -> "Figure":
    """Draw the belief at several moments of an episode; ``style.save`` writes the figure.

    ``steps``: those to show, negative ones counted from the end; by default ``num_panels`` of them,
    those that tell the most. ``MissingExtraError`` without matplotlib, ``ValueError`` for a step
    that is not in the recording or for none.
    """
    chosen = _choose_steps(recording, steps, num_panels)
    text = "Dots: hypotheses, one map per particle, stronger where heavier. Grey: not looked at."
    with style.house_style():
        figure, maps, _ = _layout(recording, chosen, text=text)
        for axes, step in zip(maps, chosen, strict=True):
            draw_belief(axes, recording, step)
        _add_legend(figure, mapping.legend_handles(recording))
    return figure


def values_figure(
    recording: Recording, *, steps: Sequence[int] | None = None, num_panels: int = 4
) -> "Figure":
    """Draw the value function at several moments of an episode; all else as ``belief_figure``."""
    chosen = _choose_steps(recording, steps, num_panels)
    with style.house_style():
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        text = "Discs: waypoints it may choose, darker where more valuable at that step."
        if recording.scene.portrayal.is_field:
            text += " Lines: equal value."
        figure, maps, charts = _layout(recording, chosen, text=text, has_charts=True)
        for axes, chart, step in zip(maps, charts, chosen, strict=True):
            _draw_values(axes, recording, step)
            _draw_value_terms(chart, recording.at(step))
            chart.set_ylabel("waypoint" if axes.get_ylabel() else "")
        marks = [
            handle
            for handle in mapping.legend_handles(recording, filled=False)
            if not str(handle.get_label()).endswith(("true place", "view", " m"))
        ]
        cmap = style.value_colormap()
        discs = [
            Line2D(
                [], [], linestyle="none", marker="o", markersize=7, markeredgecolor=style.INK,
                markeredgewidth=0.7, markerfacecolor=cmap(level), label=label,
            )
            for level, label in ((0.1, "low value"), (0.95, "high value"))
        ]  # fmt: skip
        names = {"goal": "from the goal", "information": "from information", "cost": "cost"}
        parts = [Patch(color=style.SPLIT[name], label=label) for name, label in names.items()]
        _add_legend(figure, [*marks, *discs, *parts])
    return figure


def _draw_values(axes: "Axes", recording: Recording, step: int) -> None:
    scene, frame = recording.scene, recording.at(step)
    mapping.draw_ground(axes, scene, frame)
    norm, cmap = _norm(frame.value), style.value_colormap()
    if scene.portrayal.is_field:
        x_min, x_max, y_min, y_max = scene.area
        x, y = np.meshgrid(np.linspace(x_min, x_max, 60), np.linspace(y_min, y_max, 80))
        field = goal_field(scene, frame, x, y)
        norm = _norm(np.concatenate([field.ravel(), frame.value]))
        axes.contourf(x, y, field, levels=12, cmap=cmap, norm=norm, alpha=0.4, zorder=1)
        axes.contour(x, y, field, levels=12, colors=style.MUTED, linewidths=0.35, zorder=1)
    mapping.draw_hypotheses(axes, frame, filled=False)
    is_open = np.flatnonzero(np.isfinite(frame.value))
    order = is_open[np.argsort(frame.value[is_open])]
    axes.scatter(
        frame.node_x[order], frame.node_y[order], c=frame.value[order], cmap=cmap, norm=norm, s=62,
        edgecolors=style.INK, linewidths=0.7, zorder=5,
    )  # fmt: skip
    mapping.draw_path(axes, recording, step)
    mapping.draw_objects(axes, frame)
    mapping.draw_waypoint(axes, frame)
    mapping.draw_robot(axes, frame)
    for rank, node in enumerate([] if frame.is_done else distinct_nodes(frame)[:NUM_BARS], start=1):
        axes.annotate(
            str(rank), (frame.node_x[node], frame.node_y[node]), xytext=(5, 5),
            textcoords="offset points", fontsize=7.5, fontweight="bold", zorder=9,
            bbox={"boxstyle": "circle,pad=0.1", "fc": style.PAPER, "ec": "none", "alpha": 0.75},
        )  # fmt: skip


def _draw_value_terms(axes: "Axes", frame: Snapshot) -> None:
    """Draw the value terms of the best waypoints as stacked bars: goal, information, cost."""
    # Once the task has ended, show the reason instead.
    if bool(frame.is_done):
        where = "in view" if float(frame.action[1]) > 0.5 else "within reach"
        text = f"It stops: the goal is {where}\nwith probability {percent(float(frame.stop_mass))}."
        if int(frame.status) == Status.NOT_FOUND:
            text = "It gives up: what can be looked at\nhas been looked at."
        axes.text(0.02, 0.94, text, va="top", fontsize=8.5, transform=axes.transAxes)
        axes.axis("off")
        return
    nodes = distinct_nodes(frame)[:NUM_BARS]
    rows = np.arange(len(nodes))
    goal = np.asarray(frame.goal_value)[nodes]
    information = np.asarray(frame.information_value)[nodes]
    axes.barh(rows, goal, height=0.66, color=style.SPLIT["goal"])
    axes.barh(rows, information, left=goal, height=0.66, color=style.SPLIT["information"])
    axes.barh(rows, -np.asarray(frame.cost)[nodes], height=0.66, color=style.SPLIT["cost"])
    gap = np.hypot(frame.node_x[nodes] - frame.waypoint[0], frame.node_y[nodes] - frame.waypoint[1])
    chosen = int(np.argmin(gap)) if gap.size and gap.min() < SAME_NODE_RADIUS else None
    max_value = max(float((goal + information).max(initial=0.0)), 1e-3)
    for row, node in zip(rows, nodes, strict=True):
        value = float(frame.value[node])
        mark, color = (" ✓", style.WAYPOINT) if row == chosen else ("", style.MUTED)
        axes.annotate(
            f"{value:.3g}{mark}", (max(value, 0.0), row), xytext=(3, 0),
            textcoords="offset points", va="center", fontsize=7, color=color,
        )  # fmt: skip
    axes.set_yticks(rows, [str(row + 1) for row in rows])
    axes.set_ylim(NUM_BARS - 0.5, -0.5)
    axes.set_xlim(min(0.0, -float(frame.cost[nodes].max(initial=0.0))), 1.36 * max_value)
    axes.locator_params(axis="x", nbins=3, prune="upper")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}".replace("-", "−"))
    axes.tick_params(length=2, pad=2)
    axes.set_xlabel("value", labelpad=1)


def _norm(values: np.ndarray) -> "Normalize":
    from matplotlib.colors import PowerNorm

    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    return PowerNorm(0.7, vmin=low, vmax=max(high, low + 1e-6))
