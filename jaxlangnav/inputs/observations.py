"""What a robot may report: the limits of poses, areas and sensors, held on the host.

The belief holds every look against the same limits in its compiled program
(``semantic_map.gating``), where it can only leave the look out. Here, before anything is
compiled, a mistake is named: degrees for radians, millimetres for metres, percent for a share.
"""

import difflib
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxlangnav.inputs.limits import (
    FARTHEST,
    MOST_FALSE,
    MOST_WRONG,
    RANGES,
    VIEWS,
    bounded,
    number,
)
from jaxlangnav.inputs.object_types import ATTRIBUTES, attribute_code, group_of
from jaxlangnav.inputs.sanitize import quote

SLOTS = (8, 16, 32, 64)
"""Sizes to which detections are padded: each has a compiled program of its own."""


def _type_index(name: Any, types: Sequence[str], what: str) -> int:
    if isinstance(name, str):
        if name in types:
            return types.index(name)
        near = difflib.get_close_matches(name, types, 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise ValueError(
            f"{what} is of type {quote(name)}, which is none of {', '.join(types)}: {hint}"
            "pass types=navigator.type_names where the navigator has types of its own"
        )
    try:
        index = number(name, f"{what}'s type")
    except ValueError:
        raise ValueError(
            f"{what}'s type is {quote(name)}, but must be a name (a text) or the index of one"
        ) from None
    if index != int(index) or not 0 <= index < len(types):
        raise ValueError(
            f"{what} has the type index {index:g}, but must be one of 0 to {len(types) - 1}: "
            f"{', '.join(types)}"
        )
    return int(index)


def _polar(
    metres: Any, bearing: Any, range_max: float, field_of_view: float, noise: float, what: str
) -> tuple[float, float]:
    """Hold one detection's range and bearing against its sensor."""
    reach = range_max + DEVIATIONS * noise + MIN_NOISE
    remedy = "give metres from the robot, as far as the sensor's range_max sees"
    away = bounded(metres, 0.0, reach, f"{what}'s range", remedy)
    turned = "give radians in the robot's frame (degrees? use math.radians)"
    angle = bounded(bearing, -math.tau, math.tau, f"{what}'s bearing", turned)
    beyond = abs(math.remainder(angle, math.tau)) - 0.5 * field_of_view
    if away * math.sin(min(max(beyond, 0.0), 0.5 * math.pi)) > DEVIATIONS * noise + MIN_NOISE:
        raise ValueError(
            f"{what}'s bearing is {angle:g} rad, but the field of view of {field_of_view:g} rad "
            f"ends at {0.5 * field_of_view:g}: {turned}, or widen the sensor's field_of_view"
        )
    return away, angle


def _attribute_code(looks: Any, what: str) -> int:
    """Read what is known of how a thing looks: its words by their groups, in one code."""
    if looks is None:
        return 0
    if not isinstance(looks, Mapping):
        raise ValueError(
            f"{what}'s attributes are {quote(looks)}, but must be by their groups, as in "
            '{"colour": "red"}'
        )
    for group, word in looks.items():
        if not isinstance(word, str) or group_of(word) != group:
            known = f"attributes are compared by {', '.join(ATTRIBUTES)}"
            if group in ATTRIBUTES:
                known = f"must be one of {', '.join(ATTRIBUTES[group])}"
            raise ValueError(f"{what}'s {quote(group)} is {quote(word)}, but {known}")
    return attribute_code(*looks.values())


def padded(count: int) -> int:
    """Find the least of ``SLOTS`` that holds so many detections; ValueError where none does."""
    slots = next((slots for slots in SLOTS if count <= slots), None)
    if slots is None:
        raise ValueError(
            f"more than {SLOTS[-1]} detections in one look, but at most {SLOTS[-1]} are held: "
            "leave out those of types that the task does not speak of"
        )
    return slots


def detected(
    detections: Iterable[Sequence[Any]], sensor: Sequence[np.float32], types: Sequence[str]
) -> dict[str, np.ndarray]:
    """Hold detections against their sensor, and pad them.

    Args as of ``Observation.of``, but that ``sensor`` is as of ``sensor_numbers``.

    Returns:
        Arrays of 8, 16, 32 or 64 slots on the host, by the fields of ``Observation``; the type is
        −1 in empty ones.

    Raises:
        ValueError: names the detection, the value, the limit and the remedy.
    """
    range_max, field_of_view, _, noise, *_ = (float(one) for one in sensor)
    rows = _listed(detections, SLOTS[-1] + 1)
    if rows is None:
        raise ValueError(
            f"detections is {quote(detections)}, but must be a list of (type, range, bearing)"
        )
    slots = padded(len(rows))
    table = np.tile([-1.0, 0.0, 0.0, 0.0], (slots, 1))
    for slot, row in enumerate(rows):
        what = f"detection {slot + 1}"
        is_array = isinstance(row, np.ndarray) and row.ndim == 1
        is_row = is_array or (isinstance(row, Sequence) and not isinstance(row, str | bytes))
        if not is_row or len(row) not in (3, 4):
            raise ValueError(
                f"{what} is {quote(row, 60)}, but must be (type, range, bearing), or with how it "
                'looks (type, range, bearing, {"colour": "red"})'
            )
        kind, metres, bearing, looks = [*row, None][:4]
        index = _type_index(kind, types, what)
        polar = _polar(metres, bearing, range_max, field_of_view, noise, what)
        table[slot] = index, *polar, _attribute_code(looks, what)
    return {
        "detection_type": table[:, 0].astype(np.int32),
        "detection_range": table[:, 1].astype(np.float32),
        "detection_bearing": table[:, 2].astype(np.float32),
        "is_detection": np.arange(slots) < len(rows),
        "detection_attribute": table[:, 3].astype(np.int32),
    }


TYPES = ("hydrant", "cone", "car", "building", "tree", "bench", "barrel", "box")
"""The object types of the shipped lexicon, by type index."""
TURNS = 4.0 * np.pi
"""Radians of a bearing, either way; headings that are not wrapped make it more than half a turn."""
DEVIATIONS = 6.0
"""Standard deviations of the noise by which a detection may lie out of range or out of view."""
MIN_NOISE = 0.01
"""Metres; a sensor without noise is taken to be this good, so that no division is by zero."""


def sensor_numbers(
    range_max: Any,
    field_of_view: Any,
    detection_probability: Any,
    noise: Any,
    false_detections: Any = 0.0,
    mislabelled: Any = 0.0,
) -> tuple[np.float32, ...]:
    """Hold a detector's specification, as of ``SensorParams``, against what it can be.

    Returns:
        All of them, in this order, as f32.

    Raises:
        ValueError: names the value, the limits and the remedy.
    """
    share = "give a share, 0.95 for 95 percent"
    reach = bounded(range_max, *RANGES, "range_max", "give metres")
    degrees = "give radians, math.radians(90) for 90 degrees"
    view = bounded(field_of_view, *VIEWS, "field_of_view", degrees)
    seen = bounded(detection_probability, 0.0, 1.0, "detection_probability", share)
    if seen == 0.0:
        raise ValueError(
            "detection_probability is 0, but must be above 0: a detector that never sees anything "
            "tells nothing"
        )
    errs = bounded(noise, 0.0, reach, "noise", "give metres, less than the range")
    most = "give how many to expect in one look"
    false = bounded(false_detections, 0.0, MOST_FALSE, "false_detections", most)
    rate = "give a share, 0.1 for 10 percent"
    wrong = bounded(mislabelled, 0.0, MOST_WRONG, "mislabelled", rate)
    return tuple(map(np.float32, (reach, view, seen, errs, false, wrong)))


_NEAR = "give metres from the map's origin"


def _listed(values: Any, most: int) -> list[Any] | None:
    """Read a list as far as it may go, for it may have no end; None of what is no list."""
    try:
        is_list = not isinstance(values, str | bytes | Mapping)
        return list(itertools.islice(iter(values), most)) if is_list else None
    except TypeError:
        return None


def _parts(values: Any, number_of: int, what: str, remedy: str) -> list[Any]:
    parts = _listed(values, number_of + 1)
    if parts is None or len(parts) != number_of:
        raise ValueError(f"{what} is {quote(values)}, but must be {remedy}")
    return parts


def pose_numbers(pose: Sequence[Any]) -> np.ndarray:
    """Hold a pose (x, y, heading), metres and radians, map frame, against what it can be: f32[3].

    Raises:
        ValueError: not three finite numbers, far from the map's origin, or a heading that looks
            like degrees.
    """
    x, y, turned = _parts(pose, 3, "pose", "(x, y, heading), in metres and radians")
    x = bounded(x, -FARTHEST, FARTHEST, "pose's x", _NEAR)
    y = bounded(y, -FARTHEST, FARTHEST, "pose's y", _NEAR)
    wrap = "give radians, wrapped to one turn (degrees? use math.radians)"
    heading = bounded(turned, -TURNS, TURNS, "pose's heading", wrap)
    return np.array([x, y, heading], np.float32)


def area_numbers(area: Sequence[Any]) -> np.ndarray:
    """Read an operating area, x_min, x_max, y_min, y_max, metres, map frame: f32[4].

    Raises:
        ValueError: not four finite numbers, or far from the map's origin.
    """
    names = ("x_min", "x_max", "y_min", "y_max")
    parts = _parts(area, 4, "area", f"({', '.join(names)}), in metres")
    named = zip(names, parts, strict=True)
    bounds = [bounded(one, -FARTHEST, FARTHEST, f"area's {name}", _NEAR) for name, one in named]
    return np.array(bounds, np.float32)
