"""Validation of observations on the host: poses, areas, sensor models and detections.

The compiled filter checks the same limits (``semantic_map.gating``), but can only discard an
observation. Here errors are reported before anything is compiled: degrees for radians,
millimetres for metres, percent for fractions.
"""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxlangnav.inputs.limits import (
    FOV_SPAN,
    MAX_FALSE,
    MAX_METRES,
    MAX_WRONG,
    RANGES,
    bounded,
    number,
)
from jaxlangnav.inputs.object_types import ATTRIBUTES, attribute_code, group_of
from jaxlangnav.inputs.sanitize import closest, quote

SLOTS = (8, 16, 32, 64)
"""Padded numbers of detections; each has its own compiled program."""


def _type_index(name: Any, types: Sequence[str], what: str) -> int:
    if isinstance(name, str):
        if name in types:
            return types.index(name)
        hint = f"did you mean {near!r}? " if (near := closest(name, types)) else ""
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


def _check_polar(
    range_value: Any, bearing: Any, range_max: float, field_of_view: float, noise: float, what: str
) -> tuple[float, float]:
    """Validate one detection's range and bearing against its sensor model."""
    max_range = range_max + GATE_SIGMAS * noise + MIN_NOISE
    remedy = "give metres from the robot, as far as the sensor's range_max sees"
    metres = bounded(range_value, 0.0, max_range, f"{what}'s range", remedy)
    angle_remedy = "give radians in the robot's frame (degrees? use math.radians)"
    angle = bounded(bearing, -math.tau, math.tau, f"{what}'s bearing", angle_remedy)
    excess = abs(math.remainder(angle, math.tau)) - 0.5 * field_of_view
    if metres * math.sin(min(max(excess, 0.0), 0.5 * math.pi)) > GATE_SIGMAS * noise + MIN_NOISE:
        raise ValueError(
            f"{what}'s bearing is {angle:g} rad, but the field of view of {field_of_view:g} rad "
            f"ends at {0.5 * field_of_view:g}: {angle_remedy}, or widen the sensor's field_of_view"
        )
    return metres, angle


def _attribute_code(attributes: Any, what: str) -> int:
    """Encode the attributes of a detection, given as words by group."""
    if attributes is None:
        return 0
    if not isinstance(attributes, Mapping):
        raise ValueError(
            f"{what}'s attributes are {quote(attributes)}, but must be by their groups, as in "
            '{"colour": "red"}'
        )
    for group, word in attributes.items():
        if not isinstance(word, str) or group_of(word) != group:
            expected = f"attributes are compared by {', '.join(ATTRIBUTES)}"
            if group in ATTRIBUTES:
                expected = f"must be one of {', '.join(ATTRIBUTES[group])}"
            raise ValueError(f"{what}'s {quote(group)} is {quote(word)}, but {expected}")
    return attribute_code(*attributes.values())


def padded_size(count: int) -> int:
    """Return the smallest of ``SLOTS`` for a number of detections; ValueError if none suffices."""
    slots = next((slots for slots in SLOTS if count <= slots), None)
    if slots is None:
        raise ValueError(
            f"more than {SLOTS[-1]} detections in one look, but at most {SLOTS[-1]} are held: "
            "leave out those of types that the task does not speak of"
        )
    return slots


def detection_arrays(
    detections: Iterable[Sequence[Any]], sensor: Sequence[np.float32], types: Sequence[str]
) -> dict[str, np.ndarray]:
    """Validate detections against their sensor model, and pad them.

    Args as of ``Observation.of``, but ``sensor`` is as returned by ``validate_sensor``.

    Returns:
        Arrays of 8, 16, 32 or 64 slots on the host, by the fields of ``Observation``; the type is
        −1 in empty ones.

    Raises:
        ValueError: names the detection, the value, the limit and the remedy.
    """
    range_max, field_of_view, _, noise, *_ = (float(value) for value in sensor)
    rows = _bounded_list(detections, SLOTS[-1] + 1)
    if rows is None:
        raise ValueError(
            f"detections is {quote(detections)}, but must be a list of (type, range, bearing)"
        )
    slots = padded_size(len(rows))
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
        object_type, metres, bearing, attributes = [*row, None][:4]
        index = _type_index(object_type, types, what)
        polar = _check_polar(metres, bearing, range_max, field_of_view, noise, what)
        table[slot] = index, *polar, _attribute_code(attributes, what)
    return {
        "detection_type": table[:, 0].astype(np.int32),
        "detection_range": table[:, 1].astype(np.float32),
        "detection_bearing": table[:, 2].astype(np.float32),
        "is_detection": np.arange(slots) < len(rows),
        "detection_attribute": table[:, 3].astype(np.int32),
    }


TYPES = ("hydrant", "cone", "car", "building", "tree", "bench", "barrel", "box")
"""Object types of the shipped lexicon, by type index."""
MAX_ANGLE = 4.0 * np.pi
"""Limit of angles, radians, either way; more than half a turn, for unwrapped headings."""
GATE_SIGMAS = 6.0
"""Gate, in standard deviations of the noise, for detections beyond the range or field of view."""
MIN_NOISE = 0.01
"""Metres; lower bound of the sensor noise, which prevents division by zero."""


def validate_sensor(
    range_max: Any,
    field_of_view: Any,
    detection_probability: Any,
    noise: Any,
    false_detections: Any = 0.0,
    mislabelled: Any = 0.0,
) -> tuple[np.float32, ...]:
    """Validate a sensor model's parameters, as of ``SensorParams``.

    Returns:
        All of them, in this order, as f32.

    Raises:
        ValueError: names the value, the limits and the remedy.
    """
    remedy = "give a share, 0.95 for 95 percent"
    max_range = bounded(range_max, *RANGES, "range_max", "give metres")
    angle_remedy = "give radians, math.radians(90) for 90 degrees"
    fov = bounded(field_of_view, *FOV_SPAN, "field_of_view", angle_remedy)
    p_detect = bounded(detection_probability, 0.0, 1.0, "detection_probability", remedy)
    if p_detect == 0.0:
        raise ValueError(
            "detection_probability is 0, but must be above 0: a detector that never sees anything "
            "tells nothing"
        )
    std = bounded(noise, 0.0, max_range, "noise", "give metres, less than the range")
    per_scan = "give how many to expect in one look"
    clutter = bounded(false_detections, 0.0, MAX_FALSE, "false_detections", per_scan)
    fraction = "give a share, 0.1 for 10 percent"
    p_wrong = bounded(mislabelled, 0.0, MAX_WRONG, "mislabelled", fraction)
    return tuple(map(np.float32, (max_range, fov, p_detect, std, clutter, p_wrong)))


_ORIGIN = "give metres from the map's origin"


def _bounded_list(values: Any, limit: int) -> list[Any] | None:
    """Read at most ``limit`` items, for an iterable may be infinite; None if it is not a list."""
    try:
        is_list = not isinstance(values, str | bytes | Mapping)
        return list(itertools.islice(iter(values), limit)) if is_list else None
    except TypeError:
        return None


def _fixed_list(values: Any, count: int, what: str, remedy: str) -> list[Any]:
    items = _bounded_list(values, count + 1)
    if items is None or len(items) != count:
        raise ValueError(f"{what} is {quote(values)}, but must be {remedy}")
    return items


def validate_pose(pose: Sequence[Any]) -> np.ndarray:
    """Validate a pose (x, y, heading), metres and radians, map frame: f32[3].

    Raises:
        ValueError: not three finite numbers, far from the map's origin, or a heading that looks
            like degrees.
    """
    x, y, angle = _fixed_list(pose, 3, "pose", "(x, y, heading), in metres and radians")
    x = bounded(x, -MAX_METRES, MAX_METRES, "pose's x", _ORIGIN)
    y = bounded(y, -MAX_METRES, MAX_METRES, "pose's y", _ORIGIN)
    wrap = "give radians, wrapped to one turn (degrees? use math.radians)"
    heading = bounded(angle, -MAX_ANGLE, MAX_ANGLE, "pose's heading", wrap)
    return np.array([x, y, heading], np.float32)


def validate_area(area: Sequence[Any]) -> np.ndarray:
    """Validate an operating area, x_min, x_max, y_min, y_max, metres, map frame: f32[4].

    Raises:
        ValueError: not four finite numbers, or far from the map's origin.
    """
    names = ("x_min", "x_max", "y_min", "y_max")
    items = _fixed_list(area, 4, "area", f"({', '.join(names)}), in metres")
    pairs = zip(names, items, strict=True)
    bounds = [bounded(x, -MAX_METRES, MAX_METRES, f"area's {name}", _ORIGIN) for name, x in pairs]
    return np.array(bounds, np.float32)
