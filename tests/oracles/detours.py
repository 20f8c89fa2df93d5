"""Shortest ways that keep a berth: a dense visibility graph and Dijkstra's algorithm in NumPy."""

import heapq

import numpy as np


def _distance_to_segments(point: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Compute distances [...] of one point to segments [..., 2]."""
    span = end - start
    length = np.maximum((span**2).sum(-1), 1e-12)
    along = np.clip(((point - start) * span).sum(-1) / length, 0.0, 1.0)
    return np.hypot(*np.moveaxis(start + along[..., None] * span - point, -1, 0))


def shortest_way(
    start: np.ndarray,
    goal: np.ndarray,
    things: np.ndarray,
    area: tuple[float, float, float, float],
    *,
    berth: float = 2.0,
    reach: float = 1.2,
) -> float:
    """Compute the metres of the shortest way to within reach of a goal that keeps a berth.

    inf where there is none; at most 0.1 % too long for circles of 72 corners.
    """
    number = 72
    turn = np.linspace(0.0, 2 * np.pi, number, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    corners = [thing + berth / np.cos(np.pi / number) * circle for thing in things]
    towards = np.arctan2(*(start - goal)[::-1])
    straight = goal + reach * np.array([np.cos(towards), np.sin(towards)])
    points = np.concatenate([start[None], *corners, straight[None], goal + reach * circle])
    first_end = 1 + number * len(things)
    is_in = (points[:, 0] >= area[0]) & (points[:, 0] <= area[1])
    is_in &= (points[:, 1] >= area[2]) & (points[:, 1] <= area[3])
    length = np.hypot(*(points[:, None] - points[None]).T)
    for thing in things:
        away = _distance_to_segments(thing, points[:, None], points[None])
        length = np.where(away >= berth - 1e-6, length, np.inf)
    length[:, ~is_in] = np.inf
    least, queue = np.full(len(points), np.inf), [(0.0, 0)]
    least[0] = 0.0
    while queue:
        metres, here = heapq.heappop(queue)
        if metres > least[here]:
            continue
        if here >= first_end:
            return metres
        after = metres + length[here]
        for there in np.nonzero(after < least)[0]:
            least[there] = after[there]
            heapq.heappush(queue, (float(after[there]), int(there)))
    return float("inf") if np.hypot(*(start - goal)) > reach else 0.0
