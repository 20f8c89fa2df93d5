"""Table 1 of the paper: how often sentences are understood, by hold-out validation (section 4.1).

39 labelled instructions, random splits of 67 to 33 %, whole-sentence exact match of the symbols
expressed at the root. The paper has 8 splits; eight are noise, so more can be asked for. All
splits of a model train at once, by ``vmap`` over the weights of the instructions.
"""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from jaxlangnav.grounding.evaluation import Scores, score_annotations, score_behaviors
from jaxlangnav.grounding.examples import (
    LabelledInstruction,
    annotation_examples,
    behavior_examples,
)
from jaxlangnav.grounding.features import FEATURE_GROUPS
from jaxlangnav.grounding.labelled import read_examples
from jaxlangnav.grounding.model import (
    ANNOTATION_KINDS,
    BEHAVIOR_KINDS,
    CorrespondenceModel,
    Vocabulary,
)
from jaxlangnav.grounding.search import BEAM_WIDTH
from jaxlangnav.grounding.training import Fit, build_blocks, fit
from jaxlangnav.language.corpus import load_corpus
from jaxlangnav.language.lexicon import load_lexicon

PAPER: dict[str, dict[str, float]] = {
    "annotation": {
        "accuracy_mean": 62.5,
        "accuracy_ci95": 10.83,
        "train_s": 145.11,
        "infer_s": 0.44,
    },
    "behavior": {"accuracy_mean": 55.77, "accuracy_ci95": 6.83, "train_s": 18.3, "infer_s": 0.05},
}
"""Table 1 as printed."""
HOLD_OUT = 1 / 3
CORPUS = "corpus39"
MODELS = ("annotation", "behavior")
Progress = Callable[[int], None]


@dataclasses.dataclass(frozen=True)
class Splits:
    """Everything fitted for one model over all splits."""

    vocabulary: Vocabulary
    weights: list[dict[str, np.ndarray]]
    alone: Fit  # one split by itself
    together: Fit  # all splits in one vmap
    examples: int  # (phrase, symbol) factors, mean over the training parts

    def model(self, split: int) -> CorrespondenceModel:
        """Build the model of one split."""
        return CorrespondenceModel(self.vocabulary, self.weights[split])


def draw_splits(count: int, splits: int, seed: int) -> np.ndarray:
    """Draw which instructions are held out.

    Args:
        count: instructions.
        splits: K.
        seed: of the draw.

    Returns:
        bool[K, count], a third of each row is held out.
    """
    generator = np.random.default_rng(seed)
    held_out = np.zeros((splits, count), bool)
    for row in held_out:
        row[generator.permutation(count)[: round(count * HOLD_OUT)]] = True
    return held_out


def fit_splits(
    name: str,
    instructions: Sequence[LabelledInstruction],
    held_out: np.ndarray,
    type_names: tuple[str, ...],
    without: frozenset[str] = frozenset(),
) -> Splits:
    """Train one model on every split at once, and on the first one alone for its time.

    Args:
        name: "annotation" or "behavior".
        instructions: the corpus.
        held_out: bool[K, I].
        type_names: object types.
        without: groups of word features to leave out.

    Returns:
        The fitted models.
    """
    build = annotation_examples if name == "annotation" else behavior_examples
    examples = build(instructions, type_names)
    kinds = ANNOTATION_KINDS if name == "annotation" else BEHAVIOR_KINDS
    vocabulary, blocks = build_blocks(examples, kinds, len(instructions), without)
    shares = (~held_out).astype(np.float32)
    _, alone = fit(blocks, shares[:1])
    weights, together = fit(blocks, np.concatenate([shares, shares[:1]]))
    sizes = np.zeros(len(instructions))
    for example in examples:
        sizes[example.instruction] += sum(len(rows.labels) for rows in example.rows.values())
    return Splits(vocabulary, weights[:-1], alone, together, round(float((shares @ sizes).mean())))


def summarise(scores: Sequence[Scores]) -> tuple[float, float]:
    """Compute the mean accuracy over splits and half its 95 % interval, percent."""
    accuracy = np.array([100.0 * score.accuracy for score in scores])
    spread = accuracy.std(ddof=1) if len(accuracy) > 1 else float("nan")
    return float(accuracy.mean()), float(1.96 * spread / np.sqrt(len(accuracy)))


def _score(
    name: str,
    fitted: dict[str, Splits],
    split: int,
    held_out: Sequence[LabelledInstruction],
    type_names: tuple[str, ...],
    width: int,
) -> Scores:
    """Measure one model on one split's hold-out."""
    annotation = fitted["annotation"].model(split)
    if name == "annotation":
        return score_annotations(held_out, annotation, type_names, width)
    behavior = fitted["behavior"].model(split)
    return score_behaviors(held_out, annotation, behavior, type_names, width)


def evaluate(
    *,
    splits: int = 8,
    seed: int = 0,
    beams: Sequence[int] = (BEAM_WIDTH,),
    without: Sequence[str] = (),
    on_progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the paper's protocol for both models.

    Args:
        splits: how many random splits, at least 2.
        seed: of the splits.
        beams: beam widths; the first is the one that the table states.
        without: groups of word features to leave out (``FEATURE_GROUPS``), an ablation.
        on_progress: called with the number of splits just measured.

    Returns:
        For each model the keys of the table; ``beams`` maps each width to its accuracy;
        ``paper`` has the printed rows.

    Raises:
        ValueError: fewer than two splits, a beam below one, or an unknown group of features.
    """
    if splits < 2:
        raise ValueError(f"splits is {splits}, but at least 2 are needed for an interval")
    if not beams or min(beams) < 1:
        raise ValueError(f"beam widths must be 1 or more, not {list(beams)}")
    unknown = sorted(set(without) - set(FEATURE_GROUPS))
    if unknown:
        raise ValueError(f"unknown features {unknown}; known are {', '.join(FEATURE_GROUPS)}")
    type_names = load_lexicon().type_names
    instructions = read_examples(load_corpus(CORPUS), type_names)
    held_out = draw_splits(len(instructions), splits, seed)
    fitted = {
        name: fit_splits(name, instructions, held_out, type_names, frozenset(without))
        for name in MODELS
    }
    scores: dict[str, dict[int, list[Scores]]] = {n: {b: [] for b in beams} for n in MODELS}
    seconds: dict[str, list[float]] = {name: [] for name in MODELS}
    for split in range(splits):
        tested = [instructions[i] for i in np.flatnonzero(held_out[split])]
        for name in MODELS:
            for beam in beams:
                begin = time.perf_counter()
                score = _score(name, fitted, split, tested, type_names, beam)
                if beam == beams[0]:
                    elapsed = time.perf_counter() - begin
                    seconds[name].append(elapsed / max(len(score.is_right), 1))
                scores[name][beam].append(score)
        if on_progress is not None:
            on_progress(1)
    document: dict[str, Any] = {
        name: _row(fitted[name], scores[name], seconds[name], splits) for name in MODELS
    }
    return document | {"paper": PAPER, "corpus": CORPUS, "without": list(without), "seed": seed}


def _row(
    fitted: Splits, scores: dict[int, list[Scores]], seconds: list[float], splits: int
) -> dict[str, Any]:
    """Write one row of the table."""
    widths = {beam: summarise(of_beam) for beam, of_beam in scores.items()}
    mean, interval = next(iter(widths.values()))
    return {
        "splits": splits,
        "accuracy_mean": round(mean, 2),
        "accuracy_ci95": round(interval, 2),
        "train_s": round(fitted.alone.seconds, 4),
        "train_compile_s": round(fitted.alone.compile_seconds, 3),
        "train_all_s": round(fitted.together.seconds, 4),
        "infer_s": round(float(np.median(seconds)), 5),
        "examples": fitted.examples,
        "features": fitted.model(0).num_features,
        "beams": {
            str(beam): {"accuracy_mean": round(m, 2), "accuracy_ci95": round(c, 2)}
            for beam, (m, c) in widths.items()
        },
    }


def ablate(*, splits: int = 40, seed: int = 0) -> list[dict[str, Any]]:
    """Leave out each group of word features in turn: what carries words never seen?

    Args:
        splits: random splits for each.
        seed: of the splits, the same for all.

    Returns:
        One row per choice: ``without``, and the accuracy of both models, percent.
    """
    choices: list[tuple[str, ...]] = [(), *((group,) for group in FEATURE_GROUPS)]
    choices.append(("sense", "tag", "gram"))
    rows = []
    for without in choices:
        document = evaluate(splits=splits, seed=seed, without=without)
        rows.append(
            {
                "without": " ".join(without) or "nothing",
                **{name: document[name]["accuracy_mean"] for name in MODELS},
                **{f"{name}_ci95": document[name]["accuracy_ci95"] for name in MODELS},
            }
        )
    return rows


def render(document: dict[str, Any]) -> Table:
    """Draw the table for people, ours beside the paper's.

    Args:
        document: of ``evaluate``.

    Returns:
        A rich table.
    """
    table = Table(title="Table 1: ours beside the paper's")
    table.add_column("")
    for name in MODELS:
        table.add_column(name)
        table.add_column("paper")

    def line(title: str, text: Callable[[dict[str, Any]], str], is_printed: bool = False) -> None:
        cells = [title]
        for name in MODELS:
            cells += [text(document[name]), text(document["paper"][name]) if is_printed else ""]
        table.add_row(*cells)

    line(
        "Accuracy % (95 %)",
        lambda row: f"{row['accuracy_mean']:.2f} ± {row['accuracy_ci95']:.2f}",
        is_printed=True,
    )
    line("Training s", lambda row: f"{row['train_s']:.3f}", is_printed=True)
    line("  compile s", lambda row: f"{row['train_compile_s']:.2f}")
    line("  all splits at once s", lambda row: f"{row['train_all_s']:.3f}")
    line("Inference s", lambda row: f"{row['infer_s']:.4f}", is_printed=True)
    line("Splits", lambda row: str(row["splits"]))
    line("Examples", lambda row: str(row["examples"]))
    line("Features", lambda row: str(row["features"]))
    return table
