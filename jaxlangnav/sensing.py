"""What a robot may report: the limits of poses, sensors and detections, held on the host.

The belief holds every look against the same limits in its compiled program
(``semantic_map.soundness``), where it can only leave the look out. Here, before anything is
compiled, a mistake is named: degrees for radians, millimetres for metres, percent for a share.
"""

import difflib
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

TYPES = ("hydrant", "cone", "car", "building", "tree", "bench", "barrel", "box")
"""The object types of the shipped lexicon, by type index."""
RANGES = (0.01, 1e4)
"""Metres, shortest and longest sensing range."""
VIEWS = (1e-3, 2.0 * np.pi + 1e-3)
"""Radians, narrowest and widest field of view."""
TURNS = 4.0 * np.pi
"""Radians of a bearing, either way; headings that are not wrapped make it more than half a turn."""
DEVIATIONS = 6.0
"""Standard deviations of the noise by which a detection may lie out of range or out of view."""
MIN_NOISE = 0.01
"""Metres; a sensor without noise is taken to be this good, so that no division is by zero."""
MOST_FALSE, MOST_WRONG = 100.0, 0.99
"""False detections of one type expected in a look; share of wrong labels."""
SLOTS = (8, 16, 32, 64)
"""Sizes to which detections are padded: each has a compiled program of its own."""


class Detected(NamedTuple):
    """Detections in padded arrays on the host."""

    kind: np.ndarray  # i32[D] type index; −1 in empty slots
    range: np.ndarray  # f32[D] metres
    bearing: np.ndarray  # f32[D] radians, robot frame
    is_detection: np.ndarray  # bool[D]


def number(value: Any, what: str) -> float:
    """Read a finite number.

    Args:
        value: a number, or an array of one.
        what: what it is, for the refusal.

    Returns:
        The number.

    Raises:
        ValueError: it is none, or not finite; one line.
    """
    try:
        read = float(np.asarray(value).reshape(()))
    except (TypeError, ValueError):
        raise ValueError(f"{what} is {str(value)[:40]!r}, but must be a number") from None
    if not math.isfinite(read):
        raise ValueError(f"{what} is {read}, but must be finite")
    return read


def _between(value: Any, low: float, high: float, what: str, remedy: str) -> float:
    """Read a number between two bounds."""
    read = number(value, what)
    if not low <= read <= high:
        raise ValueError(f"{what} is {read:g}, but must lie between {low:g} and {high:g}: {remedy}")
    return read


def sensor_numbers(
    range_max: Any,
    field_of_view: Any,
    detection_probability: Any,
    noise: Any,
    false_detections: Any = 0.0,
    mislabelled: Any = 0.0,
) -> tuple[np.float32, ...]:
    """Hold a detector's specification against what it can be.

    Args:
        range_max: metres.
        field_of_view: radians, full opening angle.
        detection_probability: from 0 to 1.
        noise: metres, standard deviation on each axis.
        false_detections: expected in one look, of each type.
        mislabelled: share of detections with a wrong type.

    Returns:
        All of them, in this order, as f32.

    Raises:
        ValueError: names the value, the limits and the remedy.
    """
    reach = _between(range_max, *RANGES, "range_max", "give metres")
    degrees = "give radians, math.radians(90) for 90 degrees"
    view = _between(field_of_view, *VIEWS, "field_of_view", degrees)
    share = "give a share, 0.95 for 95 percent"
    seen = _between(detection_probability, 0.0, 1.0, "detection_probability", share)
    errs = _between(noise, 0.0, reach, "noise", "give metres, less than the range")
    most = "give how many to expect in one look"
    false = _between(false_detections, 0.0, MOST_FALSE, "false_detections", most)
    rate = "give a share, 0.1 for 10 percent"
    wrong = _between(mislabelled, 0.0, MOST_WRONG, "mislabelled", rate)
    return tuple(np.float32(one) for one in (reach, view, seen, errs, false, wrong))


def pose_numbers(pose: Sequence[Any]) -> np.ndarray:
    """Hold a pose against what it can be.

    Args:
        pose: x, y, heading, metres and radians, map frame.

    Returns:
        f32[3].

    Raises:
        ValueError: not three finite numbers, or a heading that looks like degrees.
    """
    if np.shape(pose) != (3,):
        raise ValueError(
            f"pose has the shape {np.shape(pose)}, but must be (x, y, heading), "
            "in metres and radians"
        )
    x, y, heading = (
        number(one, f"pose's {name}") for one, name in zip(pose, ("x", "y", "heading"), strict=True)
    )
    wrap = "give radians, wrapped to one turn (degrees? use math.radians)"
    _between(heading, -TURNS, TURNS, "pose's heading", wrap)
    return np.array([x, y, heading], np.float32)


def _type_index(name: Any, types: Sequence[str], what: str) -> int:
    """Find a type by its name, or check its index."""
    if isinstance(name, str):
        if name in types:
            return types.index(name)
        near = difflib.get_close_matches(name, types, 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise ValueError(
            f"{what} is of type {name[:40]!r}, which is none of {', '.join(types)}: {hint}"
            "pass types=navigator.type_names where the navigator has types of its own"
        )
    index = number(name, f"{what}'s type")
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
    away = _between(metres, 0.0, reach, f"{what}'s range", remedy)
    turned = "give radians in the robot's frame (degrees? use math.radians)"
    angle = _between(bearing, -math.tau, math.tau, f"{what}'s bearing", turned)
    beyond = abs(math.remainder(angle, math.tau)) - 0.5 * field_of_view
    if away * math.sin(min(max(beyond, 0.0), 0.5 * math.pi)) > DEVIATIONS * noise + MIN_NOISE:
        raise ValueError(
            f"{what}'s bearing is {angle:g} rad, but the field of view of {field_of_view:g} rad "
            f"ends at {0.5 * field_of_view:g}: {turned}, or widen the sensor's field_of_view"
        )
    return away, angle


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
        f"{count} detections in one look, but at most {SLOTS[-1]} are held: "
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
            frame, counter-clockwise from the heading.
        sensor: as of ``sensor_numbers``.
        types: names of object types; a type index is an index into them.

    Returns:
        Arrays of 8, 16, 32 or 64 slots.

    Raises:
        ValueError: names the detection, the value, the limit and the remedy.
    """
    range_max, field_of_view, _, noise, *_ = (float(one) for one in sensor)
    if isinstance(detections, str) or not isinstance(detections, Iterable):
        raise ValueError(
            f"detections is {str(detections)[:40]!r}, but must be a list of (type, range, bearing)"
        )
    rows = [tuple(one) if isinstance(one, Sequence) else one for one in detections]
    slots = padded(len(rows))
    found = Detected(
        np.full(slots, -1, np.int32),
        np.zeros(slots, np.float32),
        np.zeros(slots, np.float32),
        np.arange(slots) < len(rows),
    )
    for slot, row in enumerate(rows):
        what = f"detection {slot + 1}"
        if not isinstance(row, tuple) or len(row) != 3:
            raise ValueError(f"{what} is {str(row)[:60]}, but must be (type, range, bearing)")
        found.kind[slot] = _type_index(row[0], types, what)
        found.range[slot], found.bearing[slot] = _polar(
            row[1], row[2], range_max, field_of_view, noise, what
        )
    return found
