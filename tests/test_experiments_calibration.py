"""Judging beliefs: right beliefs are found right, wrong ones wrong, by how much they are."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.experiments.calibration import BANDWIDTH, NUM_BINS, Tally, goal_region, scores


def tally(**changes: Any) -> Tally:
    leaves: dict[str, Any] = {
        "steps": np.array([4.0, 6.0]),
        "covered": np.array([4.0, 5.0]),
        "negative_log_likelihood": np.array([8.0, 12.0]),
        "squared_error": np.array([0.5, 0.5]),
        "bin_events": np.zeros((2, NUM_BINS)),
        "bin_probability": np.zeros((2, NUM_BINS)),
        "bin_outcome": np.zeros((2, NUM_BINS)),
    }
    return Tally(**(leaves | changes))


def test_scores_by_hand() -> None:
    events, probability, outcome = np.zeros((3, 2, NUM_BINS))
    events[0, 9], probability[0, 9], outcome[0, 9] = 4, 3.8, 3.0
    events[1, 9], probability[1, 9], outcome[1, 9] = 4, 3.8, 4.0
    events[1, 2], probability[1, 2], outcome[1, 2] = 2, 0.5, 1.0
    found = scores(tally(bin_events=events, bin_probability=probability, bin_outcome=outcome))
    # |7.6 − 7| + |0.5 − 1| over ten events.
    assert found["ece"] == pytest.approx(0.11)
    assert found["brier"] == pytest.approx(0.1)
    assert found["coverage90"] == pytest.approx(90.0)
    assert found["nll"] == pytest.approx(2.0)


def test_nothing_seen_has_no_score() -> None:
    found = scores(tally())
    assert found["ece"] is None
    assert found["brier"] is None


def region(points: np.ndarray, mass: np.ndarray, is_atom: np.ndarray, truth: np.ndarray) -> Any:
    inputs = (points[:, 0], points[:, 1], mass, is_atom, truth[0], truth[1])
    return goal_region(*(jnp.asarray(one) for one in inputs))


def test_an_atom_holds_its_probability() -> None:
    points = np.array([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]], np.float32)
    mass = np.array([0.7, 0.25, 0.05], np.float32)
    atoms = np.ones(3, bool)
    inside = [bool(region(points, mass, atoms, place)[0]) for place in points]
    # The two likeliest hold 95 %: the third is what is left out.
    assert inside == [True, True, False]
    log_density = region(points, mass, atoms, points[0])[1]
    assert log_density == pytest.approx(np.log(0.7 / (2 * np.pi * BANDWIDTH**2)), abs=1e-4)


def test_the_region_is_calibrated_for_a_truth_of_the_same_law() -> None:
    def one(key: jax.Array) -> jax.Array:
        places = jax.random.normal(key, (65, 2)) * jnp.array([[6.0, 2.0]])
        mass, atoms = jnp.full(64, 1 / 64), jnp.zeros(64, bool)
        x, y = places[:64, 0], places[:64, 1]
        return goal_region(x, y, mass, atoms, places[64, 0], places[64, 1])[0]

    number = 4000
    inside = np.asarray(jax.vmap(one)(jax.random.split(jax.random.key(0), number)))
    # Of 65 places alike, the 59 densest (90 % of 64, and the truth's own rank) count as inside.
    expected = 58.5 / 65
    assert abs(inside.mean() - expected) < 5 * np.sqrt(0.09 / number) + 1 / 130


def test_a_belief_that_is_too_sure_is_found_out() -> None:
    def one(key: jax.Array) -> jax.Array:
        places = jax.random.normal(key, (65, 2)) * 6.0
        mass, atoms = jnp.full(64, 1 / 64), jnp.zeros(64, bool)
        x, y = 0.4 * places[:64, 0], 0.4 * places[:64, 1]
        return goal_region(x, y, mass, atoms, places[64, 0], places[64, 1])[0]

    inside = np.asarray(jax.vmap(one)(jax.random.split(jax.random.key(1), 500)))
    assert inside.mean() < 0.6
