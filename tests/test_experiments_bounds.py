"""Limits of search against linear programs, and against robots that search by simulation."""

import itertools
import math

import numpy as np
import pytest
from scipy.optimize import linprog

from jaxlangnav.experiments import bounds


def test_the_share_seen_by_hand() -> None:
    edges, area, mass = np.array([10.0, 11.0]), np.array([20.0]), np.array([1.0])
    found = bounds.likeliest_share(edges, area, mass, 2.0, np.array([0.0, 8.0, 9.0, 13.0, 50.0]))
    # Nothing before the ring is in reach after 8 m; then 4 square metres of its 20 a metre.
    np.testing.assert_allclose(found, [0.0, 0.0, 0.2, 1.0, 1.0])


def test_no_set_within_the_bounds_on_nested_sets_is_likelier() -> None:
    random = np.random.default_rng(0)
    for _ in range(20):
        edges = np.cumsum(random.uniform(0.2, 1.0, 9))
        area, mass = random.uniform(0.5, 4.0, 8), random.dirichlet(np.ones(8))
        reach, way = random.uniform(0.5, 2.0), random.uniform(0.0, 5.0)
        first = np.where(edges[:-1] < reach, area, 0.0)
        tails = np.triu(np.ones((8, 8)))
        since = np.maximum(0.0, way - np.maximum(0.0, edges[:-1] - reach))
        best = linprog(
            -mass / area,
            tails,
            tails @ first + 2 * reach * since,
            bounds=[(0, one) for one in area],
        )
        found = bounds.likeliest_share(edges, area, mass, reach, np.array([way]))
        assert found[0] == pytest.approx(-best.fun, abs=1e-9)


def _ways(stops: np.ndarray, goal: np.ndarray, reach: float) -> np.ndarray:
    """Walk straight from the origin from stop to stop: metres to 1.5 m from each goal, or inf."""
    path = [np.zeros((1, 2))]
    for start, end in itertools.pairwise(np.concatenate([np.zeros((1, 2)), stops])):
        path.append(start + (end - start) * np.linspace(0.0, 1.0, 21)[1:, None])
    points = np.concatenate(path)
    walked = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    away = np.hypot(points[:, :1] - goal[:, 0], points[:, 1:] - goal[:, 1])
    seen = (away <= reach).argmax(axis=0)
    rest = np.maximum(0.0, away[seen, np.arange(len(goal))] - 1.5)
    return np.where((away <= reach).any(axis=0), walked[seen] + rest, np.inf)


@pytest.mark.parametrize("num_goals", [1, 2])
def test_no_tour_of_a_small_area_beats_the_bound(num_goals: int) -> None:
    depth, width, reach = 5.0, 7.0, 2.0
    random = np.random.default_rng(1)
    goals = random.uniform([0.0, -0.5 * width], [depth, 0.5 * width], (num_goals, 200, 2))
    places = list(itertools.product([1.5, 3.5], [-2.2, 0.0, 2.2]))
    means = []
    for tour in itertools.permutations(places, 4):
        ways = [_ways(np.array(tour), goal, reach) for goal in goals]
        if np.isfinite(ways[0]).all():
            means.append(np.min(ways, axis=0).mean())
    found = bounds.uniform_search_bound(depth, width, reach, num_goals)
    assert (0.7 if num_goals == 1 else 0.5) * min(means) < found < min(means)


def test_no_sweep_along_the_best_arc_beats_the_bound() -> None:
    random = np.random.default_rng(0)
    mean, sd, reach = 8.75, 1.69, 3.0
    distance = random.normal(mean, sd, 1000)
    bearing = random.uniform(-math.pi / 4, math.pi / 4, 1000)
    goal = distance[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    ways = []
    # Out along one edge of the sector, along an arc to the other one, back along a farther one.
    for radius in (6.0, 7.0, 8.0, 9.0):
        angle = np.linspace(-math.pi / 4, math.pi / 4, 9) * 0.9
        arc = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        ways.append(_ways(np.concatenate([radius * arc, (radius + 5.0) * arc[::-1]]), goal, reach))
    found = bounds.law_search_bound(mean, sd, reach)
    # Those whom no arc finds are counted with the straight way to them: too little.
    means = [np.where(np.isfinite(one), one, distance - 1.5).mean() for one in ways]
    assert mean - 1.5 + 2.0 < found < min(means)


def test_the_law_bound_falls_with_the_range_to_the_straight_way() -> None:
    values = [bounds.law_search_bound(8.75, 1.69, reach) for reach in (0.5, 1.0, 3.0, 5.0, 30.0)]
    assert values == sorted(values, reverse=True)
    assert values[-1] == pytest.approx(8.75 - 1.5, abs=0.1)
    assert values[-1] < 8.75 - 1.5
    # A view of half a metre makes the search long: the area must count.
    assert values[0] > 4 * 8.75


def test_a_small_range_sweeps_the_area() -> None:
    # As R falls the way nears that of a sweep without overlap, A / 4R.
    assert bounds.uniform_search_bound(10.0, 14.0, 0.2) == pytest.approx(140.0 / 0.8, rel=0.05)


def test_limits_of_rows() -> None:
    null = bounds.limits("2H1C", "null", 3.0)
    assert null["success"] == 50.0
    assert null["known"] == pytest.approx(10.49)
    law, uniform = null["search_law"], null["search_uniform"]
    assert law is not None
    assert uniform is not None
    # Either hydrant will do: the nearer one of two may stand nearer than one does on average.
    assert 8.0 < law < bounds.law_search_bound(10.49, 1.81, 3.0)
    assert law < uniform
    behind = bounds.limits("2H1C", "behind", 3.0)
    assert behind["success"] == 100.0
    assert behind["search_law"] is None
