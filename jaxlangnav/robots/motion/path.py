"""Path planning: Dijkstra on a grid with inflated discs, then shortcutting of corners.

Every disc is inflated by the body's radius and the clearance. The target object is inflated by the
body's radius only; and where the body is already nearer to a disc, as when something has approached
it, the disc shrinks so that the robot can leave.
"""

import math

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

MAX_HIT_GAP = 0.3
"""Metres between neighboring hits beyond which they belong to two objects."""
MAX_DISC_SPAN = 0.8
"""Metres, maximum span of one disc: a long wall becomes many."""
DISC_MARGIN = 0.04
"""Metres by which a disc extends beyond its hits."""
_DEPTH_RATIO = 0.8  # depth of an object's center behind its near side, over half its width


def to_discs(ranges: np.ndarray, angles: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Cluster the hits of a scan into discs.

    Only the near side of an object is visible; its depth is assumed equal to its width.

    Args:
        ranges: f64[B], metres; infinite where a beam hits nothing.
        angles: f64[B], radians, robot frame, increasing.
        pose: f64[3], x, y, heading of the scanner in the frame of the result.

    Returns:
        f64[K, 3], x, y, radius.
    """
    is_hit = np.isfinite(ranges)
    if not is_hit.any():
        return np.zeros((0, 3))
    bearing = angles[is_hit] + pose[2]
    x = pose[0] + ranges[is_hit] * np.cos(bearing)
    y = pose[1] + ranges[is_hit] * np.sin(bearing)
    starts = [0]
    for index in range(1, len(x)):
        step = np.hypot(x[index] - x[index - 1], y[index] - y[index - 1])
        span = np.hypot(x[index] - x[starts[-1]], y[index] - y[starts[-1]])
        if step > MAX_HIT_GAP or span > MAX_DISC_SPAN:
            starts.append(index)
    discs = []
    for hit_x, hit_y in zip(np.split(x, starts[1:]), np.split(y, starts[1:]), strict=True):
        mean_x, mean_y = float(hit_x.mean()), float(hit_y.mean())
        half_width = float(np.hypot(hit_x - mean_x, hit_y - mean_y).max())
        bearing = np.arctan2(mean_y - pose[1], mean_x - pose[0])
        depth = _DEPTH_RATIO * half_width
        center = mean_x + depth * np.cos(bearing), mean_y + depth * np.sin(bearing)
        discs.append((*center, half_width + DISC_MARGIN))
    return np.array(discs)


def disc_distance(x: np.ndarray, y: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """Compute the distance of points to the edge of the nearest disc, all in metres.

    f64[...] x and y, f64[K, 3] to f64[...]; negative inside a disc, infinite without discs.
    """
    distance = np.hypot(x[..., None] - discs[:, 0], y[..., None] - discs[:, 1])
    return (distance - discs[:, 2]).min(axis=-1, initial=np.inf)


CELL = 0.15
"""Metres, side of a grid cell."""
DETOUR_MARGIN = 3.0
"""Metres by which the grid extends beyond the box of start and goal."""
_MIN_GAP = 0.08  # metres kept even from the target
_TARGET_DIST = 0.6  # metres from the goal to the edge of a disc that counts as the target


def inflate(
    discs: np.ndarray, start: np.ndarray, goal: np.ndarray, radius: float, clearance: float
) -> np.ndarray:
    """Inflate discs to configuration-space obstacles for the center of the body.

    Args:
        discs: f64[K, 3], x, y, radius, metres.
        start: f64[2], position of the robot.
        goal: f64[2], its goal.
        radius: of the body, metres.
        clearance: metres to keep besides, where possible.
    """
    from_goal = np.hypot(*(discs[:, :2] - goal).T) - discs[:, 2]
    margin = radius + np.where(from_goal <= _TARGET_DIST, _MIN_GAP, np.maximum(clearance, _MIN_GAP))
    from_start = np.hypot(*(discs[:, :2] - start).T) - discs[:, 2]
    margin = np.minimum(margin, np.maximum(from_start - 0.01, 0.0))
    return np.column_stack([discs[:, :2], discs[:, 2] + margin])


def is_clear(start: np.ndarray, end: np.ndarray, discs: np.ndarray) -> bool:
    """Tell whether the segment between two points f64[2] stays out of discs f64[K, 3]."""
    segment = end - start
    squared = float(segment @ segment)
    offset = discs[:, :2] - start
    frac = np.clip(offset @ segment / squared, 0.0, 1.0) if squared > 0 else np.zeros(len(discs))
    distance = np.hypot(*(offset - frac[:, None] * segment).T)
    return bool((distance >= discs[:, 2] - 1e-9).all())


def find_path(start: np.ndarray, goal: np.ndarray, discs: np.ndarray) -> np.ndarray | None:
    """Find a short path that stays out of inflated discs.

    Limits: without discs the straight line. A goal inside a disc is replaced by the nearest free
    position that is reachable.

    Args:
        start: f64[2], metres.
        goal: f64[2], metres.
        discs: f64[K, 3], inflated.

    Returns:
        f64[V, 2], corners of the path without the start, none where no free position is nearer
        to the goal; None where there is no path.
    """
    if is_clear(start, goal, discs):
        return goal[None]
    low = np.minimum(start, goal) - DETOUR_MARGIN
    shape = np.ceil((np.maximum(start, goal) + DETOUR_MARGIN - low) / CELL).astype(int)
    x = low[0] + CELL * (np.arange(shape[0]) + 0.5)
    y = low[1] + CELL * (np.arange(shape[1]) + 0.5)
    is_free = disc_distance(x[:, None], y[None], discs) >= 0.0
    start_cell = tuple(((start - low) / CELL).astype(int))
    is_free[start_cell] = True
    from_goal = np.hypot(x[:, None] - goal[0], y[None] - goal[1])
    cells = _search(is_free, start_cell, from_goal)
    if cells is None:
        return None
    path = np.array([[x[i], y[j]] for i, j in cells]).reshape(-1, 2)
    if len(path) and is_clear(path[-1], goal, discs):
        path[-1] = goal
    corners, current = [], start
    while len(path):  # shortcut: skip corners that a free segment bypasses
        last = len(path) - 1
        while last > 0 and not is_clear(current, path[last], discs):
            last -= 1
        current, path = path[last], path[last + 1 :]
        corners.append(current)
    return np.array(corners).reshape(-1, 2)


def _search(
    is_free: np.ndarray, start_cell: tuple[int, ...], from_goal: np.ndarray
) -> list[tuple[int, int]] | None:
    """Find the shortest path to the reachable free cell nearest to the goal (Dijkstra)."""
    # Cells are numbered row by row; a border of blocked cells separates the rows.
    width, is_open = is_free.shape[1] + 2, np.pad(is_free, 1).ravel()
    steps = ((1, 1.0), (width, 1.0), (width - 1, math.sqrt(2.0)), (width + 1, math.sqrt(2.0)))
    from_cells = [np.flatnonzero(is_open[:-step] & is_open[step:]) for step, _ in steps]
    to_cells = [cells + step for cells, (step, _) in zip(from_cells, steps, strict=True)]
    lengths = np.repeat([length for _, length in steps], [len(cells) for cells in from_cells])
    edges = lengths, (np.concatenate(from_cells), np.concatenate(to_cells))
    start = (start_cell[0] + 1) * width + start_cell[1] + 1
    graph = coo_array(edges, shape=(is_open.size, is_open.size)).tocsr()
    distance, predecessor = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    remaining = np.pad(from_goal, 1, constant_values=math.inf).ravel()
    best = int(np.argmin(np.where(np.isfinite(distance), remaining, math.inf)))
    if remaining[best] > from_goal[is_free].min() + 2 * CELL:
        return None
    path = []
    while best != start:
        path.append((best // width - 1, best % width - 1))
        best = int(predecessor[best])
    return path[::-1]
