"""Table 1 of the paper: grounding accuracy of the language models, by hold-out validation (4.1).

39 labelled instructions, random splits of 67 to 33 %, whole-sentence exact match of the symbols
expressed at the root. The paper has 8 splits, too few for a tight interval; more can be requested.
All splits of a model train at once, by ``vmap`` over the weights of the instructions.
"""

import dataclasses
import itertools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxlangnav.experiments.monte_carlo import OnProgress
from jaxlangnav.experiments.sizes import check_count, readable_count
from jaxlangnav.experiments.table import Document, Table
from jaxlangnav.grounding.annotation import infer_annotations
from jaxlangnav.grounding.correspondence import CorrespondenceGraph
from jaxlangnav.grounding.model import CorrespondenceModel
from jaxlangnav.grounding.properties import Behaviors
from jaxlangnav.grounding.search import BEAM_WIDTH
from jaxlangnav.language.corpus import load_corpus
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.training import scoring
from jaxlangnav.training.examples import LabelledInstruction, labelled_instruction
from jaxlangnav.training.fit import Fit, fit
from jaxlangnav.training.shipped import MODELS, TrainingData, training_data

HELD_OUT_FRACTION = 1 / 3
PUBLISHED_TABLE: dict[str, dict[str, float]] = {
    "annotation": {"accuracy_mean": 62.5, "accuracy_ci95": 10.83, "train_s": 145.11,
                   "infer_s": 0.44},
    "behavior": {"accuracy_mean": 55.77, "accuracy_ci95": 6.83, "train_s": 18.3, "infer_s": 0.05},
}  # fmt: skip
"""Table 1 of the paper."""
CORPUS = "corpus39"
_MAX_WIDTH = 256  # limit of the beam width: candidates of two children are combined pairwise
_SPLIT_BYTES = 1 + 4  # bytes per split and instruction: whether it is held out, and its weight


def draw_splits(count: int, splits: int, seed: int) -> np.ndarray:
    """Sample K splits that hold out a third of the instructions each: bool[K, count]."""
    generator = np.random.default_rng(seed)
    held_out = np.zeros((splits, count), bool)
    for row in held_out:
        row[generator.permutation(count)[: round(count * HELD_OUT_FRACTION)]] = True
    return held_out


@dataclasses.dataclass(frozen=True)
class FittedSplits:
    """Models and training times of one language model over all splits."""

    models: list[CorrespondenceModel]  # K
    single_fit: Fit  # of one split
    joint_fit: Fit  # of all splits in one vmap
    num_factors: int  # (phrase, symbol) factors, mean over the training parts


def _fit_splits(data: TrainingData, held_out: np.ndarray) -> FittedSplits:
    """Train one model on all splits at once, and on the first one alone to time it."""
    design, train_masks = data.design, (~held_out).astype(np.float32)
    _, first = fit(design, train_masks[:1])
    _, second = fit(design, train_masks[:1])  # the first call also initialises JAX
    single_fit = second._replace(compile_seconds=first.compile_seconds)
    all_weights, joint_fit = fit(design, train_masks)
    num_factors = round(float((train_masks @ data.sizes).mean()))
    models = [CorrespondenceModel(data.vocabulary, weights) for weights in all_weights]
    return FittedSplits(models, single_fit, joint_fit, num_factors)


def _score_models(
    instructions: Sequence[LabelledInstruction],
    fitted: dict[str, FittedSplits],
    held_out: np.ndarray,
    on_progress: OnProgress | None,
    **options: Any,
) -> dict[str, scoring.Results]:
    annotation, behavior = (fitted[name].models for name in MODELS)
    splits, sentences = held_out.shape
    count = itertools.count(1)

    def report() -> None:
        """Report progress, converted from sentences to splits."""
        num_done = next(count)
        counts = [splits * n // (len(MODELS) * sentences) for n in (num_done - 1, num_done)]
        if on_progress is not None and counts[1] > counts[0]:
            on_progress(counts[1] - counts[0])

    types = load_lexicon().type_names
    scorer = scoring.Scorer(instructions, types, held_out, on_sentence=report, **options)
    return {
        "annotation": scorer.annotations(annotation),
        "behavior": scorer.behaviors(annotation, behavior),
    }


def _inference_seconds(
    name: str, fitted: dict[str, FittedSplits], sentences: Sequence[LabelledInstruction], width: int
) -> float:
    """Measure the mean inference time of the first split's model per sentence (and world)."""
    annotation, behavior = (fitted[name].models[0] for name in MODELS)
    type_names = load_lexicon().type_names
    count, start = 0, time.perf_counter()
    for sentence in sentences:
        belief = infer_annotations(sentence.parse, annotation, type_names, width)
        if name == "annotation":
            count += 1
            continue
        graph = CorrespondenceGraph(Behaviors(type_names, belief.rank), behavior)
        for trees in sentence.behaviors:
            count += 1
            for tree in trees:
                graph.score(tree.root, tree.world, tree.clause).search(width)
    return (time.perf_counter() - start) / count


def evaluate(
    *,
    splits: int = 8,
    seed: int = 0,
    beams: Sequence[int] = (BEAM_WIDTH,),
    is_exact: bool = False,
    on_progress: OnProgress | None = None,
) -> dict[str, Any]:
    """Run the paper's protocol for both models.

    Args:
        splits: number of random splits, at least 2.
        seed: of the splits.
        beams: beam widths; the first is the one of the table.
        is_exact: also search exactly, and report how often optimality is proven.
        on_progress: called with the number of splits' worth of work done; sums to ``splits``.

    Returns:
        For each model the keys of the table; ``beams`` maps each width, and "exact", to its
        accuracy; ``new_words`` is on the held-out sentences with a word not in the training set;
        ``paper`` has the published rows. ``ValueError`` for invalid sizes or too little memory.
    """
    if splits < 2:
        raise ValueError(f"splits is {splits}, but at least 2 are needed for an interval")
    if not beams or min(beams) < 1:
        raise ValueError(f"beam widths must be 1 or more, not {list(beams)}")
    if (width := max(beams)) > _MAX_WIDTH:
        raise ValueError(f"beam width is {readable_count(width)}, but must be {_MAX_WIDTH} or less")
    type_names, corpus = load_lexicon().type_names, load_corpus(CORPUS)
    check_count("splits", splits, each=_SPLIT_BYTES * len(corpus))
    instructions = [labelled_instruction(example, type_names) for example in corpus]
    datasets = {name: training_data(name, instructions, type_names) for name in MODELS}
    for design in (data.design for data in datasets.values()):
        counts = math.prod(design.properties.shape[:2]) * 2
        weights = design.words.shape[1] * design.properties.shape[2]
        # Counts and weights of all splits are in memory, the weights in double precision too.
        check_count("splits", splits, each=4 * counts + (4 + 8) * weights)
    held_out = draw_splits(len(instructions), splits, seed)
    fitted = {name: _fit_splits(data, held_out) for name, data in datasets.items()}
    results = _score_models(
        instructions, fitted, held_out, on_progress, widths=beams, is_exact=is_exact
    )
    test_sentences = [instructions[i] for i in np.flatnonzero(held_out[0])]
    document: dict[str, Any] = {}
    for name in MODELS:
        seconds = _inference_seconds(name, fitted, test_sentences, beams[0])
        new_words = _oov_accuracy(name, instructions, results[name].by_width[beams[0]], held_out)
        document[name] = _row(fitted[name], results[name], seconds) | {"new_words": new_words}
    return document | {"paper": PUBLISHED_TABLE, "corpus": CORPUS, "seed": seed}


def _oov_accuracy(
    name: str,
    instructions: Sequence[LabelledInstruction],
    scores: Sequence[scoring.Scores],
    held_out: np.ndarray,
) -> dict[str, float | None]:
    """Compute the accuracy on held-out instructions, bool[K, I], with an unseen word."""
    words = [
        {word.lemma for root in instruction.parse.clauses for word in root.all_words()}
        for instruction in instructions
    ]
    counts = np.array([1 if name == "annotation" else len(item.behaviors) for item in instructions])
    results = []
    for split, is_held_out in zip(scores, held_out, strict=True):
        train_words = set[str]().union(*(words[i] for i in np.flatnonzero(~is_held_out)))
        is_new = np.array([bool(lemmas - train_words) for lemmas in words])
        results.append((split.is_right, np.repeat(is_new, counts * is_held_out)))
    is_right_all = np.concatenate([is_right[is_new] for is_right, is_new in results])
    fraction = float(np.concatenate([is_new for _, is_new in results]).mean())
    accuracy = round(100.0 * float(is_right_all.mean()), 2) if len(is_right_all) else None
    return {"accuracy_mean": accuracy, "share": round(fraction, 4)}


def _accuracy(scores: Sequence[scoring.Scores | scoring.ExactScores]) -> dict[str, float]:
    """Compute the mean accuracy over splits and half its 95 % interval, percent."""
    accuracy = np.array([100.0 * score.accuracy for score in scores])
    interval = float(1.96 * accuracy.std(ddof=1) / np.sqrt(len(accuracy)))
    return {"accuracy_mean": round(float(accuracy.mean()), 2), "accuracy_ci95": round(interval, 2)}


def _row(fitted: FittedSplits, results: scoring.Results, seconds: float) -> dict[str, Any]:
    beams = {str(beam): _accuracy(scores) for beam, scores in results.by_width.items()}
    first = next(iter(beams.values()))
    if results.exact:
        proven = np.concatenate([score.is_proven for score in results.exact]).mean()
        beams["exact"] = _accuracy(results.exact) | {"proven": round(float(proven), 4)}
    return {
        "splits": len(fitted.models),
        **first,
        "train_s": round(fitted.single_fit.seconds, 4),
        "train_compile_s": round(fitted.single_fit.compile_seconds, 3),
        "train_all_s": round(fitted.joint_fit.seconds, 4),
        "infer_s": round(seconds, 5),
        "examples": fitted.num_factors,
        "features": fitted.models[0].num_features,
        "beams": beams,
    }


def _cell(row: dict[str, float]) -> str:
    """Format an accuracy with its interval and the proven fraction."""
    proven = f" ({100 * row['proven']:.4g} %)" if "proven" in row else ""
    return f"{row['accuracy_mean']:.2f} ± {row['accuracy_ci95']:.2f}{proven}"


def table_1(document: Document) -> Table:
    """Build Table 1 from a document of ``evaluate``: a line per metric, ours and the paper's."""
    rows: list[list[str]] = []

    def add(title: str, text: Callable[[dict[str, Any]], str], in_paper: bool = False) -> None:
        cells = [title]
        for name in MODELS:
            cells += [text(document[name]), text(document["paper"][name]) if in_paper else ""]
        rows.append(cells)

    add("Accuracy % (95 %)", _cell, in_paper=True)
    for beam in document[MODELS[0]]["beams"]:
        title = "exact (proven)" if beam == "exact" else f"beam of {beam}"
        add(f"  {title}", lambda row, beam=beam: _cell(row["beams"][beam]))
    add("Training s", "{train_s:.3f}".format_map, in_paper=True)
    add("  compile s", "{train_compile_s:.2f}".format_map)
    add("  all splits at once s", "{train_all_s:.3f}".format_map)
    add("Inference s", "{infer_s:.4f}".format_map, in_paper=True)
    for name in ("splits", "examples", "features"):
        add(name.capitalize(), f"{{{name}}}".format_map)
    headings = ["", *(heading for name in MODELS for heading in (name, "paper"))]
    return Table(headings=headings, rows=rows, title="Table 1: ours beside the paper's")
