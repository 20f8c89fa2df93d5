"""Things as a planar scanner sees them: discs (x, y, radius), f64[K, 3], metres."""

import numpy as np

GAP = 0.3
"""Metres between neighbouring hits beyond which they belong to two things."""
EXTENT = 0.8
"""Metres that one disc spans at most: a long wall becomes many."""
GROWN = 0.04
"""Metres by which a disc is larger than its hits."""
_BEHIND = 0.8
"""Share of half its width by which the middle of a round thing lies behind its near side."""
NO_DISCS = np.zeros((0, 3))


def to_discs(ranges: np.ndarray, angles: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Gather the hits of a scan into discs.

    Only the near side of a thing is seen; it is taken to be as deep as it is wide.

    Args:
        ranges: f64[B], metres; infinite where a beam hits nothing.
        angles: f64[B], radians, robot frame, growing.
        pose: f64[3], x, y, heading of the scanner in the frame wanted.

    Returns:
        f64[K, 3], x, y, radius.
    """
    is_hit = np.isfinite(ranges)
    if not is_hit.any():
        return NO_DISCS
    bearing = angles[is_hit] + pose[2]
    x = pose[0] + ranges[is_hit] * np.cos(bearing)
    y = pose[1] + ranges[is_hit] * np.sin(bearing)
    breaks = [0]
    for index in range(1, len(x)):
        to_last = np.hypot(x[index] - x[index - 1], y[index] - y[index - 1])
        span = np.hypot(x[index] - x[breaks[-1]], y[index] - y[breaks[-1]])
        if to_last > GAP or span > EXTENT:
            breaks.append(index)
    return np.array(
        [
            _disc(x[first:last], y[first:last], pose)
            for first, last in zip(breaks, [*breaks[1:], len(x)], strict=True)
        ]
    )


def _disc(x: np.ndarray, y: np.ndarray, pose: np.ndarray) -> tuple[float, float, float]:
    """Put a disc behind hits on the near side of a thing."""
    mid_x, mid_y = float(x.mean()), float(y.mean())
    wide = float(np.hypot(x - mid_x, y - mid_y).max())
    bearing = np.arctan2(mid_y - pose[1], mid_x - pose[0])
    depth = _BEHIND * wide
    return mid_x + depth * np.cos(bearing), mid_y + depth * np.sin(bearing), wide + GROWN


def gaps(x: np.ndarray, y: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """Measure how far places are from the edge of the nearest disc.

    Args:
        x: f64[...], metres.
        y: f64[...], metres.
        discs: f64[K, 3].

    Returns:
        f64[...], metres; negative inside a disc, infinite where there are none.
    """
    if not len(discs):
        return np.full(np.shape(x), np.inf)
    away = np.hypot(x[..., None] - discs[:, 0], y[..., None] - discs[:, 1])
    return (away - discs[:, 2]).min(axis=-1)
