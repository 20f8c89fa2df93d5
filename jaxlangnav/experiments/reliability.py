"""Reliability curves, and the episode program with calibration sums at every step."""

import operator
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import jax
import numpy as np

from jaxlangnav.episode import EpisodeState, advance, begin, finish
from jaxlangnav.episode.lanes import EpisodeProgram
from jaxlangnav.experiments.calibration import Reliability, Tally, empty_tally, tally_step
from jaxlangnav.experiments.metrics import wilson_interval
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams
from jaxlangnav.pytree import pytree


@pytree
class _State:
    """State of an episode, with the calibration sums of its steps so far."""

    episode: EpisodeState
    tally: Tally


def _advance_and_tally(
    state: _State, *, params: NavigatorParams, config: NavigatorConfig
) -> tuple[_State, None]:
    after, info, _ = advance(state.episode, params=params, config=config)
    step = tally_step(state.episode, info, after)
    return _State(episode=after, tally=jax.tree.map(operator.add, state.tally, step)), None


TALLY_PROGRAM = EpisodeProgram(
    begin=lambda *args, config: _State(episode=begin(*args, config=config), tally=empty_tally()),
    advance=_advance_and_tally,
    finish=lambda state: (finish(state.episode), state.tally),
    episode_state=operator.attrgetter("episode"),
    is_done=operator.attrgetter("episode.navigator.is_done"),
)
"""Program for ``run_tasks``: runs episodes as usual; returns the result and ``Tally`` of each."""
Bins: TypeAlias = Mapping[str, Sequence[float]]
"""Sums by bin: ``events``, ``probability``, ``outcome``, ``episodes``; and over episodes sums of
squared events and outcomes, ``events2`` and ``outcome2``, and of their product, ``cross``."""


def bin_sums(tally: Tally) -> dict[str, dict[str, list[float]]]:
    """Sum the events of episodes, leaves [E, S, …], to ``Bins`` of ``planner`` and ``map``."""

    def totals(reliability: Reliability) -> dict[str, list[float]]:
        per_episode = {
            name: np.asarray(getattr(reliability, name), np.float64).sum(axis=1)
            for name in ("events", "probability", "outcome")
        }
        events, outcome = per_episode["events"], per_episode["outcome"]
        per_episode |= {
            "episodes": events > 0,
            "events2": events**2,
            "outcome2": outcome**2,
            "cross": events * outcome,
        }
        return {key: sums.sum(axis=0, dtype=float).tolist() for key, sums in per_episode.items()}

    return {"planner": totals(tally.planner), "map": totals(tally.map)}


def pool_bins(parts: Iterable[Bins]) -> dict[str, np.ndarray]:
    """Add the bins of several rows of a table, at least one: f64[B] by name."""
    bins = list(parts)
    return {name: np.sum([part[name] for part in bins], axis=0) for name in bins[0]}


def reliability_curve(bins: Mapping[str, Any]) -> tuple[np.ndarray, ...]:
    """Compute a reliability curve from sums by bin.

    For each nonempty bin: mean probability, observed frequency, lower and upper end of its 95 %
    interval, number of events. The interval is Wilson's, for the effective number of independent
    events (from the variance between episodes); for the number of episodes if they all agree.
    """
    nonempty = np.asarray(bins["events"]) > 0
    sum_of = {name: np.asarray(values, float)[nonempty] for name, values in bins.items()}
    rate, events = sum_of["outcome"] / sum_of["events"], sum_of["events"]
    sum_squares = sum_of["outcome2"] - 2 * rate * sum_of["cross"] + rate**2 * sum_of["events2"]
    variance = sum_squares / events**2
    effective = rate * (1 - rate) / np.maximum(variance, 1e-12)
    trials = np.where(variance > 1e-12, effective, sum_of["episodes"])
    counts = np.maximum(1, np.clip(trials, 1.0, events).astype(int))
    intervals = [wilson_interval(round(p * n), int(n)) for p, n in zip(rate, counts, strict=True)]
    lower, upper = np.reshape(intervals, (-1, 2)).T
    mean = sum_of["probability"] / events
    # Rounding the successes may move the interval off the rate; widen it to contain the rate.
    return mean, rate, np.minimum(lower, rate), np.maximum(upper, rate), events
