"""Rows of tables by hand."""

import math
from typing import Any

import numpy as np
import pytest

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.experiments.metrics import _mcnemar, _sign_flip, compare, summarize, wilson_interval
from jaxlangnav.messages import Status


def results(**changes: Any) -> EpisodeResult:
    number = 4
    leaves: dict[str, Any] = {
        "is_success": np.array([True, True, False, True]),
        "is_stopped": np.array([True, True, False, True]),
        "ending": np.array([Status.ARRIVED, Status.NOT_FOUND, Status.SEARCHING, Status.ARRIVED]),
        "distance": np.array([10.0, 20.0, 100.0, 5.0]),
        "steps": np.array([10, 20, 120, 5]),
        "final": np.zeros((number, 2)),
        "goal_distance": np.zeros(number),
        "overflow": np.array([0, 2, 0, 0]),
        "degenerate": np.array([1, 0, 0, 0]),
        "contradictions": np.array([0, 1, 2, 0]),
        "faults": np.array([3, 0, 1, 7]),
        "mean_effective_sample_size": np.ones(number),
        "is_valid": np.array([True, True, True, False]),
    }
    return EpisodeResult(**(leaves | changes))


def test_a_row_by_hand() -> None:
    row = summarize(results(), np.array([10.0, 10.0, 10.0, 10.0]))
    assert row.episodes == 3
    assert row.success_rate == pytest.approx(200 / 3)
    assert row.distance_mean == pytest.approx(130 / 3)
    assert row.distance_sd == pytest.approx(np.std([10, 20, 100], ddof=1))
    # It may stop 1.5 m short of 10 m.
    assert row.spl == pytest.approx((8.5 / 10.0 + 8.5 / 20.0 + 0.0) / 3)
    assert (row.timeouts, row.overflows, row.degenerate, row.invalid_worlds) == (1, 2, 1, 1)
    assert row.not_found == 1
    assert row.contradictions == 3
    assert row.faults == 4

    # A robot may stop short of the goal: its SPL is at most 1 all the same.
    row = summarize(results(distance=np.full(4, 2.0)), np.full(4, 10.0))
    assert row.spl == pytest.approx(2 / 3)
    # One episode has no spread.
    row = summarize(results(is_valid=np.array([True, False, False, False])), np.full(4, 10.0))
    assert (row.episodes, row.distance_sd) == (1, 0.0)


def test_wilson_interval_by_hand() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)
    low, high = wilson_interval(100, 100)
    assert high == pytest.approx(1.0)
    assert low == pytest.approx(100 / (100 + 1.959964**2))
    low, high = wilson_interval(50, 100)
    assert (low + high) / 2 == pytest.approx(0.5)
    assert high - low == pytest.approx(0.1922, abs=1e-3)


# Paired tests by hand, and calibrated where nothing differs.


def test_mcnemar_by_hand() -> None:
    cases = (0, 0, 1.0), (5, 0, 2 / 32), (0, 5, 2 / 32), (3, 1, 2 * (1 + 4) / 16), (2, 2, 1.0)
    for first, second, expected in (*cases, (10, 1, 2 * 12 / 2048)):
        assert _mcnemar(first, second) == pytest.approx(expected)
    # 3,000 discordant episodes at 55 %: normal approximation, z = (1650 - 1350) / sqrt(3000).
    z = 300 / math.sqrt(3000)
    expected = math.erfc(z / math.sqrt(2))
    assert _mcnemar(1650, 1350) == pytest.approx(expected, rel=0.1)
    assert 0.0 <= _mcnemar(20_000, 0) < 1e-300


def test_sign_flip_limits() -> None:
    assert _sign_flip(np.zeros(9)) == 1.0
    # All of 30 differences alike: only flips of none or all reach the sum.
    assert _sign_flip(np.ones(30)) == pytest.approx(1 / 4001)
    # Three equal differences: 2 of 8 sign patterns reach the sum.
    assert _sign_flip(np.full(3, 2.5)) == pytest.approx(0.25, abs=5 * math.sqrt(0.1875 / 4000))


def test_sign_flip_is_calibrated() -> None:
    random = np.random.default_rng(1)
    values = [
        _sign_flip(random.exponential(1.0, 40) - random.exponential(1.0, 40)) for _ in range(200)
    ]
    rejected = np.mean(np.array(values) < 0.1)
    assert abs(rejected - 0.1) < 5 * math.sqrt(0.09 / 200)


def test_compare_by_hand() -> None:
    found = compare(
        np.array([True, True, False, False]),
        np.array([True, False, False, True]),
        np.array([1.0, 2.0, 3.0, 4.0]),
        np.array([2.0, 2.0, 5.0, 5.0]),
    )
    assert (found.pairs, found.success_only_first, found.success_only_second) == (4, 1, 1)
    assert found.success_p == 1.0
    assert found.distance_difference == pytest.approx(1.0)
    half = 1.959964 * np.std([1, 0, 2, 1], ddof=1) / 2
    assert found.distance_ci == pytest.approx((1 - half, 1 + half))
    empty = np.array([])
    with pytest.raises(ValueError, match="no episode"):
        compare(empty, empty, empty, empty)
