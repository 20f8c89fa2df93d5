"""The value function over time, as Figure 4 of the paper: why this waypoint and no other.

Every candidate waypoint is coloured by its value. Where a policy's values are defined between the
nodes, too (eq. 11, 12), they are drawn as contours. Beneath each map stand the best
waypoints with the parts of their value: from the goal, from what the way reveals, and the cost.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxlangnav.messages import Status
from jaxlangnav.recording import Frame, Recording, StaticScene
from jaxlangnav.viz import mapping, panels, style
from jaxlangnav.viz.summary import SAME_PLACE, distinct_nodes, goal_field
from jaxlangnav.viz.words import percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

NUM_BARS = 5
"""Waypoints in the chart beneath a map."""


def best_nodes(frame: Frame, number: int = NUM_BARS) -> np.ndarray:
    """Rank the places open to a step; nodes that stand together are one place.

    Args:
        frame: one step.
        number: how many to keep.

    Returns:
        i64[≤ number] node indices, the most valuable first.
    """
    return distinct_nodes(frame)[:number]


def values_figure(
    recording: Recording, *, steps: Sequence[int] | None = None, num_panels: int = 4
) -> "Figure":
    """Draw the value function at several moments of an episode.

    Args:
        recording: the episode.
        steps: as ``panels.choose_steps`` takes them.
        num_panels: the same.

    Returns:
        The figure; ``style.save`` writes it.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ValueError: a step is not in the recording, or there are none.
    """
    chosen = panels.choose_steps(recording, steps, num_panels)
    with style.house_style():
        text = "Discs: waypoints it may choose, darker where more valuable at that step."
        if recording.scene.portrayal.is_field:
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
    is_field = scene.portrayal.is_field
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
    if not bool(frame.is_done):
        _number_nodes(axes, frame)
    return nodes


def _number_nodes(axes: "Axes", frame: Frame) -> None:
    """Number the best waypoints, each on the side where most room is."""
    is_open = np.isfinite(frame.value)
    taken = [*zip(frame.node_x[is_open], frame.node_y[is_open], strict=True), frame.position]
    scale = abs(float(np.diff(axes.get_ylim())[0])) / 22.0
    turns = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    for rank, node in enumerate(best_nodes(frame), start=1):
        x, y = float(frame.node_x[node]), float(frame.node_y[node])
        others = np.array([one for one in taken if tuple(one) != (x, y)], float)
        spots = np.stack([x + scale * np.cos(turns), y + scale * np.sin(turns)], axis=1)
        room = np.hypot(*(spots[:, None, :] - others[None]).transpose(2, 0, 1)).min(axis=1)
        inside = _is_inside(axes, spots)
        spot = spots[int(np.argmax(np.where(inside, room, -1.0)))]
        taken.append(tuple(spot))
        axes.text(
            float(spot[0]),
            float(spot[1]),
            str(rank),
            ha="center",
            va="center",
            fontsize=7.5,
            fontweight="bold",
            bbox={"boxstyle": "circle,pad=0.1", "fc": style.PAPER, "ec": "none", "alpha": 0.75},
            zorder=9,
        )


def _is_inside(axes: "Axes", spots: np.ndarray) -> np.ndarray:
    """Tell which places lie within the axes, bool[n]."""
    (x_low, x_high), (y_low, y_high) = axes.get_xlim(), axes.get_ylim()
    x, y = spots.T
    return (x > x_low) & (x < x_high) & (y > y_low) & (y < y_high)


def draw_parts(axes: "Axes", frame: Frame, *, with_label: bool = True) -> None:
    """Draw the parts of the value of the best waypoints as stacked bars.

    Args:
        axes: to draw into.
        frame: one step.
        with_label: whether to name the axis of waypoints.

    Where the robot has stopped there is nothing to choose: its reason stands there instead.
    """
    if bool(frame.is_done):
        _say_why_stopped(axes, frame)
        return
    nodes = best_nodes(frame)
    places = np.arange(len(nodes))
    goal = np.asarray(frame.goal_value)[nodes]
    information = np.asarray(frame.information_value)[nodes]
    axes.barh(places, goal, height=0.66, color=style.SPLIT["goal"])
    axes.barh(places, information, left=goal, height=0.66, color=style.SPLIT["information"])
    axes.barh(places, -np.asarray(frame.cost)[nodes], height=0.66, color=style.SPLIT["cost"])
    off = np.hypot(frame.node_x[nodes] - frame.waypoint[0], frame.node_y[nodes] - frame.waypoint[1])
    chosen = int(np.argmin(off)) if off.size and off.min() < SAME_PLACE else None
    most = max(float((goal + information).max(initial=0.0)), 1e-3)
    for place, node in zip(places, nodes, strict=True):
        value = float(frame.value[node])
        is_chosen = place == chosen
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
    axes.set_xlim(min(0.0, -float(frame.cost[nodes].max(initial=0.0))), 1.36 * most)
    axes.locator_params(axis="x", nbins=3, prune="upper")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}".replace("-", "−"))
    axes.tick_params(length=2, pad=2)
    axes.set_xlabel("value", labelpad=1)
    if with_label:
        axes.set_ylabel("waypoint")


def _say_why_stopped(axes: "Axes", frame: Frame) -> None:
    """Write beneath the last map why the robot has stopped."""
    is_find = float(frame.action[1]) > 0.5
    where = "in view" if is_find else "within reach"
    text = f"It stops: the goal is {where}\nwith probability {percent(float(frame.stop_mass))}."
    if int(frame.status) == Status.NOT_FOUND:
        text = "It gives up: what can be looked at\nhas been looked at."
    axes.text(0.02, 0.94, text, va="top", fontsize=8.5, transform=axes.transAxes)
    axes.axis("off")


def _norm(values: np.ndarray) -> "Normalize":
    """Scale the values of one step to colours; the charts beneath give the numbers."""
    from matplotlib.colors import PowerNorm

    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    return PowerNorm(0.7, vmin=low, vmax=max(high, low + 1e-6))


def _draw_contours(axes: "Axes", scene: StaticScene, frame: Frame) -> "Normalize":
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
