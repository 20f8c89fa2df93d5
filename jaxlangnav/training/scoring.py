"""Accuracy and calibration of models on held-out sentences (section 4.1).

A sentence is correct if the likeliest sets of symbols at the roots of its clauses are the gold
ones, regardless of ranks. Confidence is the probability of those sets.

Models of different splits differ only in their weights, so the features of a sentence are computed
once for all models that are tested on it.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import chex
import numpy as np

from jaxlangnav.grounding.correspondence import (
    AnyWorld,
    Labelled,
    ScoredTree,
    SymbolSpace,
    TreeFeatures,
)
from jaxlangnav.grounding.model import CorrespondenceModel
from jaxlangnav.grounding.properties import Annotations, Behaviors
from jaxlangnav.grounding.search import BEAM_WIDTH, search_exactly
from jaxlangnav.grounding.symbols import Path
from jaxlangnav.training.examples import LabelledInstruction

LOG_FLOOR = -12.0
"""Log-probability assigned to a gold answer that the beam does not contain."""


@dataclasses.dataclass(frozen=True)
class _Accuracy:
    is_right: np.ndarray  # bool[E]

    @property
    def accuracy(self) -> float:
        """Fraction that is correct."""
        return float(self.is_right.mean()) if len(self.is_right) else float("nan")


@dataclasses.dataclass(frozen=True)
class Scores(_Accuracy):
    """Beam search results on labelled sentences (and worlds)."""

    confidence: np.ndarray  # f64[E] probability of the inferred answer
    log_gold: np.ndarray  # f64[E] log-probability of the gold answer, floored


@dataclasses.dataclass(frozen=True)
class ExactScores(_Accuracy):
    """Results of exact inference, by beams that widen until the best set is proven."""

    is_proven: np.ndarray  # bool[E] no other set can be likelier (``search.search_exactly``)


class Results(NamedTuple):
    """Scores of K models, in the order of sentences and worlds."""

    by_width: dict[int, list[Scores]]  # beam width → K scores
    exact: list[ExactScores]  # K scores; empty without exact search


class _Accumulator:
    """Accumulator of the results of K models."""

    def __init__(self, num_models: int, widths: Sequence[int], is_exact: bool) -> None:
        self.rows = {width: [[] for _ in range(num_models)] for width in widths}
        self.exact = [[] for _ in range(num_models)] if is_exact else []

    def add(self, index: int, model: CorrespondenceModel, clauses: "Clauses") -> None:
        """Compare a model's inferred sets for the clauses of a sentence with the gold sets."""
        trees = [(ScoredTree(described, model), gold) for described, gold in clauses]
        for width, rows in self.rows.items():
            is_right, confidence, log_gold = True, 1.0, 0.0
            for tree, gold in trees:
                beam = tree.search(width)
                is_gold = [bool((h.expressed == gold).all()) for h in beam]
                is_right &= is_gold[0]
                confidence *= np.exp(beam[0].log_probability)
                matches = itertools.compress(beam, is_gold)
                log_gold += next((h.log_probability for h in matches), LOG_FLOOR)
            rows[index].append((is_right, confidence, max(log_gold, LOG_FLOOR)))
        if self.exact:
            exact = [(*search_exactly(tree.search), gold) for tree, gold in trees]
            is_right = all((inferred == gold).all() for inferred, _, gold in exact)
            self.exact[index].append((is_right, all(is_proven for _, is_proven, _ in exact)))

    def results(self) -> Results:
        """Stack the accumulated results."""

        def scores(rows: list[tuple[bool, float, float]]) -> Scores:
            is_right, confidence, log_gold = np.array(rows, float).reshape(-1, 3).T
            return Scores(is_right.astype(bool), confidence, log_gold)

        return Results(
            {width: [scores(rows) for rows in models] for width, models in self.rows.items()},
            [ExactScores(*np.array(rows, bool).reshape(-1, 2).T) for rows in self.exact],
        )


Clauses = Sequence[tuple[TreeFeatures, np.ndarray]]
"""The clauses of a sentence in a world, each with the gold set bool[S]."""


def _features(space: SymbolSpace[AnyWorld], labelled: Sequence[Labelled[AnyWorld]]) -> Clauses:
    features = [TreeFeatures(space, tree.root, tree.world, tree.clause) for tree in labelled]
    gold = [tree.expressed[-1] for tree in labelled]
    return [(tree, tree.symbols.mask(root)) for tree, root in zip(features, gold, strict=True)]


@dataclasses.dataclass(frozen=True)
class Scorer:
    """Compares what models infer from labelled sentences with the gold sets."""

    instructions: Sequence[LabelledInstruction]
    type_names: tuple[str, ...]
    is_tested: np.ndarray | None = None  # bool[K, I], on which each model is tested; None: all
    _: dataclasses.KW_ONLY
    widths: Sequence[int] = (BEAM_WIDTH,)
    is_exact: bool = False  # also find the likeliest of all sets
    on_sentence: Callable[[], None] = lambda: None  # called after each sentence

    def annotations(self, models: Sequence[CorrespondenceModel]) -> Results:
        """Score K annotation models, one result per model and sentence."""
        accumulator = _Accumulator(len(models), self.widths, self.is_exact)
        for labelled, indices in self._tested(len(models)):
            clauses = _features(Annotations(self.type_names), labelled.annotations)
            for index in indices:
                accumulator.add(index, models[index], clauses)
        return accumulator.results()

    def behaviors(
        self, annotation: Sequence[CorrespondenceModel], behavior: Sequence[CorrespondenceModel]
    ) -> Results:
        """Score K behavior models, one result per model, sentence and world.

        The K annotation models infer ranks ("the second").
        """
        chex.assert_equal(len(annotation), len(behavior))
        accumulator = _Accumulator(len(behavior), self.widths, self.is_exact)
        for labelled, indices in self._tested(len(behavior)):
            annotations = _features(Annotations(self.type_names), labelled.annotations)
            worlds: dict[tuple[int, ...], list[Clauses]] = {}  # by the ranks that a model infers
            for index in indices:
                rank: dict[Path, int] = {}
                for described, _ in annotations:
                    log_ranks = ScoredTree(described, annotation[index]).log_ranks()
                    rank |= {path: int(np.argmax(values)) for path, values in log_ranks.items()}
                if (key := tuple(rank.values())) not in worlds:
                    space = Behaviors(self.type_names, rank)
                    worlds[key] = [_features(space, trees) for trees in labelled.behaviors]
                for clauses in worlds[key]:
                    accumulator.add(index, behavior[index], clauses)
        return accumulator.results()

    def _tested(self, num_models: int) -> Iterator[tuple[LabelledInstruction, np.ndarray]]:
        """Yield sentences with indices i[M] of the models tested on them."""
        shape = num_models, len(self.instructions)
        is_tested = np.ones(shape, bool) if self.is_tested is None else self.is_tested
        chex.assert_shape(is_tested, shape)
        chex.assert_type(is_tested, bool)
        for labelled, mask in zip(self.instructions, is_tested.T, strict=True):
            indices = np.flatnonzero(mask)
            if len(indices):
                yield labelled, indices
            self.on_sentence()


def calibration_error(scores: Scores) -> float:
    """Compute the expected calibration error, in [0, 1]; 0 is perfectly calibrated.

    ECE = Σ_b n_b / n · |accuracy_b − confidence_b|      over ten bins of equal width
    """
    bins = np.minimum((scores.confidence * 10).astype(int), 9)
    gap = scores.is_right.astype(float) - scores.confidence
    total = np.bincount(bins, weights=gap)
    return float(np.abs(total).sum() / max(len(gap), 1))


TEMPERATURES = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.15, 1.3, 1.5, 1.75, 2.0)


def fit_temperature(score: Callable[[float], Scores]) -> float:
    """Select the temperature of greatest log-probability of held-out gold answers.

    Limits: without answers, or where none is any likelier, it is 1.
    """
    return max(TEMPERATURES, key=lambda t: (float(score(t).log_gold.sum()), -abs(math.log(t))))
