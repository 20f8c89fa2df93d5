"""What a row of a results table says of its episodes (section 4.2)."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.messages import Status
from jaxlangnav.world.simulator import SUCCESS_RADIUS

_Z95 = 1.959964


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
    """Compute the 95 % Wilson score interval of a rate.

    Limits: no trials give (0, 1); all successes give an upper end of 1.

    Args:
        successes: how many succeeded.
        trials: of how many.

    Returns:
        Lower and upper end, in [0, 1].
    """
    if trials == 0:
        return 0.0, 1.0
    rate, z2 = successes / trials, _Z95**2
    centre = (rate + z2 / (2 * trials)) / (1 + z2 / trials)
    half = (
        _Z95
        / (1 + z2 / trials)
        * math.sqrt(rate * (1 - rate) / trials + z2 / (4 * trials * trials))
    )
    return max(0.0, centre - half), min(1.0, centre + half)


def timeouts_text(row: Mapping[str, Any]) -> str:
    """Write how many episodes of a row ended without an arrival.

    Args:
        row: with ``timeouts`` and ``not_found``.

    Returns:
        "3"; where there are episodes that ended with the goal not found, "3 + 2 not found".
    """
    given_up = f" + {row['not_found']} not found" if row["not_found"] else ""
    return f"{row['timeouts']}{given_up}"


def _efficiency(known: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Compare the ways walked with the least that end within reach of the goal."""
    straight = np.maximum(known - SUCCESS_RADIUS, 1e-9)
    return straight / np.maximum(straight, distance)


def summarize(results: EpisodeResult, known_distance: np.ndarray) -> RowMetrics:
    """Summarise episodes of one row.

    SPL is success weighted by path length: the mean of success · l / max(l, d), with l the straight
    way to where the robot may stop and d the distance travelled. Worlds that missed their
    template's law are counted and left out.

    Args:
        results: leaves [E, …].
        known_distance: f32[E], metres, straight way from start to goal.

    Returns:
        The summary.
    """
    valid = np.asarray(results.is_valid)
    success = np.asarray(results.is_success)[valid]
    distance = np.asarray(results.distance, np.float64)[valid]
    known = np.asarray(known_distance, np.float64)[valid]
    number = int(valid.sum())
    low, high = wilson_interval(int(success.sum()), number)
    spread = float(distance.std(ddof=1)) if number > 1 else 0.0
    known_spread = float(known.std(ddof=1)) if number > 1 else 0.0
    return RowMetrics(
        episodes=number,
        success_rate=100.0 * float(success.mean()) if number else 0.0,
        success_ci=(100.0 * low, 100.0 * high),
        distance_mean=float(distance.mean()) if number else 0.0,
        distance_sd=spread,
        known_distance_mean=float(known.mean()) if number else 0.0,
        known_distance_sd=known_spread,
        spl=float((success * _efficiency(known, distance)).mean()) if number else 0.0,
        steps_mean=float(np.asarray(results.steps)[valid].mean()) if number else 0.0,
        overflows=int(np.asarray(results.overflow)[valid].sum()),
        degenerate=int(np.asarray(results.degenerate)[valid].sum()),
        contradictions=int(np.asarray(results.contradictions)[valid].sum()),
        faults=int(np.asarray(results.faults)[valid].sum()),
        timeouts=int((~np.asarray(results.is_stopped)[valid]).sum()),
        not_found=int((np.asarray(results.ending)[valid] == Status.NOT_FOUND).sum()),
        invalid_worlds=int((~valid).sum()),
    )
