"""Paired comparisons of two policies that ran the same episodes (section 4.2's tables).

Worlds differ far more than policies do, so two arms are compared episode by episode.
"""

import dataclasses
import math

import numpy as np

_FLIPS = 4000
_Z95 = 1.959964


@dataclasses.dataclass(frozen=True, kw_only=True)
class Comparison:
    """Second arm against first, over the episodes that both ran."""

    pairs: int
    success_only_first: int
    success_only_second: int
    success_p: float
    """Two-sided exact McNemar test."""
    distance_difference: float
    """Second minus first, mean, metres."""
    distance_ci: tuple[float, float]
    """95 %, metres."""
    distance_p: float
    """Two-sided sign-flip permutation test."""


def compare(
    first_success: np.ndarray,
    second_success: np.ndarray,
    first_distance: np.ndarray,
    second_distance: np.ndarray,
) -> Comparison:
    """Compare two arms over the same episodes.

    Args:
        first_success: bool[E].
        second_success: bool[E].
        first_distance: f64[E], metres.
        second_distance: f64[E], metres.

    Returns:
        The comparison.

    Raises:
        ValueError: there is nothing to compare.
    """
    if not len(first_success):
        raise ValueError("no episode was run by both arms")
    only_first = int(np.sum(first_success & ~second_success))
    only_second = int(np.sum(second_success & ~first_success))
    difference = np.asarray(second_distance, np.float64) - np.asarray(first_distance, np.float64)
    mean, half = float(difference.mean()), 0.0
    if len(difference) > 1:
        half = _Z95 * float(difference.std(ddof=1)) / math.sqrt(len(difference))
    return Comparison(
        pairs=len(difference),
        success_only_first=only_first,
        success_only_second=only_second,
        success_p=mcnemar(only_first, only_second),
        distance_difference=mean,
        distance_ci=(mean - half, mean + half),
        distance_p=sign_flip(difference),
    )


def mcnemar(only_first: int, only_second: int) -> float:
    """Test whether two success rates differ, by the episodes that only one arm solved.

    Under the null hypothesis each of them went to either arm like a coin: exact, two-sided.

    Limits: no such episode gives 1.

    Args:
        only_first: episodes only the first arm solved.
        only_second: episodes only the second arm solved.

    Returns:
        The p-value.
    """
    number, fewer = only_first + only_second, min(only_first, only_second)
    if number == 0:
        return 1.0
    # In the log domain: 2^-n underflows from a thousand episodes on.
    tail = np.array([_log_binomial(number, k) for k in range(fewer + 1)])
    log_p = math.log(2.0) + float(np.logaddexp.reduce(tail)) - number * math.log(2.0)
    return min(1.0, math.exp(log_p))


def _log_binomial(number: int, k: int) -> float:
    """Compute log C(number, k)."""
    return math.lgamma(number + 1) - math.lgamma(k + 1) - math.lgamma(number - k + 1)


def sign_flip(difference: np.ndarray) -> float:
    """Test whether paired differences have a mean of zero, by flipping their signs at random.

    Limits: all differences zero give 1. The flips have a fixed seed: the same data, the same p.

    Args:
        difference: f64[E].

    Returns:
        The p-value, at least 1 / 4001.
    """
    observed = abs(float(np.sum(difference)))
    scale = float(np.sum(np.abs(difference)))
    if scale == 0.0:
        return 1.0
    random = np.random.default_rng(0)
    exceed = 0
    for _ in range(_FLIPS // 100):
        signs = random.integers(0, 2, (100, len(difference)), dtype=np.int8) * 2 - 1
        # A hair of slack: the observed sum itself must count whatever the order of addition.
        exceed += int(np.sum(np.abs(signs @ difference) >= observed - 1e-12 * scale))
    return (exceed + 1) / (_FLIPS + 1)
