"""How far a source of rewritings is to be believed: one temperature, by maximum likelihood.

With log-probabilities s of the rewritings of a sentence that can be read, and R those of them that
mean what the sentence means, the likelihood of its label at temperature T is

    Σ_{i∈R} exp(sᵢ/T) / Σᵢ exp(sᵢ/T)

A sentence without a right rewriting among them has likelihood 0 at any temperature, one with none
but right ones has 1: neither says anything about T, and both are left out and counted.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

COLDEST, HOTTEST = 0.05, 20.0
"""Temperatures beyond these are not looked for."""
_GRID = 61
"""Temperatures at which the best is first looked for: the likelihood may have several peaks."""


@dataclass(frozen=True)
class Judged:
    """The rewritings of one labelled sentence that can be read."""

    log_probability: tuple[float, ...]
    is_right: tuple[bool, ...]

    @property
    def tells(self) -> bool:
        """Whether it says anything about the temperature."""
        return any(self.is_right) and not all(self.is_right)


@dataclass(frozen=True)
class TemperatureFit:
    """The likeliest temperature."""

    temperature: float
    log_likelihood: float  # mean over the sentences that tell anything
    log_likelihood_at_one: float  # the same at temperature 1
    used: int  # sentences
    left_out: int
    is_at_bound: bool  # it would be lower or higher still


def log_likelihood(sentences: Sequence[Judged], temperature: float) -> float:
    """Compute the mean log-likelihood of labels.

    Args:
        sentences: each with a right rewriting.
        temperature: above 0.

    Returns:
        The mean over the sentences, natural logarithm.
    """
    total = 0.0
    for one in sentences:
        scores = np.array(one.log_probability) / temperature
        total += np.logaddexp.reduce(scores[np.array(one.is_right)]) - np.logaddexp.reduce(scores)
    return float(total / len(sentences))


def fit_source_temperature(sentences: Sequence[Judged]) -> TemperatureFit:
    """Find the likeliest temperature.

    Args:
        sentences: labelled, with the rewritings that can be read.

    Returns:
        The temperature, between ``COLDEST`` and ``HOTTEST``.

    Raises:
        ValueError: no sentence tells anything about it; one line.
    """
    used = [one for one in sentences if one.tells]
    if not used:
        raise ValueError(
            f"none of the {len(sentences)} sentences has both a right and a wrong rewriting that "
            "can be read: record more of them"
        )

    def loss(log_temperature: float) -> float:
        return -log_likelihood(used, math.exp(log_temperature))

    grid = np.linspace(math.log(COLDEST), math.log(HOTTEST), _GRID)
    best = int(np.argmin([loss(one) for one in grid]))
    around = (grid[max(best - 1, 0)], grid[min(best + 1, _GRID - 1)])
    found = minimize(lambda at: loss(float(at[0])), x0=grid[best : best + 1], bounds=[around])
    is_at_bound = best in (0, _GRID - 1)
    temperature = math.exp(grid[best] if is_at_bound else found.x[0])
    return TemperatureFit(
        temperature=temperature,
        log_likelihood=log_likelihood(used, temperature),
        log_likelihood_at_one=log_likelihood(used, 1.0),
        used=len(used),
        left_out=len(sentences) - len(used),
        is_at_bound=is_at_bound,
    )
