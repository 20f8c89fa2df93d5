"""How often each of many models is right on the sentences held out from it (section 4.1).

A sentence counts as right when the likeliest sets of symbols at the roots of its clauses are the
gold ones, whatever the ranks. Confidence is the probability of those sets.

The splits of a hold-out differ in their weights alone. So a sentence is described once for all
models that have not seen it.
"""

import dataclasses
import itertools
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


class _Tally:
    """Results of K models as they come in."""

    def __init__(self, num_models: int, widths: Sequence[int], is_exact: bool) -> None:
        """Begin with none."""
        self.rows = {width: [[] for _ in range(num_models)] for width in widths}
        self.exact = [[] for _ in range(num_models)] if is_exact else []

    def count(self, index: int, model: CorrespondenceModel, clauses: "Clauses") -> None:
        """Compare what a model infers of the clauses of a sentence with the gold sets."""
        trees = [(ScoredTree(described, model), gold) for described, gold in clauses]
        for width, rows in self.rows.items():
            right, confidence, log_gold = True, 1.0, 0.0
            for tree, gold in trees:
                beam = tree.search(width)
                is_gold = [bool((one.expressed == gold).all()) for one in beam]
                right &= is_gold[0]
                confidence *= np.exp(beam[0].log_probability)
                gold_ones = itertools.compress(beam, is_gold)
                log_gold += next((one.log_probability for one in gold_ones), LOG_FLOOR)
            rows[index].append((right, confidence, max(log_gold, LOG_FLOOR)))
        if self.exact:
            best = [(*search_exactly(tree.search), gold) for tree, gold in trees]
            right = all((found == gold).all() for found, _, gold in best)
            self.exact[index].append((right, all(is_proven for _, is_proven, _ in best)))

    def results(self) -> Results:
        """Stack what has come in."""

        def scores(rows: list[tuple[bool, float, float]]) -> Scores:
            right, confidence, log_gold = np.array(rows, float).reshape(-1, 3).T
            return Scores(right.astype(bool), confidence, log_gold)

        return Results(
            {width: [scores(rows) for rows in models] for width, models in self.rows.items()},
            [ExactScores(*np.array(rows, bool).reshape(-1, 2).T) for rows in self.exact],
        )


Clauses = Sequence[tuple[TreeFeatures, np.ndarray]]
"""The clauses of a sentence in a world, each with the gold set bool[S]."""


def _described(space: SymbolSpace[AnyWorld], labelled: Sequence[Labelled[AnyWorld]]) -> Clauses:
    trees = [TreeFeatures(space, one.root, one.world, one.clause) for one in labelled]
    gold = [one.expressed[-1] for one in labelled]
    return [(tree, tree.symbols.mask(own)) for tree, own in zip(trees, gold, strict=True)]


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
    models: Sequence[CorrespondenceModel],
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
    tally = _Tally(len(models), widths, is_exact)
    for labelled, which in _tested(instructions, is_tested, len(models), on_sentence):
        clauses = _described(Annotations(type_names), labelled.annotated)
        for index in which:
            tally.count(index, models[index], clauses)
    return tally.results()


def score_behaviors(
    instructions: Sequence[LabelledInstruction],
    annotation: Sequence[CorrespondenceModel],
    behavior: Sequence[CorrespondenceModel],
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
    chex.assert_equal(len(annotation), len(behavior))
    tally = _Tally(len(behavior), widths, is_exact)
    for labelled, which in _tested(instructions, is_tested, len(behavior), on_sentence):
        said = _described(Annotations(type_names), labelled.annotated)
        worlds: dict[tuple[int, ...], list[Clauses]] = {}  # by the ranks that a model infers
        for index in which:
            rank: dict[Path, int] = {}
            for described, _ in said:
                found = ScoredTree(described, annotation[index]).log_ranks()
                rank |= {path: int(np.argmax(chances)) for path, chances in found.items()}
            if (key := tuple(rank.values())) not in worlds:
                space = Behaviors(type_names, rank)
                worlds[key] = [_described(space, trees) for trees in labelled.behaving]
            for clauses in worlds[key]:
                tally.count(index, behavior[index], clauses)
    return tally.results()


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
