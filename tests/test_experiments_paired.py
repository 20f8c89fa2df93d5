"""Paired tests by hand, and calibrated where nothing differs."""

import math

import numpy as np
import pytest

from jaxlangnav.experiments.paired import compare, mcnemar, sign_flip


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        (0, 0, 1.0),
        (5, 0, 2 / 32),
        (0, 5, 2 / 32),
        (3, 1, 2 * (1 + 4) / 16),
        (2, 2, 1.0),
        (10, 1, 2 * 12 / 2048),
    ],
)
def test_mcnemar_by_hand(first: int, second: int, expected: float) -> None:
    assert mcnemar(first, second) == pytest.approx(expected)


def test_mcnemar_does_not_underflow() -> None:
    # 3,000 discordant episodes at 55 %: normal approximation, z = (1650 - 1350) / sqrt(3000).
    z = 300 / math.sqrt(3000)
    expected = math.erfc(z / math.sqrt(2))
    assert mcnemar(1650, 1350) == pytest.approx(expected, rel=0.1)
    assert 0.0 <= mcnemar(20_000, 0) < 1e-300


def test_sign_flip_limits() -> None:
    assert sign_flip(np.zeros(9)) == 1.0
    # All of 30 differences alike: only flips of none or all reach the sum.
    assert sign_flip(np.ones(30)) == pytest.approx(1 / 4001)
    # Three equal differences: 2 of 8 sign patterns reach the sum.
    assert sign_flip(np.full(3, 2.5)) == pytest.approx(0.25, abs=5 * math.sqrt(0.1875 / 4000))


def test_sign_flip_is_calibrated() -> None:
    random = np.random.default_rng(1)
    values = [
        sign_flip(random.exponential(1.0, 40) - random.exponential(1.0, 40)) for _ in range(200)
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


def test_nothing_to_compare_is_refused() -> None:
    empty = np.array([])
    with pytest.raises(ValueError, match="no episode"):
        compare(empty, empty, empty, empty)
