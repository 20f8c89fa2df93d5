"""Limits of search against integrals by hand and against robots that search by simulation."""

import math

import numpy as np
import pytest

from jaxlangnav.experiments import bounds


def test_uniform_bound_by_hand() -> None:
    # A = 100, R = 2: (100 - 4π)² / 800.
    assert bounds.uniform_search_bound(100.0, 2.0) == pytest.approx((100 - 4 * math.pi) ** 2 / 800)
    assert bounds.uniform_search_bound(100.0, 20.0) == 0.0


def test_the_uniform_bound_is_the_integral_it_says() -> None:
    area, reach = 240.0, 3.0
    way = np.linspace(0.0, 60.0, 600_001)
    unseen = np.maximum(0.0, 1.0 - (math.pi * reach**2 + 2 * reach * way) / area)
    integral = np.sum(unseen) * (way[1] - way[0])
    assert bounds.uniform_search_bound(area, reach) == pytest.approx(integral, rel=1e-4)


def test_the_law_bound_in_the_limit_of_an_even_law() -> None:
    # A far, wide law is nearly even over its sector where it is likeliest: the bound must lie
    # under that of any region that holds a share of it, and above the straight way into view.
    mean, sd, reach = 8.75, 1.69, 3.0
    found = bounds.law_search_bound(mean, sd, reach)
    assert found >= mean - reach - 1e-3
    assert found <= bounds.uniform_search_bound(bounds.operating_area("1H1C", "null"), reach)


def test_the_law_bound_falls_with_the_range_and_is_met_at_last() -> None:
    values = [bounds.law_search_bound(8.75, 1.69, reach) for reach in (1.0, 2.0, 3.0, 5.0, 30.0)]
    assert values == sorted(values, reverse=True)
    assert values[-1] == pytest.approx(0.0, abs=1e-6)
    # A view of half a metre makes the search long: the area must count.
    assert bounds.law_search_bound(8.75, 1.69, 0.5) > 2 * 8.75


def test_no_sweep_along_the_best_arc_beats_the_bound() -> None:
    random = np.random.default_rng(0)
    mean, sd, reach = 8.75, 1.69, 1.0
    distance = random.normal(mean, sd, 4000)
    bearing = random.uniform(-math.pi / 4, math.pi / 4, 4000)
    x, y = distance * np.cos(bearing), distance * np.sin(bearing)
    # Out along one edge of the sector and back and forth on arcs, nearest to the mean first.
    path = [np.linspace(0.0, mean, 200)[:, None] * [math.cos(0.785), -math.sin(0.785)]]
    angle = np.linspace(-math.pi / 4, math.pi / 4, 400)
    for turn, radius in enumerate(mean + np.array([0.0, 2.0, -2.0, 4.0, -4.0, 6.0, -6.0])):
        sweep = angle if turn % 2 == 0 else angle[::-1]
        path.append(radius * np.stack([np.cos(sweep), np.sin(sweep)], axis=1))
    points = np.concatenate(path)
    walked = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    apart = np.hypot(points[:, :1] - x, points[:, 1:] - y) <= reach
    first = np.where(apart.any(axis=0), walked[apart.argmax(axis=0)], walked[-1])
    assert first.mean() > bounds.law_search_bound(mean, sd, reach)


def test_approach_by_hand() -> None:
    assert bounds.approach(10.0, 0.01, 3.0) == pytest.approx(1.5)
    assert bounds.approach(10.0, 0.01, 20.0) == pytest.approx(8.5, abs=1e-3)
    assert bounds.approach(10.0, 0.01, 1.0) == 0.0


def test_limits_of_rows() -> None:
    null = bounds.limits("2H1C", "null", 3.0)
    assert null["success"] == 50.0
    assert null["known"] == pytest.approx(10.49)
    assert null["search_uniform"] is not None
    behind = bounds.limits("2H1C", "behind", 3.0)
    assert behind["success"] == 100.0
    assert behind["search_law"] is None
