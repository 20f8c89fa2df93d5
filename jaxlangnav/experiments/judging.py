"""Episodes that are judged step by step as they run (``calibration``)."""

import operator
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import jax
import numpy as np

from jaxlangnav.episode import EpisodeState, advance, begin, finish
from jaxlangnav.episode.lanes import EpisodeProgram
from jaxlangnav.experiments.calibration import Reliability, Tally, nothing, tally_step
from jaxlangnav.experiments.metrics import wilson_interval
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams
from jaxlangnav.pytree import pytree


@pytree
class _Judged:
    """An episode under way, and what its steps have come to."""

    progress: EpisodeState
    tally: Tally


def _advance_judged(
    state: _Judged, *, params: NavigatorParams, config: NavigatorConfig
) -> tuple[_Judged, None]:
    after, info = advance(state.progress, params=params, config=config)
    one = tally_step(state.progress, info, after)
    return _Judged(progress=after, tally=jax.tree.map(operator.add, state.tally, one)), None


JUDGED = EpisodeProgram(
    begin=lambda *given, config: _Judged(progress=begin(*given, config=config), tally=nothing()),
    advance=_advance_judged,
    finish=lambda state: (finish(state.progress), state.tally),
    progress=operator.attrgetter("progress"),
)
"""Of ``run_tasks``: runs episodes as usual, and gives results and ``Tally`` of each."""


Bins: TypeAlias = Mapping[str, Sequence[float]]
"""Sums by bin: ``events``, ``probability``, ``outcome``, ``episodes``; over episodes the squares of
their events and outcomes, ``events2`` and ``outcome2``, and the product of both, ``cross``."""


def bin_sums(tally: Tally) -> dict[str, dict[str, list[float]]]:
    """Sum up events of episodes, leaves [E, S, …], into ``Bins`` of ``planner`` and of ``map``."""

    def sums(found: Reliability) -> dict[str, list[float]]:
        events, probability, outcome = (
            np.asarray(leaf, np.float64).sum(axis=1)
            for leaf in (found.events, found.probability, found.outcome)
        )
        by_episode = {
            "events": events,
            "probability": probability,
            "outcome": outcome,
            "episodes": events > 0,
            "events2": events**2,
            "outcome2": outcome**2,
            "cross": events * outcome,
        }
        return {name: of.sum(axis=0, dtype=float).tolist() for name, of in by_episode.items()}

    return {"planner": sums(tally.planner), "map": sums(tally.map)}


def pooled(parts: Iterable[Bins]) -> dict[str, np.ndarray]:
    """Add up the bins of several rows of a table, at least one: f64[B] by name."""
    listed = list(parts)
    return {name: np.sum([part[name] for part in listed], axis=0) for name in listed[0]}


def curve(bins: Mapping[str, Any]) -> tuple[np.ndarray, ...]:
    """Turn sums by bin into a reliability curve.

    Of each bin that is not empty: mean probability, share that came true, lower and upper end of
    its 95 % interval, number of events. The interval is Wilson's, of as many independent events as
    have the variance between episodes; of as many episodes where they all agree.
    """
    sums = {name: np.asarray(values, float) for name, values in bins.items()}
    used = sums["events"] > 0
    total = {name: values[used] for name, values in sums.items()}
    rate, events = total["outcome"] / total["events"], total["events"]
    spread = total["outcome2"] - 2 * rate * total["cross"] + rate**2 * total["events2"]
    variance = spread / events**2
    independent = rate * (1 - rate) / np.maximum(variance, 1e-12)
    trials = np.where(variance > 1e-12, independent, total["episodes"])
    numbers = np.maximum(1, np.clip(trials, 1.0, events).astype(int))
    ends = [wilson_interval(round(one * n), int(n)) for one, n in zip(rate, numbers, strict=True)]
    low, high = np.reshape(ends, (-1, 2)).T
    mean = total["probability"] / events
    # Rounding the successes moves the middle by less than half a trial; the rate stays inside.
    return mean, rate, np.minimum(low, rate), np.maximum(high, rate), events
