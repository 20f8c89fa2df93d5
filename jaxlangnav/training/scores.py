"""What is held against the gold answers: many models side by side, and what each of them got."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxlangnav.grounding.model import CorrespondenceModel, Vocabulary
from jaxlangnav.language.phrase import Phrase


@dataclasses.dataclass(frozen=True)
class Scores:
    """Results on labelled sentences (and worlds)."""

    is_right: np.ndarray  # bool[E]
    confidence: np.ndarray  # f64[E] probability of the answer given
    log_gold: np.ndarray  # f64[E] log-probability of the gold answer, floored

    @property
    def accuracy(self) -> float:
        """Share that is right."""
        return float(self.is_right.mean()) if len(self.is_right) else float("nan")


@dataclasses.dataclass(frozen=True)
class ExactScores:
    """Results of the likeliest set of all, by enumeration as far as it is needed."""

    is_right: np.ndarray  # bool[E]
    is_proven: np.ndarray  # bool[E] no other set can be likelier (``search_exactly``)

    @property
    def accuracy(self) -> float:
        """Share that is right."""
        return float(self.is_right.mean()) if len(self.is_right) else float("nan")


class Results(NamedTuple):
    """What each of K models got, in the order of its sentences and their worlds."""

    by_width: dict[int, list[Scores]]  # beam width → K scores
    exact: list[ExactScores]  # K scores; empty where the exact search was left out


@dataclasses.dataclass(frozen=True)
class Models:
    """K models of one vocabulary side by side."""

    vocabulary: Vocabulary
    weights: dict[str, np.ndarray]  # kind → f32[K, W, F]
    temperature: np.ndarray  # f32[K]

    @classmethod
    def of(cls, models: Sequence[CorrespondenceModel]) -> "Models":
        """Stack models of one vocabulary."""
        stacked = {kind: np.stack([m.weights[kind] for m in models]) for kind in models[0].weights}
        temperature = np.array([model.temperature for model in models], np.float32)
        return cls(models[0].vocabulary, stacked, temperature)

    def take(self, which: np.ndarray) -> "Models":
        """Choose models, i[M]."""
        chosen = {kind: weight[which] for kind, weight in self.weights.items()}
        return Models(self.vocabulary, chosen, self.temperature[which])

    def coefficients(self, phrase: Phrase) -> dict[str, np.ndarray]:
        """Contract a phrase's words, f32[K, F] a kind; see ``CorrespondenceModel.coefficients``."""
        vector = self.vocabulary.vector(phrase)
        on = np.flatnonzero(vector)
        values = vector[on] / self.temperature[:, None]
        return {
            kind: np.einsum("kw,kwf->kf", values, weight[:, on])
            for kind, weight in self.weights.items()
        }


class Tallied:
    """Results of K models as they come in."""

    def __init__(self, num_models: int, widths: Sequence[int], is_exact: bool) -> None:
        """Begin with none."""
        self.rows = {width: [[] for _ in range(num_models)] for width in widths}
        self.exact = [[] for _ in range(num_models)] if is_exact else []

    def results(self) -> Results:
        """Stack what has come in."""

        def scores(rows: list[tuple[bool, float, float]]) -> Scores:
            right, confidence, log_gold = zip(*rows, strict=True) if rows else ((), (), ())
            return Scores(np.array(right, bool), np.array(confidence), np.array(log_gold))

        return Results(
            {width: [scores(rows) for rows in models] for width, models in self.rows.items()},
            [ExactScores(*np.array(rows, bool).reshape(-1, 2).T) for rows in self.exact],
        )
