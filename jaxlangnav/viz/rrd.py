"""Export an episode for the rerun viewer (``.rrd``); needs the extra ``rerun``.

Everything lies in the plane z = 0 of a right-handed frame, metres; the timeline is ``step``.
"""

from pathlib import Path
from typing import Any

import numpy as np

from jaxlangnav.episode.recording import Recording, StaticScene
from jaxlangnav.inputs.atomic_files import replacing
from jaxlangnav.inputs.object_types import ANYTHING
from jaxlangnav.viz import narrative, style, summary

_APPLICATION = "jaxlangnav"


def write_rrd(recording: Recording, path: Path | str) -> Path:
    """Write an episode as a rerun ``.rrd`` file; ``MissingExtraError`` without rerun."""
    rerun = style.require("rerun", extra="rerun")
    path = Path(path)
    with replacing(path) as temporary:
        stream = rerun.RecordingStream(_APPLICATION, recording_id=recording.scene.text or None)
        stream.save(str(temporary))
        _log_scene(rerun, stream, recording.scene)
        for step in recording.steps:
            stream.set_time("step", sequence=step.step)
            _log_belief(rerun, stream, recording, step.step)
            _log_robot_and_plan(rerun, stream, recording, step.step)
            frame = step.frame
            for name, value in (
                ("goal_seen", frame.goal_mass.sum()),
                ("goal_not_seen", frame.hypothesis_goal_mass.sum()),
                ("area_looked_at", summary.explored_fraction(frame)),
                ("effective_sample_size", frame.effective_sample_size),
                ("drawn_anew", frame.num_regrounded),
            ):
                stream.log(f"numbers/{name}", rerun.Scalars(float(value)))
            stream.log("story", rerun.TextLog(" ".join(narrative.narrate_step(step))))
        for line in narrative.closing(recording.last_scene, recording.at(-1), recording.result):
            stream.log("story", rerun.TextLog(line))
        stream.flush()
        stream.disconnect()
    return path


def _to_3d(x: Any, y: Any, z: float = 0.0) -> np.ndarray:
    """Stack planar points at height z into 3-D points, f32[n, 3]."""
    x, y = np.ravel(x).astype(np.float32), np.ravel(y).astype(np.float32)
    return np.stack([x, y, np.full_like(x, z)], axis=1)


def _rgba(color: str, alpha: Any = 1.0) -> np.ndarray:
    """Convert "#rrggbb" and opacities in [0, 1] to RGBA, u8[n, 4]."""
    alpha = np.clip(np.atleast_1d(alpha), 0.0, 1.0)
    colors = np.tile(np.array([*bytes.fromhex(color[1:]), 0], np.uint8), (alpha.size, 1))
    colors[:, 3] = np.round(255 * alpha)
    return colors


def _log_scene(rerun: Any, stream: Any, scene: StaticScene) -> None:
    """Log the static scene: the area, walls and true objects."""
    x_min, x_max, y_min, y_max = scene.area
    world = scene.scenario
    is_object = np.asarray(world.is_object)
    stream.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    corners = _to_3d([x_min, x_max, x_max, x_min, x_min], [y_min, y_min, y_max, y_max, y_min])
    border = rerun.LineStrips3D([corners], colors=_rgba(style.MUTED), radii=0.02)
    stream.log("world/area", border, static=True)
    walls = [_to_3d(item[::2], item[1::2]) for item in scene.walls]
    wall_strips = rerun.LineStrips3D(walls, colors=_rgba(style.WALL), radii=0.05)
    stream.log("world/walls", wall_strips, static=True)
    types = [int(item) for item in world.object_type[is_object]]
    truth = rerun.Points3D(
        _to_3d(world.object_x[is_object], world.object_y[is_object]),
        radii=0.22,
        colors=[_rgba(style.type_color(item), 0.35)[0] for item in types],
        labels=[f"{scene.type_name(item)} (truth)" for item in types],
    )
    stream.log("world/truth", truth, static=True)


def _log_belief(rerun: Any, stream: Any, recording: Recording, step: int) -> None:
    scene, frames, frame = recording.scene, recording.frames, recording.at(step)
    x_min, x_max, y_min, y_max = scene.area
    grid_size = frame.miss.shape[0]
    rows, columns = np.nonzero(frame.miss >= 0.5)
    x = x_min + (columns + 0.5) / grid_size * (x_max - x_min)
    y = y_min + (rows + 0.5) / grid_size * (y_max - y_min)
    unseen = rerun.Points3D(_to_3d(x, y, -0.02), radii=0.05, colors=_rgba(style.LINE))
    stream.log("world/not_looked_at", unseen)
    for type_id, name in (*enumerate(scene.type_names), (ANYTHING, "thing")):
        mask = frame.is_hypothesised & (frame.mention_type == type_id)
        if not (frames.is_hypothesised & (frames.mention_type == type_id)).any():
            continue
        weight = np.broadcast_to(frame.weight, mask.shape)[mask]
        alpha = 0.2 + 0.6 * weight / max(float(frame.weight.max()), 1e-12)
        color = _rgba(style.type_color(type_id), alpha)
        points = _to_3d(frame.hypothesis_x[mask], frame.hypothesis_y[mask])
        stream.log(f"world/hypotheses/{name}", rerun.Points3D(points, radii=0.06, colors=color))
    observed = summary.observed_objects(frame)
    stream.log(
        "world/observed",
        rerun.Points3D(
            _to_3d([obj.x for obj in observed], [obj.y for obj in observed], 0.02),
            radii=0.2,
            colors=[_rgba(style.type_color(obj.object_type))[0] for obj in observed],
            labels=[scene.type_name(obj.object_type) for obj in observed],
        ),
    )


def _log_robot_and_plan(rerun: Any, stream: Any, recording: Recording, step: int) -> None:
    frame = recording.at(step)
    xy = recording.frames.position[: step + 1]
    path = rerun.LineStrips3D([_to_3d(xy[:, 0], xy[:, 1])], colors=_rgba(style.PATH), radii=0.03)
    stream.log("world/way", path)
    heading = float(frame.heading)
    arrow = rerun.Arrows3D(
        vectors=[[0.6 * np.cos(heading), 0.6 * np.sin(heading), 0.0]],
        origins=_to_3d(frame.position[0], frame.position[1], 0.03),
        colors=_rgba(style.INK),
    )
    stream.log("world/robot", arrow)
    waypoint = _to_3d(frame.waypoint[0], frame.waypoint[1], 0.03)
    stream.log("world/waypoint", rerun.Points3D(waypoint, radii=0.12, colors=_rgba(style.WAYPOINT)))
    valued_nodes = np.isfinite(frame.value)
    nodes = _to_3d(frame.node_x[valued_nodes], frame.node_y[valued_nodes], 0.01)
    labels = [f"{value:.3g}" for value in frame.value[valued_nodes]]
    options = {"radii": 0.09, "colors": _rgba(style.VIEW), "labels": labels, "show_labels": False}
    stream.log("world/nodes", rerun.Points3D(nodes, **options))
