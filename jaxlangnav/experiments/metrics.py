"""Metrics of a group of episodes: success, distance, SPL, and paired tests (section 4.2)."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.messages import Status
from jaxlangnav.world.simulator import SUCCESS_RADIUS

_Z95 = 1.959964
_NUM_PERMUTATIONS = 4000


@dataclasses.dataclass(frozen=True, kw_only=True)
class RowMetrics:
    """Summary of a group of episodes; distances in metres, rates in percent."""

    episodes: int  # in valid worlds
    success_rate: float
    success_ci: tuple[float, float]  # 95 % Wilson interval
    distance_mean: float
    distance_sd: float
    known_distance_mean: float  # shortest path from start to goal
    known_distance_sd: float
    spl: float  # success weighted by path length, 0 to 1
    steps_mean: float
    overflows: int  # detections for which no object slot was free
    degenerate: int  # steps at which all particle weights vanished
    contradictions: int  # steps at which the observation contradicted the map
    faults: int  # steps at which the robot stood still because of a fault
    timeouts: int  # episodes that did not end by themselves
    not_found: int  # episodes that ended as "not found"
    invalid_worlds: int  # excluded episodes


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Compute the 95 % Wilson score interval of a rate, in [0, 1]; (0, 1) without trials."""
    if trials == 0:
        return 0.0, 1.0
    low, high = stats.binomtest(successes, trials).proportion_ci(method="wilson")
    return float(low), float(high)


def timeouts_text(row: Mapping[str, Any]) -> str:
    """Format a row's episodes without arrival: "3", or "3 + 2 not found"."""
    given_up = f" + {row['not_found']} not found" if row["not_found"] else ""
    return f"{row['timeouts']}{given_up}"


def summarize(results: EpisodeResult, known_distance: np.ndarray) -> RowMetrics:
    """Summarise episodes of one row, leaves [E, …].

    SPL is success weighted by path length: the mean of success · l / max(l, d), with l the length
    of the shortest path to where the robot may stop and d the distance travelled.
    ``known_distance``: f32[E] metres, shortest path from start to goal. Invalid worlds are counted
    and excluded.
    """
    valid = np.asarray(results.is_valid)
    leaves = {name: np.asarray(leaf)[valid] for name, leaf in vars(results).items()}
    success, distance = leaves["is_success"], leaves["distance"].astype(np.float64)
    known_valid = np.asarray(known_distance, np.float64)[valid]
    straight = np.maximum(known_valid - SUCCESS_RADIUS, 1e-9)  # shortest path to a success
    count = int(valid.sum())
    ci_low, ci_high = wilson_interval(int(success.sum()), count)

    def mean(values: np.ndarray) -> float:
        return float(values.mean()) if count else 0.0

    def std(values: np.ndarray) -> float:
        return float(values.std(ddof=1)) if count > 1 else 0.0

    return RowMetrics(
        episodes=count,
        success_rate=100.0 * mean(success),
        success_ci=(100.0 * ci_low, 100.0 * ci_high),
        distance_mean=mean(distance),
        distance_sd=std(distance),
        known_distance_mean=mean(known_valid),
        known_distance_sd=std(known_valid),
        spl=mean(success * straight / np.maximum(straight, distance)),
        steps_mean=mean(leaves["steps"]),
        overflows=int(leaves["overflow"].sum()),
        **{name: int(leaves[name].sum()) for name in ("degenerate", "contradictions", "faults")},
        timeouts=int((~leaves["is_stopped"]).sum()),
        not_found=int((leaves["ending"] == Status.NOT_FOUND).sum()),
        invalid_worlds=int((~valid).sum()),
    )


class Comparison(NamedTuple):
    """Paired comparison of a second arm with a first, over the episodes that both ran."""

    pairs: int  # episodes that both ran
    success_only_first: int  # pairs
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
    """Compare two arms in the same episodes, bool[E] and f64[E] metres; ``ValueError`` for none."""
    if not len(first_success):
        raise ValueError("no episode was run by both arms")
    only_first = int(np.sum(first_success & ~second_success))
    only_second = int(np.sum(second_success & ~first_success))
    # Exact two-sided McNemar test: under the null hypothesis, discordant pairs favour either arm
    # with probability 1/2. Without discordant pairs p = 1.
    discordant = only_first + only_second
    difference = np.asarray(second_distance, np.float64) - np.asarray(first_distance, np.float64)
    mean, count = float(difference.mean()), len(difference)
    half_width = _Z95 * float(difference.std(ddof=1)) / math.sqrt(count) if count > 1 else 0.0
    return Comparison(
        pairs=count,
        success_only_first=only_first,
        success_only_second=only_second,
        success_p=float(stats.binomtest(only_first, discordant).pvalue) if discordant else 1.0,
        distance_difference=mean,
        distance_ci=(mean - half_width, mean + half_width),
        distance_p=_sign_flip(difference),
    )


def _sign_flip(difference: np.ndarray) -> float:
    """Compute the p-value of a sign-flip permutation test for a mean difference of zero."""
    # If all differences are zero, p = 1. The seed is fixed: the same data give the same p.
    result = stats.permutation_test(
        (difference,),
        lambda values, axis: np.abs(np.sum(values, axis=axis)),
        permutation_type="samples",
        vectorized=True,
        n_resamples=_NUM_PERMUTATIONS,
        batch=100,
        alternative="greater",
        rng=0,
    )
    return float(result.pvalue)
