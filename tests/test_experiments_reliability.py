"""Reliability curves: sums over episodes, and intervals that know which steps are alike."""

import jax
import numpy as np
import pytest

from jaxlangnav.experiments.calibration import NUM_BINS, STAGES, Tally, nothing
from jaxlangnav.experiments.metrics import wilson_interval
from jaxlangnav.experiments.reliability import bin_sums, curve, pooled
from jaxlangnav.pytree import replace


def tally_of(events: np.ndarray, outcome: np.ndarray, probability: float, at: int) -> Tally:
    """Events and outcomes by episode in one bin, in the first stage."""
    shape = (len(events), len(STAGES), NUM_BINS)
    empty: Tally = jax.tree.map(
        lambda leaf: np.zeros((len(events), *np.shape(leaf)), np.float32), nothing()
    )
    full = {name: np.zeros(shape, np.float32) for name in ("events", "outcome", "probability")}
    full["events"][:, 0, at] = events
    full["outcome"][:, 0, at] = outcome
    full["probability"][:, 0, at] = events * probability
    return replace(empty, planner=replace(empty.planner, **full))


def test_a_curve_by_hand() -> None:
    bins = bin_sums(tally_of(np.array([2, 1, 0]), np.array([1, 1, 0]), 0.65, at=6))["planner"]
    mean, rate, low, high, number = curve(bins)
    assert mean == pytest.approx([0.65])
    assert rate == pytest.approx([2 / 3])
    assert number == pytest.approx([3])
    assert bins["episodes"][6] == 2
    # Residuals 1 − 4/3 and 1 − 2/3: variance (2/9)/9, as of 9 independent events, but there are 3.
    assert (low[0], high[0]) == pytest.approx(wilson_interval(2, 3))
    assert sum(bin_sums(tally_of(np.ones(2), np.ones(2), 0.5, at=5))["map"]["events"]) == 0


def test_steps_that_are_alike_count_as_one() -> None:
    rng = np.random.default_rng(0)
    outcome = (rng.random(50) < 0.6).astype(float)
    alone = curve(bin_sums(tally_of(np.ones(50), outcome, 0.6, at=6))["planner"])
    repeated = curve(bin_sums(tally_of(np.full(50, 20), 20 * outcome, 0.6, at=6))["planner"])
    # Twenty steps that all agree tell no more than one of them.
    assert repeated[1] == pytest.approx(alone[1])
    assert (repeated[2], repeated[3]) == (
        pytest.approx(alone[2], abs=0.02),
        pytest.approx(alone[3], abs=0.02),
    )
    assert repeated[4] == pytest.approx(20 * alone[4])


def test_intervals_hold_what_they_promise() -> None:
    """Episodes of ten like steps: the 95 % interval holds the true rate about 95 times in 100."""
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(200):
        outcome = (rng.random(60) < 0.7).astype(float)
        found = bin_sums(tally_of(np.full(60, 10), 10 * outcome, 0.7, at=7))["planner"]
        _, _, low, high, _ = curve(found)
        held += low[0] <= 0.7 <= high[0]
    # Five standard errors of 200 draws at 0.95 are 0.077.
    assert 0.873 <= held / 200 <= 1.0


def test_rows_are_pooled() -> None:
    one = bin_sums(tally_of(np.array([2, 1]), np.array([1, 1]), 0.65, at=6))["planner"]
    two = bin_sums(tally_of(np.array([3]), np.array([0]), 0.65, at=6))["planner"]
    both = bin_sums(tally_of(np.array([2, 1, 3]), np.array([1, 1, 0]), 0.65, at=6))["planner"]
    sums = pooled([one, two])
    assert {name: list(values) for name, values in sums.items()} == {
        name: pytest.approx(values) for name, values in both.items()
    }
    assert curve(sums)[1] == pytest.approx([2 / 6])
