"""A way around things: the shortest over a grid of inflated discs, pulled taut.

Every disc is inflated by the body's radius and the clearance asked for. What the robot goes up to
is inflated by its body only; and where the body is nearer to a disc than that already, as when
something has come up to it, the disc shrinks to let it out.
"""

import math

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

GAP = 0.3
"""Metres between neighbouring hits beyond which they belong to two things."""
EXTENT = 0.8
"""Metres that one disc spans at most: a long wall becomes many."""
GROWN = 0.04
"""Metres by which a disc is larger than its hits."""
_BEHIND = 0.8  # share of half its width by which a thing's middle lies behind its near side
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
    discs = []
    for near_x, near_y in zip(np.split(x, breaks[1:]), np.split(y, breaks[1:]), strict=True):
        mid_x, mid_y = float(near_x.mean()), float(near_y.mean())
        wide = float(np.hypot(near_x - mid_x, near_y - mid_y).max())
        bearing = np.arctan2(mid_y - pose[1], mid_x - pose[0])
        depth = _BEHIND * wide
        middle = mid_x + depth * np.cos(bearing), mid_y + depth * np.sin(bearing)
        discs.append((*middle, wide + GROWN))
    return np.array(discs)


def gaps(x: np.ndarray, y: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """Measure how far places are from the edge of the nearest disc, all in metres.

    f64[...] x and y, f64[K, 3] to f64[...]; negative inside a disc, infinite where there are none.
    """
    if not len(discs):
        return np.full(np.shape(x), np.inf)
    away = np.hypot(x[..., None] - discs[:, 0], y[..., None] - discs[:, 1])
    return (away - discs[:, 2]).min(axis=-1)


CELL = 0.15
"""Metres, side of a grid cell."""
DETOUR_MARGIN = 3.0
"""Metres of room that a way may take beyond the box of start and goal."""
_ALIVE = 0.08  # metres that a body is told to keep from a thing that it stands against
_UP_TO = 0.6  # metres from the goal to the edge of a disc that is what is gone up to


def inflate(
    discs: np.ndarray, start: np.ndarray, goal: np.ndarray, radius: float, clearance: float
) -> np.ndarray:
    """Inflate discs so that the middle of the body has to stay out of them.

    Args:
        discs: f64[K, 3], x, y, radius, metres.
        start: f64[2], where the robot is.
        goal: f64[2], where it goes.
        radius: of the body, metres.
        clearance: metres to keep besides where that can be.
    """
    if not len(discs):
        return discs
    from_goal = np.hypot(*(discs[:, :2] - goal).T) - discs[:, 2]
    kept = radius + np.where(from_goal <= _UP_TO, _ALIVE, np.maximum(clearance, _ALIVE))
    from_start = np.hypot(*(discs[:, :2] - start).T) - discs[:, 2]
    kept = np.minimum(kept, np.maximum(from_start - 0.01, 0.0))
    return np.column_stack([discs[:, :2], discs[:, 2] + kept])


def is_clear(start: np.ndarray, end: np.ndarray, discs: np.ndarray) -> bool:
    """Tell whether the straight way between two places f64[2] stays out of discs f64[K, 3]."""
    if not len(discs):
        return True
    way = end - start
    squared = float(way @ way)
    to_disc = discs[:, :2] - start
    share = np.clip(to_disc @ way / squared, 0.0, 1.0) if squared > 0 else np.zeros(len(discs))
    away = np.hypot(*(to_disc - share[:, None] * way).T)
    return bool((away >= discs[:, 2] - 1e-9).all())


def find_path(start: np.ndarray, goal: np.ndarray, discs: np.ndarray) -> np.ndarray | None:
    """Find a short way that stays out of inflated discs.

    Limits: without discs the straight line. A goal inside a disc is replaced by the free place
    nearest to it that can be reached.

    Args:
        start: f64[2], metres.
        goal: f64[2], metres.
        discs: f64[K, 3], inflated.

    Returns:
        f64[V, 2], corners of the way without the start, none where there is nothing nearer to
        the goal; None where there is no way.
    """
    if is_clear(start, goal, discs):
        return goal[None]
    low = np.minimum(start, goal) - DETOUR_MARGIN
    shape = np.ceil((np.maximum(start, goal) + DETOUR_MARGIN - low) / CELL).astype(int)
    x = low[0] + CELL * (np.arange(shape[0]) + 0.5)
    y = low[1] + CELL * (np.arange(shape[1]) + 0.5)
    is_free = np.ones(shape, bool)
    for disc_x, disc_y, radius in discs:
        is_free &= (x[:, None] - disc_x) ** 2 + (y[None] - disc_y) ** 2 >= radius**2
    first = tuple(((start - low) / CELL).astype(int))
    is_free[first] = True
    from_goal = np.hypot(x[:, None] - goal[0], y[None] - goal[1])
    cells = _search(is_free, first, from_goal)
    if cells is None:
        return None
    way = np.array([[x[i], y[j]] for i, j in cells]).reshape(-1, 2)
    if len(way) and is_clear(way[-1], goal, discs):
        way[-1] = goal
    corners, here = [], start
    while len(way):  # pulled taut: corners that can be cut are left out
        ahead = len(way) - 1
        while ahead > 0 and not is_clear(here, way[ahead], discs):
            ahead -= 1
        here, way = way[ahead], way[ahead + 1 :]
        corners.append(here)
    return np.array(corners).reshape(-1, 2)


def _search(
    is_free: np.ndarray, first: tuple[int, ...], from_goal: np.ndarray
) -> list[tuple[int, int]] | None:
    """Find the shortest way to the free cell nearest to the goal that can be reached (Dijkstra)."""
    # Cells are numbered row by row; a rim that is not free keeps rows apart.
    width, free = is_free.shape[1] + 2, np.pad(is_free, 1).ravel()
    steps = ((1, 1.0), (width, 1.0), (width - 1, math.sqrt(2.0)), (width + 1, math.sqrt(2.0)))
    pairs = [np.flatnonzero(free[:-step] & free[step:]) for step, _ in steps]
    ends = [cells + step for cells, (step, _) in zip(pairs, steps, strict=True)]
    lengths = np.repeat([length for _, length in steps], [len(cells) for cells in pairs])
    edges = lengths, (np.concatenate(pairs), np.concatenate(ends))
    start = (first[0] + 1) * width + first[1] + 1
    graph = coo_array(edges, shape=(free.size, free.size)).tocsr()
    reached, before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    left = np.pad(from_goal, 1, constant_values=math.inf).ravel()
    best = int(np.argmin(np.where(np.isfinite(reached), left, math.inf)))
    if left[best] > from_goal[is_free].min() + 2 * CELL:
        return None
    way = []
    while best != start:
        way.append((best // width - 1, best % width - 1))
        best = int(before[best])
    return way[::-1]
