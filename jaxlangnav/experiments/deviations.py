"""How far a row lies from the printed one, in standard errors of both (section 4.2)."""

import math

from jaxlangnav.experiments.rows import Row

PAPER_RUNS = 100
"""Simulations behind a printed figure: "approximately 100" (section 4.2)."""
NEAR = 2.0
"""Standard errors within which two figures agree."""


def deviations(row: Row, paper: Row) -> dict[str, float]:
    """Measure how far a row lies from the printed one, in standard errors of both.

    Args:
        row: ours.
        paper: the printed row.

    Returns:
        ``distance`` and ``success``: signed; ours above the paper's is positive. A rate of 0 or
        100 % counts as half a run away from it, or it would have no error at all.
    """
    way_error = math.hypot(distance_error(row), paper["distance_sd"] / math.sqrt(PAPER_RUNS))
    success_error = math.hypot(
        rate_error(row["success_rate"], row["episodes"]),
        rate_error(paper["success_rate"], PAPER_RUNS),
    )
    return {
        "distance": (row["distance_mean"] - paper["distance_mean"]) / max(way_error, 1e-9),
        "success": (row["success_rate"] - paper["success_rate"]) / success_error,
    }


def distance_error(row: Row) -> float:
    """Compute the standard error of a row's mean distance, metres."""
    return row["distance_sd"] / math.sqrt(max(1, row["episodes"]))


def rate_error(percent: float, runs: int) -> float:
    """Compute the standard error of a rate.

    Args:
        percent: the rate; 0 and 100 % count as half a run away from it.
        runs: behind it.

    Returns:
        Percent.
    """
    rate = min(max(percent / 100.0, 0.5 / max(1, runs)), 1.0 - 0.5 / max(1, runs))
    return 100.0 * math.sqrt(rate * (1.0 - rate) / max(1, runs))
