"""What a detector reports of one look: rows by hand into padded arrays, each checked (host only).

A row is (type, range, bearing), or with how the thing looks (type, range, bearing, attributes).
"""

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxlangnav.kinds import ATTRIBUTES, attributes, group_of
from jaxlangnav.sensing import DEVIATIONS, MIN_NOISE, bounded, first, number, said

SLOTS = (8, 16, 32, 64)
"""Sizes to which detections are padded: each has a compiled program of its own."""


class Detected(NamedTuple):
    """Detections in padded arrays on the host."""

    kind: np.ndarray  # i32[D] type index; −1 in empty slots
    range: np.ndarray  # f32[D] metres
    bearing: np.ndarray  # f32[D] radians, robot frame
    is_detection: np.ndarray  # bool[D]
    attribute: np.ndarray  # i32[D] codes of ``kinds.attributes``; 0 where nothing is known


def _type_index(name: Any, types: Sequence[str], what: str) -> int:
    """Find a type by its name, or check its index."""
    if isinstance(name, str):
        if name in types:
            return types.index(name)
        near = difflib.get_close_matches(name, types, 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise ValueError(
            f"{what} is of type {said(name)}, which is none of {', '.join(types)}: {hint}"
            "pass types=navigator.type_names where the navigator has types of its own"
        )
    try:
        index = number(name, f"{what}'s type")
    except ValueError:
        raise ValueError(
            f"{what}'s type is {said(name)}, but must be a name (a text) or the index of one"
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
            f"{what}'s attributes are {said(looks)}, but must be by their groups, as in "
            '{"colour": "red"}'
        )
    for group, word in looks.items():
        if not isinstance(word, str) or group_of(word) != group:
            raise ValueError(f"{what}'s {said(group)} is {said(word)}, {_words_in(group)}")
    return attributes(*looks.values())


def _words_in(group: Any) -> str:
    """Say which attributes there are, of a group or at all."""
    if group in ATTRIBUTES:
        return f"but must be one of {', '.join(ATTRIBUTES[group])}"
    return f"but attributes are compared by {', '.join(ATTRIBUTES)}"


def padded(count: int) -> int:
    """Tell to how many slots so many detections are padded.

    Args:
        count: detections of one look.

    Returns:
        The least of ``SLOTS`` that holds them.

    Raises:
        ValueError: more than the largest.
    """
    for slots in SLOTS:
        if count <= slots:
            return slots
    raise ValueError(
        f"more than {SLOTS[-1]} detections in one look, but at most {SLOTS[-1]} are held: "
        "leave out those of types that the task does not speak of"
    )


def detected(
    detections: Iterable[Sequence[Any]],
    sensor: Sequence[np.float32],
    types: Sequence[str],
) -> Detected:
    """Hold detections against their sensor, and pad them.

    Args:
        detections: (type, range, bearing) each: a type by name or index; metres; radians, robot
            frame, counter-clockwise from the heading; perhaps a fourth entry, how it looks:
            attributes by their groups.
        sensor: as of ``sensor_numbers``.
        types: names of object types; a type index is an index into them.

    Returns:
        Arrays of 8, 16, 32 or 64 slots.

    Raises:
        ValueError: names the detection, the value, the limit and the remedy.
    """
    range_max, field_of_view, _, noise, *_ = (float(one) for one in sensor)
    try:
        is_list = not isinstance(detections, str | bytes | Mapping)
        rows = first(detections, SLOTS[-1] + 1) if is_list else None
    except TypeError:
        rows = None
    if rows is None:
        raise ValueError(
            f"detections is {said(detections)}, but must be a list of (type, range, bearing)"
        )
    slots = padded(len(rows))
    found = Detected(
        np.full(slots, -1, np.int32),
        np.zeros(slots, np.float32),
        np.zeros(slots, np.float32),
        np.arange(slots) < len(rows),
        np.zeros(slots, np.int32),
    )
    for slot, row in enumerate(rows):
        what = f"detection {slot + 1}"
        kind, metres, bearing, looks = _entries(row, what)
        found.kind[slot] = _type_index(kind, types, what)
        found.range[slot], found.bearing[slot] = _polar(
            metres, bearing, range_max, field_of_view, noise, what
        )
        found.attribute[slot] = _attribute_code(looks, what)
    return found


def _entries(row: Any, what: str) -> list[Any]:
    """Take a detection apart: type, range, bearing, and how it looks or None."""
    is_array = isinstance(row, np.ndarray) and row.ndim == 1
    is_row = is_array or (isinstance(row, Sequence) and not isinstance(row, str | bytes))
    entries = list(row) if is_row and len(row) in (3, 4) else []
    if len(entries) not in (3, 4):
        raise ValueError(
            f"{what} is {said(row, 60)}, but must be (type, range, bearing), or with how it looks "
            '(type, range, bearing, {"colour": "red"})'
        )
    return [*entries, None][:4]
