"""How often a model is right, and how well it knows (section 4.1).

A sentence counts as right when the likeliest set of symbols at the roots of its clauses is exactly
the gold one. Confidence is the probability of that set.
"""

from collections.abc import Callable, Sequence

import numpy as np

from jaxlangnav.grounding.model import CorrespondenceModel
from jaxlangnav.grounding.search import BEAM_WIDTH
from jaxlangnav.training import scoring
from jaxlangnav.training.examples import LabelledInstruction
from jaxlangnav.training.scoring import ExactScores, Models, Scores


def _on_all(instructions: Sequence[LabelledInstruction]) -> np.ndarray:
    """Test one model on every sentence, bool[1, I]."""
    return np.ones((1, len(instructions)), bool)


def evaluate_annotations(
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
    found = scoring.score_annotations(
        instructions, Models.of([model]), _on_all(instructions), type_names, widths=(width,)
    )
    return found.by_width[width][0]


def evaluate_behaviors(
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
    models = Models.of([annotation]), Models.of([behavior])
    found = scoring.score_behaviors(
        instructions, *models, _on_all(instructions), type_names, widths=(width,)
    )
    return found.by_width[width][0]


def score_annotations_exactly(
    instructions: Sequence[LabelledInstruction],
    model: CorrespondenceModel,
    type_names: tuple[str, ...],
) -> ExactScores:
    """Compare the likeliest annotations of all with the gold ones; as ``evaluate_annotations``."""
    models, tested = Models.of([model]), _on_all(instructions)
    return scoring.score_annotations(
        instructions, models, tested, type_names, widths=(), is_exact=True
    ).exact[0]


def score_behaviors_exactly(
    instructions: Sequence[LabelledInstruction],
    annotation: CorrespondenceModel,
    behavior: CorrespondenceModel,
    type_names: tuple[str, ...],
) -> ExactScores:
    """Compare the likeliest behaviors of all with the gold ones; as ``evaluate_behaviors``."""
    models, tested = (Models.of([annotation]), Models.of([behavior])), _on_all(instructions)
    return scoring.score_behaviors(
        instructions, *models, tested, type_names, widths=(), is_exact=True
    ).exact[0]


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
