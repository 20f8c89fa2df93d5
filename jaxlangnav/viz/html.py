"""Export an episode as one self-contained web page: slider, map, charts and narrative.

``recording.html`` is the template; this module fills in the recording. Large arrays are stored
as base64 of little-endian numbers: positions of hypotheses on a 16-bit grid over the map
(better than a millimetre on 50 m), weights relative to the heaviest particle of their step.
"""

import base64
import html
import json
import re
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from jaxlangnav.episode.recording import Recording
from jaxlangnav.inputs.atomic_files import write_text
from jaxlangnav.inputs.sanitize import sanitize
from jaxlangnav.planner.graph import FRONTIER, OBJECT_NODE, VISITED
from jaxlangnav.viz import narrative, panels, sentences, style, summary
from jaxlangnav.viz.narrative import narrate
from jaxlangnav.viz.panels import belief_figure, values_figure
from jaxlangnav.viz.sentences import describe_readings, percent

_ABSENT = 65535  # grid coordinate that marks a missing hypothesis
_NODE_NAMES = {FRONTIER: "frontier", VISITED: "visited place", OBJECT_NODE: "object"}
_UNNAMED, _NO_TYPE = 254, 255  # hypothesis type codes, u8: a type without a name, and no type


def write_html(recording: Recording, path: Path | str) -> Path:
    """Write an episode as a self-contained HTML page; folders are made."""
    return write_text(render_html(recording), Path(path))


def render_html(recording: Recording) -> str:
    """Render an episode as a self-contained HTML page."""
    return fill_page(recording.scene.text or "Episode", page_data(recording))


def fill_page(title: str, data: Any, *, controls: str = "", connect: str = "") -> str:
    """Fill the HTML template of an episode page.

    Args:
        title: of the window.
        data: of ``page_data``; None for a page that a script of its ``controls`` fills.
        controls: HTML above the episode.
        connect: of the content security policy: where the page may connect to, nowhere if empty.
    """
    template = resources.files("jaxlangnav.viz") / "recording.html"
    # Inside a script element only "</" and "<!--" could end the data early. One pass, since the
    # sentence itself may contain a placeholder.
    parts = {
        "__TITLE__": html.escape(sanitize(title)),
        "__DATA__": page_json(data).replace("<", "\\u003c"),
        "__CONTROLS__": controls,
        "__CONNECT__": f"; connect-src {connect}" if connect else "",
    }
    page = template.read_text(encoding="utf-8")
    return re.sub("|".join(parts), lambda match: parts[match[0]], page)


def page_json(data: Any) -> str:
    """Serialize page data as compact JSON."""
    return json.dumps(data, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def page_data(recording: Recording, *, is_under_way: bool = False) -> dict[str, Any]:
    """Collect everything the page shows as JSON-serializable types.

    Args:
        recording: the episode, as far as it has come.
        is_under_way: it goes on: how it ends cannot be told yet.
    """
    scene, frames, world = recording.scene, recording.frames, recording.scene.scenario
    # Readings of the first sentence and after each later utterance.
    scenes = [scene, *(u.scene for u in recording.utterances if u.scene is not None)]
    readings = (describe_readings(current, min_prob=0.005) for current in scenes)
    claims = list(dict.fromkeys(claim for reading in readings for claim, _ in reading))
    summary_parts = [
        f"Taken to say that there is {claim} ({percent(p)})."
        for claim, p in describe_readings(scene)[:1]
        if claim != "nothing"
    ]
    if not is_under_way:
        summary_parts.append(f"The {panels.verdict(recording)}.")
    objects = world.object_type, world.object_x, world.object_y
    truth = (np.asarray(leaf)[np.asarray(world.is_object)].tolist() for leaf in objects)
    return {
        "text": sanitize(scene.text),
        "summary": " ".join(summary_parts),
        "outcome": "under way" if is_under_way else panels.outcome(recording),
        "is_under_way": is_under_way,
        "num_steps": recording.num_steps,
        "num_particles": recording.num_particles,
        "num_nodes": int(frames.value.shape[1]),
        "grid_size": int(frames.miss.shape[-1]),
        "area": list(scene.area),
        "range": float(scene.sensor.range_max),
        "field_of_view": float(scene.sensor.field_of_view),
        "goal": [float(value) for value in scene.scenario.goal] if scene.is_scored else None,
        "success_radius": scene.stop_radius,
        "walls": scene.walls.tolist(),
        "truth": [{"type": code, "x": x, "y": y} for code, x, y in zip(*truth, strict=True)],
        "value_colormap": [[*bytes.fromhex(color[1:])] for color in style.VALUE_STOPS],
        "types": [
            {"name": name, "color": style.type_color(type_id), "shape": style.type_marker(type_id)}
            for type_id, name in enumerate(scene.type_names)
        ],
        "claims": claims,
        "camera_images": [
            {title: base64.b64encode(jpeg).decode("ascii") for title, jpeg in images.items()}
            for images in recording.pictures
        ],
        **_step_data(recording, claims, is_under_way=is_under_way),
        **_array_data(recording),
    }


def _step_data(recording: Recording, claims: list[str], *, is_under_way: bool) -> dict[str, Any]:
    """Collect the plain JSON data of each step: narrative, objects, detections, claims."""
    frames = recording.frames
    story = [narrative.narrate_step(step) for step in recording.steps]
    objects, detections, claim_probs = [], [], []
    for step in recording.steps:
        frame = step.frame
        rows = [
            [obj.object_type, *_rounded(obj.x, obj.y, obj.spread, obj.probability, obj.goal_mass)]
            for obj in summary.observed_objects(frame)
        ]
        objects.append(rows)
        bearing = frame.heading + frame.detection_bearing
        x = frame.robot[0] + frame.detection_range * np.cos(bearing)
        y = frame.robot[1] + frame.detection_range * np.sin(bearing)
        visible = np.flatnonzero(frame.is_detection)
        detections.append([[int(frame.detection_type[i]), *_rounded(x[i], y[i])] for i in visible])
        probs = sentences.claim_probabilities(step.scene, frame)
        claim_probs.append(_rounded(*(probs.get(claim, 0.0) for claim in claims)))
    closing = narrative.closing(recording.last_scene, recording.at(-1), recording.result)
    if recording.end_reason:
        ended = sanitize(recording.end_reason).replace("_", " ")
        drove = f"It drove {float(recording.result.distance):.1f} m."
        closing = [f"{ended[:1].upper()}{ended[1:]}.", drove]
    return {
        "story": [narrative.opening(recording.scene)[1:] + story[0], *story[1:]],
        "headlines": [narrative.headline(step) for step in recording.steps],
        "closing": [] if is_under_way else closing,
        "objects": objects,
        "seen_types": sorted({obj[0] for rows in objects for obj in rows}),
        "detections": detections,
        "claim_shares": claim_probs,
        "news": frames.is_news.astype(bool).tolist(),
        "is_done": frames.is_done.astype(bool).tolist(),
    }


def _array_data(recording: Recording) -> dict[str, Any]:
    """Encode the large arrays with the sizes and scales needed to decode them."""
    frames = recording.frames
    mentions = np.flatnonzero(frames.is_hypothesised.any(axis=(0, 2)))
    is_valid = frames.is_hypothesised[:, mentions]
    x, y = frames.hypothesis_x[:, mentions], frames.hypothesis_y[:, mentions]
    types = np.where(is_valid, np.minimum(frames.mention_type[:, mentions], _UNNAMED), _NO_TYPE)
    max_weight = frames.weight.max(axis=1)
    grid_x, x_low, x_high = _quantize(x, is_valid)
    grid_y, y_low, y_high = _quantize(y, is_valid)
    relative = frames.weight / np.maximum(max_weight, 1e-12)[:, None]
    arrays = {
        "x": grid_x,
        "y": grid_y,
        "type": types.astype("u1"),
        "weight": np.round(65535 * np.clip(relative, 0.0, 1.0)).astype("<u2"),
        "max_weight": max_weight,
        "miss": np.round(255 * np.clip(frames.miss, 0.0, 1.0)).astype("u1"),
        "node_kind": frames.node_kind[0].astype("u1"),
        "regrounded": frames.num_regrounded,
        "ess": frames.effective_sample_size,
        "seen": frames.goal_mass.sum(axis=1),
        "unseen": frames.hypothesis_goal_mass.sum(axis=1),
        "explored": np.array([summary.explored_fraction(step.frame) for step in recording.steps]),
    }
    for name in (
        "position", "robot", "heading", "distance", "waypoint", "node_x", "node_y", "value",
        "goal_value", "information_value", "cost", "stop_mass",
    ):  # fmt: skip
        arrays[name] = getattr(frames, name)
    return {
        "num_mentions": len(mentions),
        "bounds": [x_low, x_high, y_low, y_high],
        "hypothesised_types": np.unique(types[is_valid]).astype(int).tolist(),
        "node_kinds": [_NODE_NAMES[code] for code in sorted(_NODE_NAMES)],
        "arrays": {name: _encode_array(array) for name, array in arrays.items()},
    }


def _quantize(values: np.ndarray, is_valid: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Quantize coordinates to a 16-bit grid; missing values become ``_ABSENT``."""
    low = float(values[is_valid].min()) if is_valid.any() else 0.0
    high = float(values[is_valid].max()) if is_valid.any() else 1.0
    high = max(high, low + 1e-3)
    scaled = np.clip((values - low) / (high - low), 0.0, 1.0)
    return np.where(is_valid, np.round(scaled * (_ABSENT - 1)), _ABSENT).astype("<u2"), low, high


def _encode_array(array: np.ndarray) -> dict[str, str]:
    """Encode an array as base64: u1 and u2 as they are, all else as f4."""
    array = np.asarray(array)
    dtype = array.dtype.str[1:] if array.dtype.str[1:] in ("u1", "u2") else "f4"
    data = np.ascontiguousarray(array, dtype=f"<{dtype}").tobytes()
    return {"kind": dtype, "data": base64.b64encode(data).decode("ascii")}


def _rounded(*values: float) -> list[float]:
    """Round values to three decimals: a millimetre, a tenth of a per cent."""
    return [round(float(value), 3) for value in values]


def write_report_files(recording: Recording, folder: Path | str) -> list[Path]:
    """Write figures of belief and value function, the interactive page and the narrative.

    belief.png, belief.svg, values.png, values.svg, episode.html and story.txt; the folder is made.
    ``MissingExtraError`` without matplotlib, before anything is written.
    """
    style.require("matplotlib")
    folder = Path(folder)
    paths = [
        *style.save(belief_figure(recording), folder / "belief"),
        *style.save(values_figure(recording), folder / "values"),
        write_html(recording, folder / "episode.html"),
    ]
    return [*paths, write_text("\n".join(narrate(recording)) + "\n", folder / "story.txt")]
