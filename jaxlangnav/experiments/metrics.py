"""What a row of a results table says of its episodes (section 4.2)."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import stats

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.messages import Status
from jaxlangnav.world.simulator import SUCCESS_RADIUS

_Z95 = 1.959964
_FLIPS = 4000


@dataclasses.dataclass(frozen=True, kw_only=True)
class RowMetrics:
    """Summary of a group of episodes; distances in metres, rates in percent."""

    episodes: int
    success_rate: float
    success_ci: tuple[float, float]
    distance_mean: float
    distance_sd: float
    known_distance_mean: float
    known_distance_sd: float
    spl: float
    steps_mean: float
    overflows: int
    degenerate: int
    contradictions: int
    faults: int
    timeouts: int
    not_found: int
    invalid_worlds: int

    def row(self) -> dict[str, Any]:
        """Write it in JSON's own types."""
        return dataclasses.asdict(self) | {"success_ci": [*self.success_ci]}


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Compute the 95 % Wilson interval of a rate, in [0, 1]; (0, 1) without trials."""
    if trials == 0:
        return 0.0, 1.0
    low, high = stats.binomtest(successes, trials).proportion_ci(method="wilson")
    return float(low), float(high)


def timeouts_text(row: Mapping[str, Any]) -> str:
    """Write a row's episodes without an arrival: "3", or "3 + 2 not found"."""
    given_up = f" + {row['not_found']} not found" if row["not_found"] else ""
    return f"{row['timeouts']}{given_up}"


def summarize(results: EpisodeResult, known_distance: np.ndarray) -> RowMetrics:
    """Summarise episodes of one row, leaves [E, …].

    SPL is success weighted by path length: the mean of success · l / max(l, d), with l the straight
    way to where the robot may stop and d the distance travelled. ``known_distance``: f32[E],
    metres, straight from start to goal. Worlds that missed their template's law are counted and
    left out.
    """
    valid = np.asarray(results.is_valid)
    found = {name: np.asarray(leaf)[valid] for name, leaf in vars(results).items()}
    success, distance = found["is_success"], found["distance"].astype(np.float64)
    known = np.asarray(known_distance, np.float64)[valid]
    straight = np.maximum(known - SUCCESS_RADIUS, 1e-9)  # the least way that may end in a success
    number = int(valid.sum())
    low, high = wilson_interval(int(success.sum()), number)

    def mean(values: np.ndarray) -> float:
        return float(values.mean()) if number else 0.0

    def spread(values: np.ndarray) -> float:
        return float(values.std(ddof=1)) if number > 1 else 0.0

    return RowMetrics(
        episodes=number,
        success_rate=100.0 * mean(success),
        success_ci=(100.0 * low, 100.0 * high),
        distance_mean=mean(distance),
        distance_sd=spread(distance),
        known_distance_mean=mean(known),
        known_distance_sd=spread(known),
        spl=mean(success * straight / np.maximum(straight, distance)),
        steps_mean=mean(found["steps"]),
        overflows=int(found["overflow"].sum()),
        **{name: int(found[name].sum()) for name in ("degenerate", "contradictions", "faults")},
        timeouts=int((~found["is_stopped"]).sum()),
        not_found=int((found["ending"] == Status.NOT_FOUND).sum()),
        invalid_worlds=int((~valid).sum()),
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Comparison:
    """Second arm against first, over the episodes that both ran."""

    pairs: int
    success_only_first: int
    success_only_second: int
    success_p: float  # two-sided exact McNemar test
    distance_difference: float  # second minus first, mean, metres
    distance_ci: tuple[float, float]  # 95 %, metres
    distance_p: float  # two-sided sign-flip permutation test


def compare(
    first_success: np.ndarray,
    second_success: np.ndarray,
    first_distance: np.ndarray,
    second_distance: np.ndarray,
) -> Comparison:
    """Compare two arms over the same episodes: bool[E] successes, f64[E] distances in metres."""
    if not len(first_success):
        raise ValueError("no episode was run by both arms")
    only_first = int(np.sum(first_success & ~second_success))
    only_second = int(np.sum(second_success & ~first_success))
    # McNemar's test: under the null hypothesis each episode that only one arm solved went to either
    # like a coin: exact, two-sided. Limits: no such episode gives 1.
    solved = only_first + only_second
    by_chance = float(stats.binomtest(only_first, solved).pvalue) if solved else 1.0
    difference = np.asarray(second_distance, np.float64) - np.asarray(first_distance, np.float64)
    mean, number = float(difference.mean()), len(difference)
    half = _Z95 * float(difference.std(ddof=1)) / math.sqrt(number) if number > 1 else 0.0
    return Comparison(
        pairs=number,
        success_only_first=only_first,
        success_only_second=only_second,
        success_p=by_chance,
        distance_difference=mean,
        distance_ci=(mean - half, mean + half),
        distance_p=_sign_flip(difference),
    )


def _sign_flip(difference: np.ndarray) -> float:
    """Test whether paired differences have a mean of zero, by flipping their signs at random."""
    # Limits: all differences zero give 1. The flips have a fixed seed: the same data, the same p.
    found = stats.permutation_test(
        (difference,),
        lambda values, axis: np.abs(np.sum(values, axis=axis)),
        permutation_type="samples",
        vectorized=True,
        n_resamples=_FLIPS,
        batch=100,
        alternative="greater",
        rng=0,
    )
    return float(found.pvalue)
