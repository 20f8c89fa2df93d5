"""Pieces of a map: ground, objects, hypotheses, robot, waypoint (the marks of Figures 1 and 4).

Each function draws one thing into given axes and returns what it drew, so that a test can count.
Everything is in metres in the map frame.
"""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxlangnav.episode.recording import Frame, Recording, StaticScene
from jaxlangnav.messages import NONE, SensorParams
from jaxlangnav.viz import style
from jaxlangnav.viz.summary import seen_objects
from jaxlangnav.world.state import Scenario, WorldState, walls_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.image import AxesImage
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

_DART = [(1.0, 0.0), (-0.8, 0.7), (-0.45, 0.0), (-0.8, -0.7), (1.0, 0.0)]
"""The robot: an equilateral triangle would not tell which of its corners is the front."""
_HEIGHT = 4.8
_HEAD, _SIDE, _FOOT = 0.62, 0.55, 0.45
_DOTS = 100


def draw_ground(axes: "Axes", scene: StaticScene, frame: Frame) -> "AxesImage":
    """Shade ground by the probability of a miss, white where looked at; sets the axes' limits."""
    from matplotlib.colors import LinearSegmentedColormap

    ramp = LinearSegmentedColormap.from_list("jaxlangnav-ground", [style.PAPER, style.UNSEEN])
    image = axes.imshow(
        np.asarray(frame.miss), extent=scene.area, origin="lower", cmap=ramp, vmin=0.0, vmax=1.0,
        interpolation="bilinear", zorder=0,
    )  # fmt: skip
    frame_area(axes, scene.area)
    draw_walls(axes, scene.walls)
    return image


def draw_walls(axes: "Axes", walls: np.ndarray) -> None:
    """Draw walls, f32[W, 4], x, y of both ends, metres."""
    for one_x, one_y, other_x, other_y in walls:
        axes.plot([one_x, other_x], [one_y, other_y], color=style.WALL, linewidth=2.4, zorder=2)


def frame_area(axes: "Axes", area: tuple[float, float, float, float]) -> None:
    """Give axes the limits of the operating area, metres, and few ticks."""
    x_min, x_max, y_min, y_max = area
    margin = 0.02 * (x_max - x_min)
    axes.set_xlim(x_min - margin, x_max + margin)
    axes.set_ylim(y_min - margin, y_max + margin)
    axes.set_aspect("equal")
    axes.locator_params(axis="x", nbins=5, integer=True, prune="upper")
    axes.locator_params(axis="y", nbins=7, integer=True)
    axes.tick_params(length=2, pad=2)
    for side in ("top", "right"):
        axes.spines[side].set_visible(True)
    for spine in axes.spines.values():
        spine.set_color(style.LINE)


def draw_truth(axes: "Axes", scene: StaticScene) -> "list[PathCollection]":
    """Mark where things truly stand, faintly, and the goal that was meant by a dotted ring."""
    return _draw_world(axes, scene.scenario, has_goal=scene.is_judged)


def _draw_world(axes: "Axes", world: Scenario, *, has_goal: bool = True) -> "list[PathCollection]":
    from matplotlib.patches import Circle

    look = {"s": 70, "facecolors": "none", "linewidths": 0.8, "alpha": 0.45, "zorder": 2}
    marks = [
        axes.scatter(
            [world.object_x[slot]], [world.object_y[slot]], marker=style.type_marker(kind),
            edgecolors=style.type_color(kind), **look,
        )
        for slot in np.flatnonzero(world.is_object)
        for kind in (int(world.object_type[slot]),)
    ]  # fmt: skip
    if has_goal:
        goal = (float(world.goal[0]), float(world.goal[1]))
        ring = {"fill": False, "linestyle": ":", "linewidth": 1.0, "color": style.MUTED}
        axes.add_patch(Circle(goal, 1.5, **ring, zorder=2))
    return marks


def draw_hypotheses(axes: "Axes", frame: Frame, *, filled: bool = True) -> "list[PathCollection]":
    """Draw hypothesised objects, the heavier the stronger: dots, or empty marks, by type."""
    from matplotlib.colors import to_rgb

    weight = np.broadcast_to(frame.weight[None, :], frame.is_hypothesised.shape)
    full = max(float(frame.weight.max()), 1e-12)
    drawn = []
    for kind in np.unique(frame.mention_type[np.asarray(frame.is_hypothesised)]):
        chosen = frame.is_hypothesised & (frame.mention_type == kind)
        relative, color = weight[chosen] / full, to_rgb(style.type_color(int(kind)))
        colors = [(*color, float(one)) for one in np.minimum(0.15 + 0.5 * relative, 1.0)]
        marks = axes.scatter(
            frame.hypothesis_x[chosen], frame.hypothesis_y[chosen], s=5 + 9 * relative,
            marker=style.type_marker(int(kind)), facecolors=colors if filled else "none",
            edgecolors="none" if filled else colors, linewidths=0.6, zorder=3,
        )  # fmt: skip
        drawn.append(marks)
    return drawn


def draw_objects(axes: "Axes", frame: Frame) -> "list[PathCollection]":
    """Draw what has been observed: filled marks with a dark rim, faint if few particles agree."""
    return [
        axes.scatter(
            [one.x], [one.y], s=52, marker=style.type_marker(one.object_type),
            facecolors=style.type_color(one.object_type), edgecolors=style.INK, linewidths=0.9,
            alpha=min(1.0, max(0.25, one.probability)), zorder=6,
        )
        for one in seen_objects(frame)
    ]  # fmt: skip


def draw_path(axes: "Axes", recording: Recording, step: int) -> "Line2D":
    """Draw the way the robot has truly gone up to a step."""
    way = recording.frames.position[: step + 1]
    (line,) = axes.plot(way[:, 0], way[:, 1], color=style.PATH, linewidth=1.1, zorder=4)
    return line


def draw_view(axes: "Axes", sensor: SensorParams, frame: Frame | WorldState) -> "Patch":
    """Draw the field of view: a circle, or a sector where it is limited."""
    from matplotlib.patches import Circle, Wedge

    place = (float(frame.position[0]), float(frame.position[1]))
    reach, opening = float(sensor.range_max), float(sensor.field_of_view)
    look = {"fill": False, "linestyle": "--", "linewidth": 0.9, "color": style.VIEW, "zorder": 4}
    if opening >= 2 * math.pi - 1e-3:
        return axes.add_patch(Circle(place, reach, **look))
    middle, half = math.degrees(float(frame.heading)), math.degrees(opening / 2)
    return axes.add_patch(Wedge(place, reach, middle - half, middle + half, **look))


def draw_robot(axes: "Axes", frame: Frame | WorldState) -> "PathCollection":
    """Draw the robot as a notched triangle that points where it heads."""
    from matplotlib.markers import MarkerStyle
    from matplotlib.path import Path
    from matplotlib.transforms import Affine2D

    turn = Affine2D().rotate(float(frame.heading))
    dart = MarkerStyle(turn.transform_path(Path(_DART, closed=True)))
    return axes.scatter(
        [frame.position[0]], [frame.position[1]], marker=dart, s=190, facecolors=style.INK,
        edgecolors=style.PAPER, linewidths=0.8, zorder=8,
    )  # fmt: skip


def draw_waypoint(axes: "Axes", frame: Frame) -> "Line2D":
    """Draw the chosen waypoint and the straight way to it; hidden where the robot has stopped."""
    way = np.array([frame.position, frame.waypoint], float)
    (line,) = axes.plot(
        way[:, 0], way[:, 1], color=style.WAYPOINT, linewidth=1.2, marker="x", markevery=[1],
        markersize=7, markeredgewidth=1.8, zorder=7, visible=not bool(frame.is_done),
    )  # fmt: skip
    return line


def legend_handles(recording: Recording, *, filled: bool = True) -> "list[Line2D]":
    """Build the legend of the marks of an episode; hypotheses are dots where ``filled``."""
    from matplotlib.lines import Line2D

    def handle(label: str, **look: Any) -> Line2D:
        return Line2D([], [], label=label, **{"linestyle": "none", **look})

    def mark(label: str, kind: int, size: float, face: str, edge: str) -> Line2D:
        marker = style.type_marker(kind)
        look = {"markersize": size, "markerfacecolor": face, "markeredgecolor": edge}
        return handle(f"{scene.type_name(kind)}, {label}", marker=marker, **look)

    frames, scene = recording.frames, recording.scene
    thought = np.unique(frames.mention_type[np.asarray(frames.is_hypothesised)])
    seen = np.unique(frames.object_type[frames.object_type != NONE])
    true = np.unique(scene.scenario.object_type[np.asarray(scene.scenario.is_object)])
    handles = []
    for kind in map(int, thought):
        color = style.type_color(kind)
        handles.append(
            mark("hypothesised", kind, 4 if filled else 5, color if filled else "none", color)
        )
    handles += [mark("observed", kind, 7, style.type_color(kind), style.INK) for kind in seen]
    for kind in true:
        handles.append(mark("true place", kind, 8, "none", style.type_color(kind)))
        handles[-1].set_alpha(0.5)
    return [
        *handles,
        handle("robot", marker="^", color=style.INK, markersize=8),
        handle("waypoint", marker="x", color=style.WAYPOINT, markersize=6, markeredgewidth=1.8),
        handle("way gone", linestyle="-", color=style.PATH, linewidth=1.1),
        handle("field of view", linestyle="--", color=style.VIEW, linewidth=0.9),
        handle("meant goal, 1.5 m", linestyle=":", color=style.MUTED, linewidth=1.0),
        *[handle("wall", linestyle="-", color=style.WALL, linewidth=2.4)][: len(scene.walls)],
    ]


def drive_picture(
    scenario: Scenario, sensor: SensorParams, world: WorldState, *, way: np.ndarray, text: str
) -> np.ndarray:
    """Draw the true world with the robot in it, as ``world`` says where.

    ``way``: f32[T, 2], true positions so far, metres; ``text``: the command. u8[480, W, 3], red,
    green, blue; the width follows from the area's shape. ``MissingExtraError`` without matplotlib.
    """
    style.require("matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    x_min, x_max, y_min, y_max = (float(edge) for edge in scenario.area)
    tall = _HEIGHT - _HEAD - _FOOT
    wide = max(tall * (x_max - x_min) / (y_max - y_min), 2.4)
    with style.house_style():
        size, margins = (wide + 2 * _SIDE, _HEIGHT), (_SIDE, _SIDE, _HEAD, _FOOT)
        figure, ((axes,),) = style.panels(size, 1, 1, margins)
        figure.set_dpi(_DOTS)
        canvas = FigureCanvasAgg(figure)
        frame_area(axes, (x_min, x_max, y_min, y_max))
        _draw_world(axes, scenario)
        draw_walls(axes, walls_of(scenario))
        draw_view(axes, sensor, world)
        axes.plot(way[:, 0], way[:, 1], color=style.PATH, linewidth=1.1, zorder=4)
        draw_robot(axes, world)
        metres = float(np.hypot(*np.diff(way, axis=0).T).sum())
        style.title(figure, f"“{text}”", f"step {len(way) - 1} · {metres:.1f} m")
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()
