"""What a robot may report: the limits of poses, areas and sensors, held on the host.

The belief holds every look against the same limits in its compiled program
(``semantic_map.soundness``), where it can only leave the look out. Here, before anything is
compiled, a mistake is named: degrees for radians, millimetres for metres, percent for a share.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxlangnav.files.limits import FARTHEST, RANGES
from jaxlangnav.plain_text import cut, printable, shown

TYPES = ("hydrant", "cone", "car", "building", "tree", "bench", "barrel", "box")
"""The object types of the shipped lexicon, by type index."""
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


def said(value: Any, most: int = 40) -> str:
    """Write any value in one line of a refusal, a text in quotes, cut where it is long.

    Args:
        value: anything.
        most: characters at most.
    """
    if isinstance(value, str):  # cut before it is looked through: it may be of any length
        return f"'{cut(printable(' '.join(value[: 2 * most].split())), most)}'"
    try:
        text = str(value)
    except Exception:  # an object may fail to write itself, as numbers of 5,000 digits do
        text = shown(value)
    return cut(printable(" ".join(text.split())), most)


def is_complex(value: Any) -> bool:
    """Tell whether an array is of complex numbers, which NumPy would cut to real ones."""
    return np.issubdtype(getattr(value, "dtype", None), np.complexfloating)


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
        if isinstance(value, str | bytes) or is_complex(value):
            raise TypeError
        read = float(value.reshape(()) if hasattr(value, "reshape") else value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{what} is {said(value)}, but must be a number") from None
    if not math.isfinite(read):
        raise ValueError(f"{what} is {read}, but must be finite")
    return read


def bounded(value: Any, low: float, high: float, what: str, remedy: str) -> float:
    """Read a number between two bounds.

    Args:
        value: a number, or an array of one.
        low: the least that it may be.
        high: the most.
        what: what it is, for the refusal.
        remedy: what to do, for the refusal.

    Returns:
        The number.

    Raises:
        ValueError: it is none, or out of the bounds; one line.
    """
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
        detection_probability: above 0, at most 1.
        noise: metres, standard deviation on each axis.
        false_detections: expected in one look, of each type.
        mislabelled: share of detections with a wrong type.

    Returns:
        All of them, in this order, as f32.

    Raises:
        ValueError: names the value, the limits and the remedy.
    """
    reach = bounded(range_max, *RANGES, "range_max", "give metres")
    degrees = "give radians, math.radians(90) for 90 degrees"
    view = bounded(field_of_view, *VIEWS, "field_of_view", degrees)
    share = "give a share, 0.95 for 95 percent"
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
    return tuple(np.float32(one) for one in (reach, view, seen, errs, false, wrong))


def first(values: Any, most: int) -> list[Any]:
    """Read a row as far as it may go: it may have no end.

    Args:
        values: anything that can be gone through.
        most: how many to read.

    Returns:
        The first of them.

    Raises:
        TypeError: it is no row.
    """
    return list(itertools.islice(iter(values), most))


def _parts(values: Any, number_of: int, what: str, remedy: str) -> list[Any]:
    """Take apart what must be a row of so many."""
    try:
        parts = [] if isinstance(values, str | bytes | Mapping) else first(values, number_of + 1)
    except TypeError:
        parts = []
    if len(parts) != number_of:
        raise ValueError(f"{what} is {said(values)}, but must be {remedy}")
    return parts


def pose_numbers(pose: Sequence[Any]) -> np.ndarray:
    """Hold a pose against what it can be.

    Args:
        pose: x, y, heading, metres and radians, map frame.

    Returns:
        f32[3].

    Raises:
        ValueError: not three finite numbers, far from the map's origin, or a heading that looks
            like degrees.
    """
    x, y, turned = _parts(pose, 3, "pose", "(x, y, heading), in metres and radians")
    near = "give metres from the map's origin"
    x = bounded(x, -FARTHEST, FARTHEST, "pose's x", near)
    y = bounded(y, -FARTHEST, FARTHEST, "pose's y", near)
    wrap = "give radians, wrapped to one turn (degrees? use math.radians)"
    heading = bounded(turned, -TURNS, TURNS, "pose's heading", wrap)
    return np.array([x, y, heading], np.float32)


def area_numbers(area: Sequence[Any]) -> np.ndarray:
    """Read the bounds of an operating area, each for itself.

    Args:
        area: x_min, x_max, y_min, y_max, metres, map frame.

    Returns:
        f32[4].

    Raises:
        ValueError: not four finite numbers, or far from the map's origin.
    """
    names = ("x_min", "x_max", "y_min", "y_max")
    parts = _parts(area, 4, "area", f"({', '.join(names)}), in metres")
    near = "give metres from the map's origin"
    bounds = [
        bounded(one, -FARTHEST, FARTHEST, f"area's {name}", near)
        for name, one in zip(names, parts, strict=True)
    ]
    return np.array(bounds, np.float32)
