"""An episode for the rerun viewer (``.rrd``), behind the extra ``rerun``.

Everything lies in the plane z = 0 of a right-handed frame, metres; the timeline is ``step``.
"""

from pathlib import Path
from typing import Any

import numpy as np

from jaxlangnav.episode.recording import Recording, StaticScene
from jaxlangnav.inputs.object_types import ANYTHING
from jaxlangnav.inputs.whole_files import replacing
from jaxlangnav.viz import narrative, style, summary

_APPLICATION = "jaxlangnav"


def write_rrd(recording: Recording, path: Path | str) -> Path:
    """Write an episode for the rerun viewer, ``.rrd``; ``MissingExtraError`` without rerun."""
    rerun = style.require("rerun", extra="rerun")
    path = Path(path)
    with replacing(path) as temporary:
        stream = rerun.RecordingStream(_APPLICATION, recording_id=recording.scene.text or None)
        stream.save(str(temporary))
        _log_scene(rerun, stream, recording.scene)
        for moment in recording.moments:
            stream.set_time("step", sequence=moment.step)
            _log_belief(rerun, stream, recording, moment.step)
            _log_plan(rerun, stream, recording, moment.step)
            frame = moment.frame
            for name, value in (
                ("goal_seen", frame.goal_mass.sum()),
                ("goal_not_seen", frame.hypothesis_goal_mass.sum()),
                ("area_looked_at", summary.explored_share(frame)),
                ("effective_sample_size", frame.effective_sample_size),
                ("drawn_anew", frame.num_regrounded),
            ):
                stream.log(f"numbers/{name}", rerun.Scalars(float(value)))
            stream.log("story", rerun.TextLog(" ".join(narrative.tell_step(moment))))
        for line in narrative.closing(recording.last_scene, recording.at(-1), recording.result):
            stream.log("story", rerun.TextLog(line))
        stream.flush()
        stream.disconnect()
    return path


def _flat(x: Any, y: Any, z: float = 0.0) -> np.ndarray:
    """Put points of the plane into space, f32[n, 3]."""
    x, y = np.ravel(x).astype(np.float32), np.ravel(y).astype(np.float32)
    return np.stack([x, y, np.full_like(x, z)], axis=1)


def _rgba(color: str, strength: Any = 1.0) -> np.ndarray:
    """Turn "#rrggbb" and strengths in [0, 1] into u8[n, 4]."""
    strength = np.clip(np.atleast_1d(strength), 0.0, 1.0)
    red, green, blue = (int(color[at : at + 2], 16) for at in (1, 3, 5))
    colors = np.tile(np.array([red, green, blue, 0], np.uint8), (strength.size, 1))
    colors[:, 3] = np.round(255 * strength)
    return colors


def _log_scene(rerun: Any, stream: Any, scene: StaticScene) -> None:
    """Log what stays the same: the area and where things truly stand."""
    x_min, x_max, y_min, y_max = scene.area
    world = scene.scenario
    is_in = np.asarray(world.is_object)
    stream.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    corners = _flat([x_min, x_max, x_max, x_min, x_min], [y_min, y_min, y_max, y_max, y_min])
    edge = rerun.LineStrips3D([corners], colors=_rgba(style.MUTED), radii=0.02)
    stream.log("world/area", edge, static=True)
    walls = [_flat(one[::2], one[1::2]) for one in scene.walls]
    barrier = rerun.LineStrips3D(walls, colors=_rgba(style.WALL), radii=0.05)
    stream.log("world/walls", barrier, static=True)
    kinds = [int(one) for one in world.object_type[is_in]]
    truth = rerun.Points3D(
        _flat(world.object_x[is_in], world.object_y[is_in]),
        radii=0.22,
        colors=np.concatenate([_rgba(style.type_color(one), 0.35) for one in kinds]),
        labels=[f"{scene.type_name(one)} (truth)" for one in kinds],
    )
    stream.log("world/truth", truth, static=True)


def _log_belief(rerun: Any, stream: Any, recording: Recording, step: int) -> None:
    scene, frame = recording.scene, recording.at(step)
    x_min, x_max, y_min, y_max = scene.area
    size = frame.miss.shape[0]
    rows, columns = np.nonzero(frame.miss >= 0.5)
    x = x_min + (columns + 0.5) / size * (x_max - x_min)
    y = y_min + (rows + 0.5) / size * (y_max - y_min)
    unseen = rerun.Points3D(_flat(x, y, -0.02), radii=0.05, colors=_rgba(style.LINE))
    stream.log("world/not_looked_at", unseen)
    for kind, name in (*enumerate(scene.type_names), (ANYTHING, "thing")):
        chosen = frame.is_hypothesised & (frame.mention_type == kind)
        if not (recording.frames.is_hypothesised & (recording.frames.mention_type == kind)).any():
            continue
        weight = np.broadcast_to(frame.weight, chosen.shape)[chosen]
        strength = 0.2 + 0.6 * weight / max(float(frame.weight.max()), 1e-12)
        color = _rgba(style.type_color(kind), strength)
        points = _flat(frame.hypothesis_x[chosen], frame.hypothesis_y[chosen])
        stream.log(f"world/hypotheses/{name}", rerun.Points3D(points, radii=0.06, colors=color))
    seen = summary.seen_objects(frame)
    stream.log(
        "world/observed",
        rerun.Points3D(
            _flat([one.x for one in seen], [one.y for one in seen], 0.02),
            radii=0.2,
            colors=[_rgba(style.type_color(one.object_type))[0] for one in seen],
            labels=[scene.type_name(one.object_type) for one in seen],
        ),
    )


def _log_plan(rerun: Any, stream: Any, recording: Recording, step: int) -> None:
    frame = recording.at(step)
    way = recording.frames.position[: step + 1]
    path = rerun.LineStrips3D([_flat(way[:, 0], way[:, 1])], colors=_rgba(style.PATH), radii=0.03)
    stream.log("world/way", path)
    heading = float(frame.heading)
    nose = [[0.6 * np.cos(heading), 0.6 * np.sin(heading), 0.0]]
    arrow = rerun.Arrows3D(
        vectors=nose,
        origins=_flat(frame.position[0], frame.position[1], 0.03),
        colors=_rgba(style.INK),
    )
    stream.log("world/robot", arrow)
    goal = _flat(frame.waypoint[0], frame.waypoint[1], 0.03)
    stream.log("world/waypoint", rerun.Points3D(goal, radii=0.12, colors=_rgba(style.WAYPOINT)))
    open_nodes = np.isfinite(frame.value)
    nodes = _flat(frame.node_x[open_nodes], frame.node_y[open_nodes], 0.01)
    labels = [f"{value:.3g}" for value in frame.value[open_nodes]]
    look = {"radii": 0.09, "colors": _rgba(style.VIEW), "labels": labels, "show_labels": False}
    stream.log("world/nodes", rerun.Points3D(nodes, **look))
