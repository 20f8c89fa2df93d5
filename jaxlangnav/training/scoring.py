"""How often each of many models is right on the sentences held out from it (section 4.1).

A sentence counts as right when the likeliest sets of symbols at the roots of its clauses are the
gold ones, whatever the ranks. Confidence is the probability of those sets.

The splits of a hold-out differ in their weights alone. So a sentence is described once, and
searched by all models that have not seen it together (``search``).
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import chex
import numpy as np

from jaxlangnav.grounding.correspondence import AnyWorld, Labelled, SymbolSpace, WeighedTree
from jaxlangnav.grounding.model import CorrespondenceModel, Vocabulary
from jaxlangnav.grounding.properties import Annotations, Behaviors
from jaxlangnav.grounding.search import BEAM_WIDTH
from jaxlangnav.grounding.symbols import Path
from jaxlangnav.language.phrase import Phrase
from jaxlangnav.training.examples import LabelledInstruction

LOG_FLOOR = -12.0
"""Log-probability that a gold answer counts with where the beam has not got it."""


@dataclasses.dataclass(frozen=True)
class _Judged:
    is_right: np.ndarray  # bool[E]

    @property
    def accuracy(self) -> float:
        """Share that is right."""
        return float(self.is_right.mean()) if len(self.is_right) else float("nan")


@dataclasses.dataclass(frozen=True)
class Scores(_Judged):
    """Results on labelled sentences (and worlds)."""

    confidence: np.ndarray  # f64[E] probability of the answer given
    log_gold: np.ndarray  # f64[E] log-probability of the gold answer, floored


@dataclasses.dataclass(frozen=True)
class ExactScores(_Judged):
    """Results of the likeliest set of all, by enumeration as far as it is needed."""

    is_proven: np.ndarray  # bool[E] no other set can be likelier (``search.search_exactly``)


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


class _Tally:
    """Results of K models as they come in."""

    def __init__(self, num_models: int, widths: Sequence[int], is_exact: bool) -> None:
        """Begin with none."""
        self.rows = {width: [[] for _ in range(num_models)] for width in widths}
        self.exact = [[] for _ in range(num_models)] if is_exact else []

    def results(self) -> Results:
        """Stack what has come in."""

        def scores(rows: list[tuple[bool, float, float]]) -> Scores:
            right, confidence, log_gold = np.array(rows, float).reshape(-1, 3).T
            return Scores(right.astype(bool), confidence, log_gold)

        return Results(
            {width: [scores(rows) for rows in models] for width, models in self.rows.items()},
            [ExactScores(*np.array(rows, bool).reshape(-1, 2).T) for rows in self.exact],
        )


def _tested(
    instructions: Sequence[LabelledInstruction],
    is_tested: np.ndarray | None,
    num_models: int,
    on_sentence: Callable[[], None],
) -> Iterator[tuple[LabelledInstruction, np.ndarray]]:
    """Yield sentences with the models i[M] that are tested on them, bool[K, I]; by default all."""
    shape = num_models, len(instructions)
    is_tested = np.ones(shape, bool) if is_tested is None else is_tested
    chex.assert_shape(is_tested, shape)
    chex.assert_type(is_tested, bool)
    for labelled, tested in zip(instructions, is_tested.T, strict=True):
        which = np.flatnonzero(tested)
        if len(which):
            yield labelled, which
        on_sentence()


def score_annotations(
    instructions: Sequence[LabelledInstruction],
    models: Models,
    is_tested: np.ndarray | None,
    type_names: tuple[str, ...],
    *,
    widths: Sequence[int] = (BEAM_WIDTH,),
    is_exact: bool = False,
    on_sentence: Callable[[], None] = lambda: None,
) -> Results:
    """Compare inferred annotations with the gold ones, one result per model and sentence.

    Args:
        instructions: I labelled sentences.
        models: K annotation models.
        is_tested: bool[K, I], which sentences each model is tested on; all by default.
        type_names: object types.
        widths: beam widths.
        is_exact: also find the likeliest of all sets.
        on_sentence: called after each sentence.
    """
    tally = _Tally(num := len(models.temperature), widths, is_exact)
    for labelled, which in _tested(instructions, is_tested, num, on_sentence):
        _count(tally, which, models.take(which), Annotations(type_names), labelled.annotated)
    return tally.results()


def _by_rank(
    labelled: LabelledInstruction, annotation: Models, type_names: tuple[str, ...]
) -> Iterator[tuple[np.ndarray, dict[Path, int]]]:
    """Group models by the ranks they infer: i[M] models, and rank by phrase."""
    ranks: dict[Path, np.ndarray] = {}  # i[M] each
    for tree in _weighed(annotation, Annotations(type_names), labelled.annotated):
        ranks |= {path: chances.argmax(1) for path, chances in tree.log_ranks().items()}
    rows, which = np.unique(np.stack([*ranks.values()], axis=1), axis=0, return_inverse=True)
    for group, row in enumerate(rows.tolist()):
        yield np.flatnonzero(which.ravel() == group), dict(zip(ranks, row, strict=True))


def score_behaviors(
    instructions: Sequence[LabelledInstruction],
    annotation: Models,
    behavior: Models,
    is_tested: np.ndarray | None,
    type_names: tuple[str, ...],
    *,
    widths: Sequence[int] = (BEAM_WIDTH,),
    is_exact: bool = False,
    on_sentence: Callable[[], None] = lambda: None,
) -> Results:
    """Compare inferred behaviors with the gold ones, one result per model, sentence and world.

    Of K behavior models, and K annotation models for ranks ("the second"); the rest as in
    ``score_annotations``.
    """
    chex.assert_equal_shape([annotation.temperature, behavior.temperature])
    tally = _Tally(num := len(behavior.temperature), widths, is_exact)
    for labelled, which in _tested(instructions, is_tested, num, on_sentence):
        for group, rank in _by_rank(labelled, annotation.take(which), type_names):
            own, space = behavior.take(which[group]), Behaviors(type_names, rank)
            for trees in labelled.behaving:
                _count(tally, which[group], own, space, trees)
    return tally.results()


def _weighed(
    models: Models, space: SymbolSpace[AnyWorld], trees: Sequence[Labelled[AnyWorld]]
) -> list[WeighedTree[AnyWorld]]:
    return [
        WeighedTree(space, models.coefficients, one.root, one.world, one.clause) for one in trees
    ]


def _count(
    tally: _Tally,
    which: np.ndarray,
    models: Models,
    space: SymbolSpace[AnyWorld],
    labelled: Sequence[Labelled[AnyWorld]],
) -> None:
    """Compare what models, i[M] of all, infer of the clauses of a sentence with the gold sets."""
    trees = _weighed(models, space, labelled)
    gold = [tree.symbols.mask(one.expressed[-1]) for tree, one in zip(trees, labelled, strict=True)]
    for width, rows in tally.rows.items():
        right, confidence = np.ones(len(which), bool), np.ones(len(which))
        log_gold = np.zeros(len(which))
        for tree, own in zip(trees, gold, strict=True):
            beams = tree.beams(width)
            log_probability = beams.log_probability
            is_gold = (beams.sets == own).all(1)[beams.index] & np.isfinite(log_probability)
            right &= is_gold[:, 0]
            confidence *= np.exp(log_probability[:, 0])
            found = np.take_along_axis(log_probability, is_gold.argmax(1)[:, None], 1)[:, 0]
            log_gold += np.where(is_gold.any(1), found, LOG_FLOOR)
        log_gold = np.maximum(log_gold, LOG_FLOOR)
        for model, *row in zip(which, right, confidence, log_gold, strict=True):
            rows[model].append(tuple(row))
    if tally.exact:
        right = proven = np.ones(len(which), bool)
        for tree, own in zip(trees, gold, strict=True):
            best, is_sure = tree.search_exactly()
            right, proven = right & (best == own).all(1), proven & is_sure
        for model, *row in zip(which, right, proven, strict=True):
            tally.exact[model].append(tuple(row))


def calibration_error(scores: Scores, num_bins: int = 10) -> float:
    """Compute the expected calibration error, in [0, 1]; 0 is perfectly calibrated.

    ECE = Σ_b n_b / n · |accuracy_b − confidence_b|      over ``num_bins`` of equal width
    """
    bins = np.minimum((scores.confidence * num_bins).astype(int), num_bins - 1)
    gap = scores.is_right.astype(float) - scores.confidence
    total = np.bincount(bins, weights=gap, minlength=num_bins)
    return float(np.abs(total).sum() / max(len(gap), 1))


TEMPERATURES = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.15, 1.3, 1.5, 1.75, 2.0)


def fit_temperature(score: Callable[[float], Scores]) -> float:
    """Choose of ``TEMPERATURES`` the one under which gold answers held out are likeliest."""
    return max(TEMPERATURES, key=lambda t: float(score(t).log_gold.mean()))
