"""An episode as one web page that opens offline in any browser: slider, map, numbers, story.

The page stands in ``recording.html``; this module packs the recording into it. Large arrays go
in as base64 of little-endian numbers: positions of hypotheses on a 16-bit grid over the map
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
from jaxlangnav.grounding.instruction import GroundingModel
from jaxlangnav.inputs.sanitize import sanitize
from jaxlangnav.inputs.whole_files import write_text
from jaxlangnav.language.phrase import Parse
from jaxlangnav.messages import NONE
from jaxlangnav.planner.graph import FRONTIER, OBJECT_NODE, VISITED
from jaxlangnav.viz import narrative, panels, sentences, style, summary
from jaxlangnav.viz.graph import graph_figure
from jaxlangnav.viz.narrative import narrate
from jaxlangnav.viz.panels import belief_figure, values_figure
from jaxlangnav.viz.sentences import describe_readings, percent

_ABSENT = 65535  # grid coordinate of a hypothesis that is none
_NODES = {FRONTIER: "frontier", VISITED: "visited place", OBJECT_NODE: "object"}
_UNNAMED, _NO_TYPE = 254, 255
"""Types of a hypothesis in one byte: what has no name of its own, and none at all."""


def write_html(recording: Recording, path: Path | str) -> Path:
    """Write an episode as a self-contained page; folders are made."""
    return write_text(_render_html(recording), Path(path))


def _render_html(recording: Recording) -> str:
    return fill_page(recording.scene.text or "Episode", page_data(recording))


def fill_page(title: str, data: Any, *, controls: str = "", connect: str = "") -> str:
    """Fill the page of an episode.

    Args:
        title: of the window.
        data: of ``page_data``; None for a page that a script of its ``controls`` fills.
        controls: HTML above the episode.
        connect: of the content security policy: where the page may connect to, nowhere if empty.
    """
    template = resources.files("jaxlangnav.viz") / "recording.html"
    # Inside a script element only "</" and "<!--" could end the data early. In one pass, as the
    # sentence itself may hold the name of a place to be filled.
    parts = {
        "__TITLE__": html.escape(sanitize(title)),
        "__DATA__": page_json(data).replace("<", "\\u003c"),
        "__CONTROLS__": controls,
        "__CONNECT__": f"; connect-src {connect}" if connect else "",
    }
    page = template.read_text(encoding="utf-8")
    return re.sub("|".join(parts), lambda found: parts[found[0]], page)


def page_json(data: Any) -> str:
    """Write what a page reads as JSON, as short as it goes."""
    return json.dumps(data, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def page_data(recording: Recording, *, is_under_way: bool = False) -> dict[str, Any]:
    """Gather everything the page shows, in JSON's own types.

    Args:
        recording: the episode, as far as it has come.
        is_under_way: it goes on: how it ends cannot be told yet.
    """
    scene, frames, world = recording.scene, recording.frames, recording.scene.scenario
    claims = describe_readings(scene, least=0.005)
    # What the words are taken to say, first and after each utterance under way.
    scenes = [scene, *(one.scene for one in recording.said if one.scene is not None)]
    told = (describe_readings(one, least=0.005) for one in scenes)
    all_claims = list(dict.fromkeys(claim for listed in told for claim, _ in listed))
    first = [f"Taken to say that there is {claim} ({percent(p)})." for claim, p in claims[:1]]
    return {
        "text": sanitize(scene.text),
        "summary": " ".join(
            first if is_under_way else [*first, f"The {panels.verdict(recording)}."]
        ),
        "outcome": "under way" if is_under_way else panels.outcome(recording),
        "is_under_way": is_under_way,
        "num_steps": recording.num_steps,
        "num_particles": recording.num_particles,
        "num_nodes": int(frames.value.shape[1]),
        "num_cells": int(frames.miss.shape[-1]),
        "area": list(scene.area),
        "range": float(scene.sensor.range_max),
        "field_of_view": float(scene.sensor.field_of_view),
        "goal": [float(one) for one in scene.scenario.goal] if scene.is_judged else None,
        "success_radius": scene.stop_radius,
        "walls": scene.walls.tolist(),
        "truth": [
            {
                "type": int(world.object_type[slot]),
                "x": float(world.object_x[slot]),
                "y": float(world.object_y[slot]),
            }
            for slot in np.flatnonzero(world.is_object)
        ],
        "value_stops": [
            [int(stop[place : place + 2], 16) for place in (1, 3, 5)] for stop in style.VALUE_STOPS
        ],
        "types": [
            {"name": name, "color": style.type_color(kind), "shape": style.type_marker(kind)}
            for kind, name in enumerate(scene.type_names)
        ],
        "claims": all_claims,
        "pictures": [
            {title: base64.b64encode(one).decode("ascii") for title, one in step.items()}
            for step in recording.pictures
        ],
        **_by_step(recording, all_claims, is_under_way=is_under_way),
        **_arrays(recording),
    }


def _by_step(recording: Recording, claims: list[str], *, is_under_way: bool) -> dict[str, Any]:
    """Gather what is short enough to stand in the page as it is: the story, objects, events."""
    frames = recording.frames
    story = [narrative.tell_step(moment) for moment in recording.moments]
    objects, detections, shares = [], [], []
    for moment in recording.moments:
        frame = moment.frame
        seen = [
            [one.object_type, *_short(one.x, one.y, one.spread, one.probability, one.goal_mass)]
            for one in summary.seen_objects(frame)
        ]
        objects.append(seen)
        bearing = frame.heading + frame.detection_bearing
        x = frame.robot[0] + frame.detection_range * np.cos(bearing)
        y = frame.robot[1] + frame.detection_range * np.sin(bearing)
        looks = np.flatnonzero(frame.is_detection)
        detections.append([[int(frame.detection_type[i]), *_short(x[i], y[i])] for i in looks])
        now = sentences.claim_shares(moment.scene, frame)
        shares.append(_short(*(now.get(claim, 0.0) for claim in claims)))
    closing = narrative.closing(recording.last_scene, recording.at(-1), recording.result)
    if recording.ended:
        said = sanitize(recording.ended).replace("_", " ")
        drove = f"It drove {float(recording.result.distance):.1f} m."
        closing = [f"{said[:1].upper()}{said[1:]}.", drove]
    if is_under_way:
        closing = []
    return {
        "story": [narrative.opening(recording.scene)[1:] + story[0], *story[1:]],
        "headlines": [narrative.headline(moment) for moment in recording.moments],
        "closing": closing,
        "objects": objects,
        "detections": detections,
        "claim_shares": shares,
        "news": [bool(one) for one in frames.is_news],
        "is_done": [bool(one) for one in frames.is_done],
    }


def _arrays(recording: Recording) -> dict[str, Any]:
    """Pack the large arrays, and the sizes and scales needed to read them."""
    frames = recording.frames
    used = np.flatnonzero(frames.is_hypothesised.any(axis=(0, 2)))
    is_in = frames.is_hypothesised[:, used]
    x, y = frames.hypothesis_x[:, used], frames.hypothesis_y[:, used]
    kinds = np.where(is_in, np.minimum(frames.mention_type[:, used], _UNNAMED), _NO_TYPE)
    heaviest = frames.weight.max(axis=1)
    grid_x, x_low, x_high = _on_grid(x, is_in)
    grid_y, y_low, y_high = _on_grid(y, is_in)
    seen = frames.object_type[frames.object_type != NONE]
    relative = frames.weight / np.maximum(heaviest, 1e-12)[:, None]
    arrays = {
        "x": grid_x,
        "y": grid_y,
        "type": kinds.astype("u1"),
        "weight": np.round(65535 * np.clip(relative, 0.0, 1.0)).astype("<u2"),
        "heaviest": heaviest,
        "miss": np.round(255 * np.clip(frames.miss, 0.0, 1.0)).astype("u1"),
        "node_kind": frames.node_kind[0].astype("u1"),
        "regrounded": frames.num_regrounded,
        "ess": frames.effective_sample_size,
        "seen": frames.goal_mass.sum(axis=1),
        "unseen": frames.hypothesis_goal_mass.sum(axis=1),
        "explored": np.array([summary.explored_share(one.frame) for one in recording.moments]),
    }
    for name in (
        "position", "robot", "heading", "distance", "waypoint", "node_x", "node_y", "value",
        "goal_value", "information_value", "cost", "stop_mass",
    ):  # fmt: skip
        arrays[name] = getattr(frames, name)
    return {
        "num_mentions": len(used),
        "frame": [x_low, x_high, y_low, y_high],
        "thought_types": [int(one) for one in np.unique(kinds[is_in])],
        "seen_types": [int(one) for one in np.unique(seen)],
        "node_kinds": [_NODES[kind] for kind in sorted(_NODES)],
        "arrays": {name: _encode(array) for name, array in arrays.items()},
    }


def _on_grid(values: np.ndarray, is_in: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Round coordinates to a 16-bit grid; what is not there gets ``_ABSENT``."""
    low = float(values[is_in].min()) if is_in.any() else 0.0
    high = float(values[is_in].max()) if is_in.any() else 1.0
    high = max(high, low + 1e-3)
    share = np.clip((values - low) / (high - low), 0.0, 1.0)
    grid = np.where(is_in, np.round(share * (_ABSENT - 1)), _ABSENT).astype("<u2")
    return grid, low, high


def _encode(array: np.ndarray) -> dict[str, str]:
    """Encode an array as base64; anything but small integers as 32-bit floats."""
    array = np.asarray(array)
    kind = array.dtype.str[1:] if array.dtype.str[1:] in ("u1", "u2") else "f4"
    data = np.ascontiguousarray(array, dtype=f"<{kind}").tobytes()
    return {"kind": kind, "data": base64.b64encode(data).decode("ascii")}


def _short(*values: float) -> list[float]:
    """Round to a millimetre or a tenth of a per cent: nobody reads more."""
    return [round(float(value), 3) for value in values]


def write_pictures(recording: Recording, folder: Path | str) -> list[Path]:
    """Write belief and value function over time, the interactive recording, and the story.

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


def write_graph(
    parse: Parse, model: GroundingModel, folder: Path | str, *, name: str = "graph"
) -> list[Path]:
    """Write the factor graph of a sentence, such as ``Understanding.parse``, as PNG and SVG."""
    return [*style.save(graph_figure(parse, model), Path(folder) / name)]
