"""The value function over time, as Figure 4 of the paper: why this waypoint and no other.

Every candidate waypoint is coloured by its value. For the ``faithful`` policy the value is also
defined between the nodes (eq. 11, 12) and drawn as contours. Beneath each map stand the best
waypoints with the parts of their value: from the goal, from what the way reveals, and the cost.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxlangnav.recording import Frame, Recording, Scene
from jaxlangnav.viz import mapping, panels, style
from jaxlangnav.viz.moments import pick_moments
from jaxlangnav.viz.summary import chosen_node, goal_field

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

NUM_BARS = 5
"""Waypoints in the chart beneath a map."""


def best_nodes(frame: Frame, number: int = NUM_BARS) -> np.ndarray:
    """Rank the open nodes of a step.

    Args:
        frame: one step.
        number: how many to keep.

    Returns:
        i64[≤ number] node indices, the most valuable first.
    """
    order = np.argsort(-np.asarray(frame.value), kind="stable")
    return order[np.isfinite(frame.value[order])][:number]


def values_figure(
    recording: Recording, *, steps: Sequence[int] | None = None, num_panels: int = 4
) -> "Figure":
    """Draw the value function at several moments of an episode.

    Args:
        recording: the episode.
        steps: moments to show; those that tell the most by default.
        num_panels: how many, where ``steps`` are not given.

    Returns:
        The figure; ``style.save`` writes it.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ValueError: a step is not in the recording, or there are none.
    """
    chosen = panels.check_steps(recording, steps) or pick_moments(recording, num_panels)
    with style.house_style():
        text = "Discs: waypoints it may choose, darker where more valuable at that step."
        if recording.scene.policy == "faithful":
            text += " Lines: equal value."
        figure, maps, charts = panels.lay_out(
            recording, len(chosen), text=text, foot=0.62, extra=0.95
        )
        for index, (axes, chart, step) in enumerate(zip(maps, charts, chosen, strict=True)):
            draw_values(axes, recording, step)
            draw_parts(chart, recording.at(step), with_label=axes.get_ylabel() != "")
            panels.head_panel(axes, recording, step, index)
        panels.add_legend(figure, _handles(recording))
    return figure


def draw_values(axes: "Axes", recording: Recording, step: int) -> "PathCollection":
    """Draw one map of Figure 4.

    Args:
        axes: to draw into.
        recording: the episode.
        step: shown.

    Returns:
        The nodes, one point for each open one, coloured by value.
    """
    scene, frame = recording.scene, recording.at(step)
    mapping.draw_ground(axes, scene, frame)
    is_field = scene.policy == "faithful"
    norm = _draw_contours(axes, scene, frame) if is_field else _norm(frame.value)
    mapping.draw_hypotheses(axes, frame, filled=False)
    is_open = np.isfinite(frame.value)
    order = np.argsort(frame.value[is_open])
    nodes = axes.scatter(
        frame.node_x[is_open][order],
        frame.node_y[is_open][order],
        c=frame.value[is_open][order],
        cmap=style.value_colormap(),
        norm=norm,
        s=62,
        edgecolors=style.INK,
        linewidths=0.7,
        zorder=5,
    )
    mapping.draw_path(axes, recording, step)
    mapping.draw_objects(axes, frame)
    mapping.draw_waypoint(axes, frame)
    mapping.draw_robot(axes, frame)
    _number_nodes(axes, frame)
    return nodes


def _number_nodes(axes: "Axes", frame: Frame) -> None:
    """Number the best waypoints on the side away from the robot."""
    for rank, node in enumerate(best_nodes(frame), start=1):
        x, y = float(frame.node_x[node]), float(frame.node_y[node])
        away = np.array([x, y]) - frame.position
        away = away / max(float(np.hypot(*away)), 1e-6)
        axes.annotate(
            str(rank),
            (x, y),
            xytext=(float(9 * away[0]), float(9 * away[1])),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=7.5,
            fontweight="bold",
            bbox={"boxstyle": "circle,pad=0.1", "fc": style.PAPER, "ec": "none", "alpha": 0.75},
            zorder=9,
        )


def draw_parts(axes: "Axes", frame: Frame, *, with_label: bool = True) -> None:
    """Draw the parts of the value of the best waypoints as stacked bars.

    Args:
        axes: to draw into.
        frame: one step.
        with_label: whether to name the axis of waypoints.
    """
    nodes = best_nodes(frame)
    places = np.arange(len(nodes))
    goal = np.asarray(frame.goal_value)[nodes]
    information = np.asarray(frame.information_value)[nodes]
    axes.barh(places, goal, height=0.66, color=style.SPLIT["goal"])
    axes.barh(places, information, left=goal, height=0.66, color=style.SPLIT["information"])
    axes.barh(places, -np.asarray(frame.cost)[nodes], height=0.66, color=style.SPLIT["cost"])
    most = max(float((goal + information).max(initial=0.0)), 1e-3)
    for place, node in zip(places, nodes, strict=True):
        value = float(frame.value[node])
        is_chosen = node == chosen_node(frame) and not bool(frame.is_done)
        axes.annotate(
            f"{value:.3g}" + (" ✓" if is_chosen else ""),
            (max(value, 0.0), place),
            xytext=(3, 0),
            textcoords="offset points",
            va="center",
            fontsize=7,
            color=style.WAYPOINT if is_chosen else style.MUTED,
        )
    axes.set_yticks(places, [str(place + 1) for place in places])
    axes.set_ylim(NUM_BARS - 0.5, -0.5)
    axes.set_xlim(min(0.0, -float(frame.cost[nodes].max(initial=0.0))), 1.3 * most)
    axes.locator_params(axis="x", nbins=4, prune="upper")
    axes.tick_params(length=2, pad=2)
    axes.set_xlabel("value", labelpad=1)
    if with_label:
        axes.set_ylabel("waypoint")


def _norm(values: np.ndarray) -> "Normalize":
    """Scale the values of one step to colours; the charts beneath give the numbers."""
    from matplotlib.colors import PowerNorm

    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    return PowerNorm(0.7, vmin=low, vmax=max(high, low + 1e-6))


def _draw_contours(axes: "Axes", scene: Scene, frame: Frame) -> "Normalize":
    """Draw lines of equal value over the whole area; return the scale of their colours."""
    x_min, x_max, y_min, y_max = scene.area
    x, y = np.meshgrid(np.linspace(x_min, x_max, 60), np.linspace(y_min, y_max, 80))
    field = goal_field(scene, frame, x, y)
    norm = _norm(np.concatenate([field.ravel(), frame.value]))
    ramp = style.value_colormap()
    axes.contourf(x, y, field, levels=12, cmap=ramp, norm=norm, alpha=0.4, zorder=1)
    axes.contour(x, y, field, levels=12, colors=style.MUTED, linewidths=0.35, zorder=1)
    return norm


def _handles(recording: Recording) -> list:
    """Build the legend: marks of the map, then the parts of a value."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    marks = [
        handle
        for handle in mapping.legend_handles(recording, filled=False)
        if not str(handle.get_label()).endswith(("true place", "view", "1.5 m"))
    ]
    ramp = style.value_colormap()
    discs = [
        Line2D(
            [], [], linestyle="none", marker="o", markersize=7, markeredgecolor=style.INK,
            markeredgewidth=0.7, markerfacecolor=ramp(level), label=label,
        )
        for level, label in ((0.1, "low value"), (0.95, "high value"))
    ]  # fmt: skip
    names = {"goal": "from the goal", "information": "from information", "cost": "cost"}
    parts = [Patch(color=style.SPLIT[name], label=label) for name, label in names.items()]
    return [*marks, *discs, *parts]
