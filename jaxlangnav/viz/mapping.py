"""Draw the layers of a map: ground, objects, hypotheses, robot, waypoint (Figures 1 and 4).

Each function draws one layer into the given axes. Everything is in metres in the map frame.
"""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxlangnav.episode.recording import Recording, Snapshot, StaticScene
from jaxlangnav.messages import SensorParams
from jaxlangnav.viz import style
from jaxlangnav.viz.summary import observed_objects
from jaxlangnav.world.simulator import SUCCESS_RADIUS
from jaxlangnav.world.state import Scenario, WorldState, walls_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

_ROBOT_OUTLINE = [(1.0, 0.0), (-0.8, 0.7), (-0.45, 0.0), (-0.8, -0.7), (1.0, 0.0)]
"""Outline of the robot marker, pointing along +x."""
_HEIGHT = 4.8
_HEAD, _SIDE, _FOOT = 0.62, 0.55, 0.45
_DPI = 100


def draw_ground(axes: "Axes", scene: StaticScene, frame: Snapshot) -> None:
    """Shade the coverage map, white where observed, and set the axes' limits."""
    from matplotlib.colors import LinearSegmentedColormap

    cmap = LinearSegmentedColormap.from_list("jaxlangnav-ground", [style.PAPER, style.UNSEEN])
    axes.imshow(
        np.asarray(frame.miss), extent=scene.area, origin="lower", cmap=cmap, vmin=0.0, vmax=1.0,
        interpolation="bilinear", zorder=0,
    )  # fmt: skip
    set_area_limits(axes, scene.area)
    draw_walls(axes, scene.walls)


def draw_walls(axes: "Axes", walls: np.ndarray) -> None:
    """Draw walls, f32[W, 4], x, y of both ends, metres."""
    for x1, y1, x2, y2 in walls:
        axes.plot([x1, x2], [y1, y2], color=style.WALL, linewidth=2.4, zorder=2)


def set_area_limits(axes: "Axes", area: tuple[float, float, float, float]) -> None:
    """Set the axes' limits to the operating area, metres, with few ticks."""
    x_min, x_max, y_min, y_max = area
    margin = 0.02 * (x_max - x_min)
    axes.set_xlim(x_min - margin, x_max + margin)
    axes.set_ylim(y_min - margin, y_max + margin)
    axes.set_aspect("equal")
    axes.locator_params(axis="x", nbins=5, integer=True, prune="upper")
    axes.locator_params(axis="y", nbins=7, integer=True)
    axes.tick_params(length=2, pad=2)
    for spine in axes.spines.values():
        spine.set(visible=True, color=style.LINE)


def draw_truth(axes: "Axes", scene: StaticScene) -> None:
    """Draw the true objects faintly and the intended goal as a dotted ring."""
    _draw_world(axes, scene.scenario, scene.stop_radius if scene.is_scored else 0.0)


def _draw_world(axes: "Axes", world: Scenario, goal_radius: float) -> None:
    from matplotlib.patches import Circle

    props = {"s": 70, "facecolors": "none", "linewidths": 0.8, "alpha": 0.45, "zorder": 2}
    for slot in np.flatnonzero(world.is_object):
        type_id = int(world.object_type[slot])
        marker, color = style.type_marker(type_id), style.type_color(type_id)
        place = [world.object_x[slot]], [world.object_y[slot]]
        axes.scatter(*place, marker=marker, edgecolors=color, **props)
    if goal_radius:
        goal = (float(world.goal[0]), float(world.goal[1]))
        ring = {"fill": False, "linestyle": ":", "linewidth": 1.0, "color": style.MUTED}
        axes.add_patch(Circle(goal, goal_radius, **ring, zorder=2))


def draw_hypotheses(axes: "Axes", frame: Snapshot, *, filled: bool = True) -> None:
    """Draw hypothesised objects by type with opacity by particle weight, filled or hollow."""
    from matplotlib.colors import to_rgb

    weight = np.broadcast_to(frame.weight[None, :], frame.is_hypothesised.shape)
    max_weight = max(float(frame.weight.max()), 1e-12)
    for type_id in np.unique(frame.mention_type[np.asarray(frame.is_hypothesised)]):
        mask = frame.is_hypothesised & (frame.mention_type == type_id)
        relative, color = weight[mask] / max_weight, to_rgb(style.type_color(int(type_id)))
        colors = [(*color, float(alpha)) for alpha in np.minimum(0.15 + 0.5 * relative, 1.0)]
        axes.scatter(
            frame.hypothesis_x[mask], frame.hypothesis_y[mask], s=5 + 9 * relative,
            marker=style.type_marker(int(type_id)), facecolors=colors if filled else "none",
            edgecolors="none" if filled else colors, linewidths=0.6, zorder=3,
        )  # fmt: skip


def draw_objects(axes: "Axes", frame: Snapshot) -> None:
    """Draw observed objects as filled marks with opacity by existence probability."""
    for obj in observed_objects(frame):
        axes.scatter(
            [obj.x], [obj.y], s=52, marker=style.type_marker(obj.object_type),
            facecolors=style.type_color(obj.object_type), edgecolors=style.INK, linewidths=0.9,
            alpha=min(1.0, max(0.25, obj.probability)), zorder=6,
        )  # fmt: skip


def draw_path(axes: "Axes", recording: Recording, step: int) -> None:
    """Draw the robot's true trajectory up to a step."""
    _draw_path(axes, recording.frames.position[: step + 1])


def _draw_path(axes: "Axes", path: np.ndarray) -> None:
    axes.plot(path[:, 0], path[:, 1], color=style.PATH, linewidth=1.1, zorder=4)


def draw_view(axes: "Axes", sensor: SensorParams, frame: Snapshot | WorldState) -> None:
    """Draw the field of view as a circle, or as a sector where it is limited."""
    from matplotlib.patches import Circle, Wedge

    center = (float(frame.position[0]), float(frame.position[1]))
    radius, angle = float(sensor.range_max), float(sensor.field_of_view)
    props = {"fill": False, "linestyle": "--", "linewidth": 0.9, "color": style.VIEW, "zorder": 4}
    heading, half = math.degrees(float(frame.heading)), math.degrees(angle / 2)
    if angle >= 2 * math.pi - 1e-3:
        axes.add_patch(Circle(center, radius, **props))
    else:
        axes.add_patch(Wedge(center, radius, heading - half, heading + half, **props))


def draw_robot(axes: "Axes", frame: Snapshot | WorldState) -> None:
    """Draw the robot as a notched triangle pointing along its heading."""
    from matplotlib.markers import MarkerStyle
    from matplotlib.path import Path
    from matplotlib.transforms import Affine2D

    rotation = Affine2D().rotate(float(frame.heading))
    marker = MarkerStyle(rotation.transform_path(Path(_ROBOT_OUTLINE, closed=True)))
    axes.scatter(
        [frame.position[0]], [frame.position[1]], marker=marker, s=190, facecolors=style.INK,
        edgecolors=style.PAPER, linewidths=0.8, zorder=8,
    )  # fmt: skip


def draw_waypoint(axes: "Axes", frame: Snapshot) -> None:
    """Draw the chosen waypoint and the straight line to it; hidden once the task has ended."""
    ends = np.array([frame.position, frame.waypoint], float)
    axes.plot(
        ends[:, 0], ends[:, 1], color=style.WAYPOINT, linewidth=1.2, marker="x", markevery=[1],
        markersize=7, markeredgewidth=1.8, zorder=7, visible=not bool(frame.is_done),
    )  # fmt: skip


def legend_handles(recording: Recording, *, filled: bool = True) -> "list[Line2D]":
    """Build the legend handles of an episode's map; ``filled``: hypotheses as dots."""
    from matplotlib.lines import Line2D

    def handle(label: str, **props: Any) -> Line2D:
        return Line2D([], [], label=label, **{"linestyle": "none", **props})

    def mark(label: str, type_id: int, size: float, face: str, edge: str, **props: Any) -> Line2D:
        props |= {"markersize": size, "markerfacecolor": face, "markeredgecolor": edge}
        props["marker"] = style.type_marker(type_id)
        return handle(f"{scene.type_name(type_id)}, {label}", **props)

    frames, scene = recording.frames, recording.scene
    seen = {obj.object_type for step in recording.steps for obj in observed_objects(step.frame)}
    hypothesised = np.unique(frames.mention_type[np.asarray(frames.is_hypothesised)])
    present = np.unique(scene.scenario.object_type[np.asarray(scene.scenario.is_object)])
    size, colors = 4 if filled else 5, [(int(t), style.type_color(int(t))) for t in hypothesised]
    handles = [mark("hypothesised", t, size, c if filled else "none", c) for t, c in colors]
    handles += [mark("observed", t, 7, style.type_color(t), style.INK) for t in sorted(seen)]
    handles += [mark("true place", t, 8, "none", style.type_color(t), alpha=0.5) for t in present]
    handles += [
        handle("robot", marker="^", color=style.INK, markersize=8),
        handle("waypoint", marker="x", color=style.WAYPOINT, markersize=6, markeredgewidth=1.8),
        handle("way gone", linestyle="-", color=style.PATH, linewidth=1.1),
        handle("field of view", linestyle="--", color=style.VIEW, linewidth=0.9),
    ]
    if scene.is_scored:
        label = f"meant goal, {scene.stop_radius:g} m"
        handles.append(handle(label, linestyle=":", color=style.MUTED, linewidth=1.0))
    if len(scene.walls):
        handles.append(handle("wall", linestyle="-", color=style.WALL, linewidth=2.4))
    return handles


def render_world(
    scenario: Scenario, sensor: SensorParams, world: WorldState, *, path: np.ndarray, text: str
) -> np.ndarray:
    """Render the true world and the robot at the pose in ``world``.

    ``path``: f32[T, 2], true positions so far, metres; ``text``: the command. u8[480, W, 3], red,
    green, blue; the width follows from the area's shape. ``MissingExtraError`` without matplotlib.
    """
    style.require("matplotlib")
    x_min, x_max, y_min, y_max = (float(edge) for edge in scenario.area)
    height = _HEIGHT - _HEAD - _FOOT
    width = max(height * (x_max - x_min) / (y_max - y_min), 2.4)
    with style.house_style():
        size, margins = (width + 2 * _SIDE, _HEIGHT), (_SIDE, _SIDE, _HEAD, _FOOT)
        figure, ((axes,),) = style.panels(size, 1, 1, margins)
        figure.set_dpi(_DPI)
        set_area_limits(axes, (x_min, x_max, y_min, y_max))
        _draw_world(axes, scenario, SUCCESS_RADIUS)
        draw_walls(axes, walls_of(scenario))
        draw_view(axes, sensor, world)
        _draw_path(axes, path)
        draw_robot(axes, world)
        metres = float(np.hypot(*np.diff(path, axis=0).T).sum())
        style.title(figure, f"“{text}”", f"step {len(path) - 1} · {metres:.1f} m")
        return style.rgb_image(figure)
