"""How often a model is right, and how well it knows (section 4.1).

A sentence counts as right when the likeliest set of symbols at the roots of its clauses is exactly
the gold one. Confidence is the probability of that set.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from jaxlangnav.grounding.annotation import Belief, annotation_log_odds, infer_annotations
from jaxlangnav.grounding.behavior_features import World
from jaxlangnav.grounding.behavior_search import behavior_log_odds, infer_behavior_sets
from jaxlangnav.grounding.examples import LabelledInstruction, Path
from jaxlangnav.grounding.model import CorrespondenceModel
from jaxlangnav.grounding.search import BEAM_WIDTH, search_exactly
from jaxlangnav.grounding.symbols import Annotation, AnnotationSpace, BehaviorSpace
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


_LOG_FLOOR = -12.0


def gold_annotations(labelled: LabelledInstruction) -> frozenset[Annotation]:
    """Join the gold annotations at the roots of all clauses."""
    roots = (labelled.annotation[(i,)] for i in range(len(labelled.parse.clauses)))
    return frozenset().union(*roots)


def _score_annotation(belief: Belief, gold: frozenset[Annotation]) -> tuple[bool, float, float]:
    """Compare a belief with the gold set, ranks summed out."""
    chance: dict[frozenset[Annotation], float] = {}
    for said, log_probability in belief.sets:
        symbols = frozenset(symbol for symbol, _ in said)
        chance[symbols] = chance.get(symbols, 0.0) + float(np.exp(log_probability))
    best = max(chance, key=lambda symbols: chance[symbols])
    log_gold = max(np.log(chance.get(gold, 0.0) + 1e-300), _LOG_FLOOR)
    return best == gold, chance[best], log_gold


def _collect(rows: Sequence[tuple[bool, float, float]]) -> Scores:
    """Stack single results."""
    right, confidence, log_gold = zip(*rows, strict=True) if rows else ((), (), ())
    return Scores(np.array(right, bool), np.array(confidence), np.array(log_gold))


def score_annotations(
    instructions: Sequence[LabelledInstruction],
    model: CorrespondenceModel,
    type_names: tuple[str, ...],
    width: int = BEAM_WIDTH,
) -> Scores:
    """Compare inferred annotations with the gold ones, one result per sentence.

    Args:
        instructions: labelled sentences.
        model: annotation model.
        type_names: object types.
        width: beam width.

    Returns:
        Results in the order of the sentences.
    """
    return _collect(
        [
            _score_annotation(
                infer_annotations(labelled.parse, model, type_names, width),
                gold_annotations(labelled),
            )
            for labelled in instructions
        ]
    )


class _Case(NamedTuple):
    """A labelled sentence in one of its worlds."""

    world: World
    rank: dict[Path, int]
    wanted: list[tuple[int, Phrase, np.ndarray]]  # clause, its root, bool[S] its gold symbols


def _cases(
    instructions: Sequence[LabelledInstruction],
    annotation: CorrespondenceModel,
    type_names: tuple[str, ...],
) -> Iterator[_Case]:
    """Go through the worlds of all sentences; clauses without a gold behavior are left out."""
    for labelled in instructions:
        if not labelled.worlds:
            continue
        rank = infer_annotations(labelled.parse, annotation, type_names).rank
        for world, gold in zip(labelled.worlds, labelled.behavior, strict=True):
            space = BehaviorSpace(world.object_type.shape[0])
            wanted = [
                (clause, root, space.mask(gold[(clause,)]))
                for clause, root in enumerate(labelled.parse.clauses)
                if (clause,) in gold
            ]
            yield _Case(world, rank, wanted)


def score_behaviors(
    instructions: Sequence[LabelledInstruction],
    annotation: CorrespondenceModel,
    behavior: CorrespondenceModel,
    type_names: tuple[str, ...],
    width: int = BEAM_WIDTH,
) -> Scores:
    """Compare inferred behaviors with the gold ones, one result per sentence and world.

    Args:
        instructions: labelled sentences with worlds.
        annotation: annotation model (for ranks: "the second").
        behavior: behavior model.
        type_names: object types.
        width: beam width.

    Returns:
        Results in the order of the sentences and their worlds.
    """
    rows = []
    for world, rank, wanted in _cases(instructions, annotation, type_names):
        right, confidence, log_gold = True, 1.0, 0.0
        for clause, root, gold in wanted:
            beam = infer_behavior_sets(root, clause, world, behavior, rank, type_names, width)
            right = right and bool((beam[0].expressed == gold).all())
            confidence *= float(np.exp(beam[0].log_probability))
            found = [h.log_probability for h in beam if (h.expressed == gold).all()]
            log_gold += found[0] if found else _LOG_FLOOR
        rows.append((right, confidence, max(log_gold, _LOG_FLOOR)))
    return _collect(rows)


@dataclasses.dataclass(frozen=True)
class ExactScores:
    """Results of the likeliest set of all, by enumeration as far as it is needed."""

    is_right: np.ndarray  # bool[E]
    is_proven: np.ndarray  # bool[E] no other set can be likelier (``search_exactly``)

    @property
    def accuracy(self) -> float:
        """Share that is right."""
        return float(self.is_right.mean()) if len(self.is_right) else float("nan")


def score_annotations_exactly(
    instructions: Sequence[LabelledInstruction],
    model: CorrespondenceModel,
    type_names: tuple[str, ...],
) -> ExactScores:
    """Compare the likeliest annotations of all with the gold ones; as ``score_annotations``."""
    space, rows = AnnotationSpace(len(type_names)), []
    for labelled in instructions:
        said, is_proven = frozenset(), True
        for clause, root in enumerate(labelled.parse.clauses):
            log_odds, _ = annotation_log_odds(root, clause, model, type_names)
            best, is_sure = search_exactly(root, log_odds, path=(clause,))
            said, is_proven = said.union(space.members(best.expressed)), is_proven and is_sure
        rows.append((said == gold_annotations(labelled), is_proven))
    return ExactScores(*np.array(rows, bool).reshape(-1, 2).T)


def score_behaviors_exactly(
    instructions: Sequence[LabelledInstruction],
    annotation: CorrespondenceModel,
    behavior: CorrespondenceModel,
    type_names: tuple[str, ...],
) -> ExactScores:
    """Compare the likeliest behaviors of all with the gold ones; as ``score_behaviors``."""
    rows = []
    for world, rank, wanted in _cases(instructions, annotation, type_names):
        is_right = is_proven = True
        for clause, root, gold in wanted:
            log_odds = behavior_log_odds(root, clause, world, behavior, rank, type_names)
            best, is_sure = search_exactly(root, log_odds, path=(clause,))
            is_right &= bool((best.expressed == gold).all())
            is_proven &= is_sure
        rows.append((is_right, is_proven))
    return ExactScores(*np.array(rows, bool).reshape(-1, 2).T)


def calibration_error(scores: Scores, num_bins: int = 10) -> float:
    """Compute the expected calibration error.

        ECE = Σ_b n_b / n · |accuracy_b − confidence_b|      over bins of equal width

    Args:
        scores: results.
        num_bins: bins of [0, 1].

    Returns:
        In [0, 1]; 0 is perfectly calibrated.
    """
    bins = np.minimum((scores.confidence * num_bins).astype(int), num_bins - 1)
    gap = scores.is_right.astype(float) - scores.confidence
    total = np.bincount(bins, weights=gap, minlength=num_bins)
    return float(np.abs(total).sum() / max(len(gap), 1))


TEMPERATURES = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.15, 1.3, 1.5, 1.75, 2.0)


def fit_temperature(score: Callable[[float], Scores]) -> float:
    """Choose the temperature under which the gold answers are likeliest.

    Args:
        score: temperature → results on sentences held out from training.

    Returns:
        One of ``TEMPERATURES``.
    """
    return max(TEMPERATURES, key=lambda t: float(score(t).log_gold.mean()))
