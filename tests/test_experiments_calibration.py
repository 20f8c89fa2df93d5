"""Judging beliefs: right beliefs are found right, wrong ones wrong, by how much they are."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand

from jaxlangnav.experiments.calibration import (
    BANDWIDTH,
    NUM_BINS,
    STAGES,
    GoalDensity,
    Reliability,
    Tally,
    _has_type,
    _hpd_level,
    _reliability,
    _sample_unseen,
    empty_tally,
    matched_object,
    scores,
)
from jaxlangnav.experiments.metrics import wilson_interval
from jaxlangnav.experiments.monte_carlo import run_tasks
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.reliability import TALLY_PROGRAM, bin_sums, pool_bins, reliability_curve
from jaxlangnav.experiments.tasks import SENTENCES, Cell, ground_sentences, make_tasks
from jaxlangnav.messages import NONE
from jaxlangnav.navigator import default_params
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.coverage import empty_coverage

S = len(STAGES)


def empty(number: int) -> Tally:
    return jax.tree.map(lambda leaf: np.zeros((number, *np.shape(leaf)), np.float32), empty_tally())


def tally(**changes: Any) -> Tally:
    """Two episodes, four steps in the first stage and six in the second."""

    def by_stage(first: float, second: float) -> np.ndarray:
        leaf = np.zeros((2, S))
        leaf[0, 0], leaf[1, 1] = first, second
        return leaf

    return replace(
        empty(2), steps=by_stage(4.0, 6.0), covered=by_stage(4.0, 5.0),
        negative_log_likelihood=by_stage(8.0, 12.0), **changes,
    )  # fmt: skip


def test_scores_by_hand() -> None:
    events, probability, outcome = np.zeros((3, 2, S, NUM_BINS))
    events[0, 0, 9], probability[0, 0, 9], outcome[0, 0, 9] = 4, 3.8, 3.0
    events[1, 1, 9], probability[1, 1, 9], outcome[1, 1, 9] = 4, 3.8, 4.0
    events[1, 1, 2], probability[1, 1, 2], outcome[1, 1, 2] = 2, 0.5, 1.0
    squared = np.zeros((2, S))
    squared[0, 0], squared[1, 1] = 0.4, 0.6
    planner = Reliability(
        events=events, probability=probability, outcome=outcome, squared_error=squared
    )
    found = scores(tally(planner=planner))
    # |7.6 − 7| + |0.5 − 1| over ten events.
    assert found["ece"] == pytest.approx(0.11)
    assert found["brier"] == pytest.approx(0.1)
    assert found["coverage90"] == pytest.approx(90.0)
    assert found["nll"] == pytest.approx(2.0)
    assert found["ece_map"] is None
    # Bin 9 has gaps of 0.8 and −0.2 in its two episodes, bin 2 one of −0.5.
    floor = np.sqrt(2 / np.pi) * (np.sqrt(0.8**2 + 0.2**2) + 0.5) / 10
    assert found["ece_floor"] == pytest.approx(floor)
    # Covered 4 of 4 and 5 of 6 where 90 % are: residuals 0.4 and −0.4 over ten steps.
    assert found["coverage90_se"] == pytest.approx(100 * np.sqrt(0.32) / 10)
    first = scores(tally(planner=planner), stage=0)
    # The first stage alone: four events, 3.8 believed and 3 happened.
    assert first["ece"] == pytest.approx(0.2)
    assert first["coverage90"] == pytest.approx(100.0)
    assert first["calibration_steps"] == 4.0
    nothing_seen = scores(tally())
    assert nothing_seen["ece"] is nothing_seen["brier"] is None
    no_goal = scores(empty(2))
    assert no_goal["coverage90"] is no_goal["coverage90_se"] is no_goal["nll"] is None


def test_events_go_into_the_bin_of_their_probability() -> None:
    probability = jnp.array([0.05, 0.55, 0.58, 1.0, 0.3])
    outcome = jnp.array([0.0, 1.0, 0.0, 1.0, 1.0])
    found = _reliability(probability, outcome, jnp.array([True, True, True, True, False]))
    assert found.events.tolist() == [1, 0, 0, 0, 0, 2, 0, 0, 0, 1]
    assert found.outcome.tolist() == [0, 0, 0, 0, 0, 1, 0, 0, 0, 1]
    np.testing.assert_allclose(found.probability[5], 1.13, rtol=1e-6)
    expected = 0.05**2 + 0.45**2 + 0.58**2
    np.testing.assert_allclose(found.squared_error, expected, rtol=1e-6)


def test_one_object_at_most_is_the_goal() -> None:
    """A false detection near the goal is not the goal, nor is anything of another type."""
    is_event = jnp.array([True, True, False, True])
    beside, alone = jnp.array([[0.1, 0.4, 0.05, 3.0], [2.0, 0.7, 0.1, 0.8]])
    far = jnp.array([0.8, 0.9, 0.1, 3.0])
    np.testing.assert_array_equal(matched_object(beside, is_event), [True, False, False, False])
    np.testing.assert_array_equal(matched_object(alone, is_event), [False, True, False, False])
    assert not matched_object(far, is_event).any()


def test_object_is_of_the_type_that_most_of_the_belief_has_it_of() -> None:
    """One particle that took the hydrant for a new cone does not make a cone of it."""
    belief = by_hand.with_objects(by_hand.begin(), [(by_hand.CONE, 2.0, 0.0)])
    kinds = np.asarray(belief.particles.object_type).copy()
    kinds[1], kinds[1, 0], kinds[2, :20] = by_hand.HYDRANT, by_hand.CONE, by_hand.HYDRANT
    particles = replace(belief.particles, object_type=jnp.asarray(kinds))
    seen = replace(belief, particles=particles)
    is_event = jax.jit(_has_type)(seen, jnp.int32(by_hand.HYDRANT))
    np.testing.assert_array_equal(is_event[:3], [False, True, False])
    assert not jax.jit(_has_type)(seen, jnp.int32(-1)).any()


def density(**changes: Any) -> GoalDensity:
    """One seen object of probability 0.7, sd 0.2 m, and 64 hypotheses far from it."""
    leaves: dict[str, Any] = {
        "objects": jnp.array([[0.0, 30.0], [0.0, 0.0]]),
        "object_mass": jnp.array([0.7, 0.0]),
        "object_variance": jnp.array([0.04, 0.04]),
        "hypotheses": jnp.stack([60.0 + jnp.arange(64.0), jnp.zeros(64)]),
        "hypothesis_mass": jnp.full(64, 0.3 / 64),
    }
    return replace(GoalDensity(**leaves), **changes)


RANK = jax.jit(_hpd_level)


def test_rank_within_a_seen_object_is_that_of_its_gaussian() -> None:
    """At radius r the share of a Gaussian that is denser is 1 − exp(−r² / 2s)."""
    for radius in (0.0, 0.1, 0.25, 0.5):
        below, log_density = RANK(density(), jnp.array([radius, 0.0]))
        assert float(below) == pytest.approx(0.7 * (1 - np.exp(-(radius**2) / 0.08)), abs=1e-4)
        peak = np.log(0.7 / (2 * np.pi * 0.04))
        assert float(log_density) == pytest.approx(peak - radius**2 / 0.08, abs=1e-3)


def test_a_truth_where_nothing_is_believed_ranks_last() -> None:
    below, log_density = RANK(density(), jnp.array([-40.0, 0.0]))
    assert float(below) == pytest.approx(1.0, abs=1e-4)
    assert float(log_density) == pytest.approx(np.log(1e-12), abs=1e-3)


def test_copies_of_a_hypothesis_do_not_make_it_denser_at_its_own_place() -> None:
    """Copies that resampling makes are one draw: 60 copies at one place, 4 about the truth."""
    places = jnp.zeros((2, 64)).at[0, 60:].set(jnp.array([8.0, 8.5, 9.0, 9.5]))
    even = {"object_mass": jnp.zeros(2), "hypothesis_mass": jnp.full(64, 1 / 64)}
    crowd = density(hypotheses=places, **even)
    below, _ = RANK(crowd, jnp.array([8.7, 0.0]))
    # Only those at 8.5 and 9 may count as likelier; the crowd has no density but its own.
    assert float(below) <= 3 / 64
    _, log_density = RANK(density(hypotheses=jnp.zeros((2, 64)), **even), jnp.zeros(2))
    assert float(log_density) == pytest.approx(-np.log(2 * np.pi * BANDWIDTH**2), abs=1e-5)


@jax.jit
@functools.partial(jax.vmap, in_axes=(0, None))
def rank(key: jax.Array, scale: float) -> jax.Array:
    """Rank a truth of a mixed law: half the time a seen object, half the time a wide law."""
    place_key, lot_key, near_key = jax.random.split(key, 3)
    places = jax.random.normal(place_key, (65, 2)) * jnp.array([[6.0, 2.0]])
    near = jnp.array([20.0, 0.0]) + 0.3 * jax.random.normal(near_key, (2,))
    truth = jnp.where(jax.random.bernoulli(lot_key), near, places[64])
    belief = density(
        objects=jnp.array([[20.0, 0.0], [0.0, 0.0]]),
        object_mass=jnp.array([0.5, 0.0]),
        object_variance=jnp.stack([(0.3 * scale) ** 2, jnp.float32(1.0)]),
        hypotheses=places[:64].T * scale,
        hypothesis_mass=jnp.full(64, 0.5 / 64),
    )
    return _hpd_level(belief, truth)[0]


def ranks(scale: float, seed: int) -> np.ndarray:
    return np.asarray(rank(jax.random.split(jax.random.key(seed), 4000), jnp.float32(scale)))


def test_ranks_are_uniform_for_a_truth_of_the_same_law() -> None:
    found = ranks(1.0, 0)
    count = np.histogram(found, bins=10, range=(0, 1 + 1e-6))[0]
    # 5 standard errors, and one part in 65 for the step of a rank among 64 draws.
    assert (np.abs(count / 4000 - 0.1) < 5 * np.sqrt(0.09 / 4000) + 1 / 130).all(), count
    assert abs((found <= 0.9).mean() - 0.9) < 5 * np.sqrt(0.09 / 4000) + 1 / 130


def test_a_belief_that_is_too_sure_or_not_sure_enough_is_found_out() -> None:
    assert (ranks(0.4, 1) <= 0.9).mean() < 0.6
    assert (ranks(2.5, 2) <= 0.9).mean() > 0.96


SQUARE = jnp.array([0.0, 16.0, 0.0, 16.0])


def test_places_drawn_are_of_the_law_of_what_is_unseen() -> None:
    log_miss = -np.random.default_rng(4).exponential(1.0, (8, 8)).astype(np.float32)
    coverage = replace(empty_coverage(SQUARE, 8), log_miss=jnp.asarray(log_miss))
    x, y = (np.asarray(one) for one in _sample_unseen(jax.random.key(0), coverage, 40_000))
    count = np.histogram2d(y, x, bins=8, range=[[0, 16], [0, 16]])[0]
    expected = np.exp(log_miss) / np.exp(log_miss).sum() * x.size
    assert count.sum() == x.size
    assert (np.abs(count - expected) < 5 * np.sqrt(expected) + 1).all()
    # Drawn each by itself: spread evenly, as the filter has them, they shun each other.
    assert ((count - expected) ** 2 / expected).sum() > 63 - 5 * np.sqrt(2 * 63)
    # Evenly within a cell.
    assert abs((x % 2).mean() - 1.0) < 5 * 2 / np.sqrt(12 * x.size)


@pytest.mark.slow
def test_every_step_of_an_episode_is_judged_once() -> None:
    sentences = ground_sentences([SENTENCES["behind"]])
    tasks = make_tasks(Cell(world="1H1C", relation="behind", seed=5), 40)
    # Three of the episodes have no goal that the belief could be compared with.
    goal_index = tasks.scenario.goal_index.at[:3].set(NONE)
    tasks = replace(tasks, scenario=replace(tasks.scenario, goal_index=goal_index))
    given: Any = {"params": default_params(), "config": navigator_config("informed", 16)}
    results, found = run_tasks(tasks, sentences.instructions, program=TALLY_PROGRAM, **given)
    judged = np.where(np.arange(40) < 3, 0, results.steps)
    np.testing.assert_array_equal(found.steps.sum(axis=1), judged)
    assert not found.negative_log_likelihood[:3].any()
    assert results.is_success.mean() > 0.8


# Reliability curves: sums over episodes, and intervals that know which steps are alike.


def tally_of(events: np.ndarray, outcome: np.ndarray, probability: float, at: int) -> Tally:
    """Events and outcomes by episode in one bin, in the first stage."""
    shape = (len(events), len(STAGES), NUM_BINS)
    none = empty(len(events))
    full = {name: np.zeros(shape, np.float32) for name in ("events", "outcome", "probability")}
    full["events"][:, 0, at] = events
    full["outcome"][:, 0, at] = outcome
    full["probability"][:, 0, at] = events * probability
    return replace(none, planner=replace(none.planner, **full))


def test_a_curve_by_hand() -> None:
    bins = bin_sums(tally_of(np.array([2, 1, 0]), np.array([1, 1, 0]), 0.65, at=6))["planner"]
    mean, rate, low, high, number = reliability_curve(bins)
    assert mean == pytest.approx([0.65])
    assert rate == pytest.approx([2 / 3])
    assert number == pytest.approx([3])
    assert bins["episodes"][6] == 2
    # Residuals 1 − 4/3 and 1 − 2/3: variance (2/9)/9, as of 9 independent events, but there are 3.
    assert (low[0], high[0]) == pytest.approx(wilson_interval(2, 3))
    assert sum(bin_sums(tally_of(np.ones(2), np.ones(2), 0.5, at=5))["map"]["events"]) == 0


def test_intervals_hold_what_they_promise() -> None:
    """Episodes of ten like steps: the 95 % interval holds the true rate about 95 times in 100."""
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(200):
        outcome = (rng.random(60) < 0.7).astype(float)
        found = bin_sums(tally_of(np.full(60, 10), 10 * outcome, 0.7, at=7))["planner"]
        _, _, low, high, _ = reliability_curve(found)
        held += low[0] <= 0.7 <= high[0]
    # Five standard errors of 200 draws at 0.95 are 0.077.
    assert 0.873 <= held / 200 <= 1.0


def test_rows_are_pooled() -> None:
    one = bin_sums(tally_of(np.array([2, 1]), np.array([1, 1]), 0.65, at=6))["planner"]
    two = bin_sums(tally_of(np.array([3]), np.array([0]), 0.65, at=6))["planner"]
    both = bin_sums(tally_of(np.array([2, 1, 3]), np.array([1, 1, 0]), 0.65, at=6))["planner"]
    sums = pool_bins([one, two])
    assert {name: list(values) for name, values in sums.items()} == {
        name: pytest.approx(values) for name, values in both.items()
    }
    assert reliability_curve(sums)[1] == pytest.approx([2 / 6])
