"""Table 1 of the paper: how often sentences are understood, by hold-out validation (section 4.1).

39 labelled instructions, random splits of 67 to 33 %, whole-sentence exact match of the symbols
expressed at the root. The paper has 8 splits; eight are noise, so more can be asked for. All
splits of a model train at once, by ``vmap`` over the weights of the instructions.
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
from jaxlangnav.training.examples import LabelledInstruction, read_examples
from jaxlangnav.training.fit import Fit, fit
from jaxlangnav.training.scoring import (
    ExactScores,
    Results,
    Scores,
    score_annotations,
    score_behaviors,
)
from jaxlangnav.training.shipped import MODELS, LaidOut, lay_out

HOLD_OUT = 1 / 3
TABLE_1: dict[str, dict[str, float]] = {
    "annotation": {"accuracy_mean": 62.5, "accuracy_ci95": 10.83, "train_s": 145.11,
                   "infer_s": 0.44},
    "behavior": {"accuracy_mean": 55.77, "accuracy_ci95": 6.83, "train_s": 18.3, "infer_s": 0.05},
}  # fmt: skip
"""Table 1 as printed."""
CORPUS = "corpus39"
_WIDEST = 256  # sets of a phrase kept at most: those of two children are combined each with each
_MASKS = 1 + 4
"""Bytes of what a split says of one instruction: held out or not, and how much it counts."""


def draw_splits(count: int, splits: int, seed: int) -> np.ndarray:
    """Draw K times which third of the instructions is held out: bool[K, count]."""
    generator = np.random.default_rng(seed)
    held_out = np.zeros((splits, count), bool)
    for row in held_out:
        row[generator.permutation(count)[: round(count * HOLD_OUT)]] = True
    return held_out


@dataclasses.dataclass(frozen=True)
class Splits:
    """Everything fitted for one model over all splits."""

    models: list[CorrespondenceModel]  # K
    alone: Fit  # one split by itself
    together: Fit  # all splits in one vmap
    examples: int  # (phrase, symbol) factors, mean over the training parts


def _fit_splits(prepared: LaidOut, held_out: np.ndarray) -> Splits:
    """Train one model on every split at once, and on the first one alone for its time."""
    design, shares = prepared.design, (~held_out).astype(np.float32)
    _, first = fit(design, shares[:1])
    _, again = fit(design, shares[:1])  # the first one also starts JAX
    alone = dataclasses.replace(again, compile_seconds=first.compile_seconds)
    weights, together = fit(design, shares)
    examples = round(float((shares @ prepared.sizes).mean()))
    models = [CorrespondenceModel(prepared.vocabulary, one) for one in weights]
    return Splits(models, alone, together, examples)


def _score_all(
    instructions: Sequence[LabelledInstruction],
    fitted: dict[str, Splits],
    held_out: np.ndarray,
    type_names: tuple[str, ...],
    on_progress: OnProgress | None,
    **searched: Any,
) -> dict[str, Results]:
    annotation, behavior = (fitted[name].models for name in MODELS)
    splits, sentences = held_out.shape
    count = itertools.count(1)

    def tell() -> None:
        """Say how many splits' worth of work the sentences so far have been."""
        done = next(count)
        ends = [splits * n // (len(MODELS) * sentences) for n in (done - 1, done)]
        if on_progress is not None and ends[1] > ends[0]:
            on_progress(ends[1] - ends[0])

    searched["on_sentence"] = tell
    given = held_out, type_names
    return {
        "annotation": score_annotations(instructions, annotation, *given, **searched),
        "behavior": score_behaviors(instructions, annotation, behavior, *given, **searched),
    }


def _seconds(
    name: str,
    fitted: dict[str, Splits],
    tested: Sequence[LabelledInstruction],
    type_names: tuple[str, ...],
    width: int,
) -> float:
    """Measure the mean seconds that the first split's model takes for one sentence (and world)."""
    annotation, behavior = (fitted[name].models[0] for name in MODELS)
    count, begin = 0, time.perf_counter()
    for labelled in tested:
        belief = infer_annotations(labelled.parse, annotation, type_names, width)
        if name == "annotation":
            count += 1
            continue
        graph = CorrespondenceGraph(Behaviors(type_names, belief.rank), behavior)
        for trees in labelled.behaving:
            count += 1
            for tree in trees:
                graph.weigh(tree.root, tree.world, tree.clause).search(width)
    return (time.perf_counter() - begin) / count


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
        splits: how many random splits, at least 2.
        seed: of the splits.
        beams: beam widths; the first is the one that the table states.
        is_exact: also find the likeliest of all sets, and say how often it is proven.
        on_progress: called with how many splits' worth of work is done; adds up to ``splits``.

    Returns:
        For each model the keys of the table; ``beams`` maps each width, and "exact", to its
        accuracy; ``new_words`` is on the held-out sentences with a word that training never saw;
        ``paper`` has the printed rows. What cannot be is refused, and more than memory holds.
    """
    _check(splits, beams)
    type_names, corpus = load_lexicon().type_names, load_corpus(CORPUS)
    check_count("splits", splits, each=_MASKS * len(corpus))
    instructions = read_examples(corpus, type_names)
    given = instructions, type_names
    prepared = {name: lay_out(name, *given) for name in MODELS}
    for design in (one.design for one in prepared.values()):
        counts = math.prod(design.properties.shape[:2]) * 2
        weights = design.words.shape[1] * design.properties.shape[2]
        # Counts and weights of all splits lie side by side, the weights in double precision too.
        check_count("splits", splits, each=4 * counts + (4 + 8) * weights)
    held_out = draw_splits(len(instructions), splits, seed)
    fitted = {name: _fit_splits(one, held_out) for name, one in prepared.items()}
    results = _score_all(
        instructions, fitted, held_out, type_names, on_progress, widths=beams, is_exact=is_exact
    )
    tested = [instructions[i] for i in np.flatnonzero(held_out[0])]
    document: dict[str, Any] = {}
    for name in MODELS:
        seconds = _seconds(name, fitted, tested, type_names, beams[0])
        of_first = results[name].by_width[beams[0]]
        on_new = _on_new_words(name, instructions, of_first, held_out)
        document[name] = _row(fitted[name], results[name], seconds) | {"new_words": on_new}
    return document | {"paper": TABLE_1, "corpus": CORPUS, "seed": seed}


def _check(splits: int, beams: Sequence[int]) -> None:
    if splits < 2:
        raise ValueError(f"splits is {splits}, but at least 2 are needed for an interval")
    if not beams or min(beams) < 1:
        raise ValueError(f"beam widths must be 1 or more, not {list(beams)}")
    if (widest := max(beams)) > _WIDEST:
        raise ValueError(f"beam width is {readable_count(widest)}, but must be {_WIDEST} or less")


def _on_new_words(
    name: str,
    instructions: Sequence[LabelledInstruction],
    scores: Sequence[Scores],
    held_out: np.ndarray,
) -> dict[str, float | None]:
    """Write down the accuracy on those of bool[K, I] held out that have a word never seen."""
    words = [
        {word.lemma for root in one.parse.clauses for word in root.all_words()}
        for one in instructions
    ]
    scored = np.array([1 if name == "annotation" else len(one.behaving) for one in instructions])
    rows = []
    for score, held in zip(scores, held_out, strict=True):
        seen = set[str]().union(*(words[place] for place in np.flatnonzero(~held)))
        is_new = np.array([bool(own - seen) for own in words])
        rows.append((score.is_right, np.repeat(is_new, scored * held)))
    right = np.concatenate([is_right[is_new] for is_right, is_new in rows])
    share = float(np.concatenate([is_new for _, is_new in rows]).mean())
    accuracy = round(100.0 * float(right.mean()), 2) if len(right) else None
    return {"accuracy_mean": accuracy, "share": round(share, 4)}


def _accuracy(scores: Sequence[Scores | ExactScores]) -> dict[str, float]:
    """Write down the mean accuracy over splits and half its 95 % interval, percent."""
    accuracy = np.array([100.0 * score.accuracy for score in scores])
    interval = float(1.96 * accuracy.std(ddof=1) / np.sqrt(len(accuracy)))
    return {"accuracy_mean": round(float(accuracy.mean()), 2), "accuracy_ci95": round(interval, 2)}


def _row(fitted: Splits, results: Results, seconds: float) -> dict[str, Any]:
    beams = {str(beam): _accuracy(of_beam) for beam, of_beam in results.by_width.items()}
    first = next(iter(beams.values()))
    if results.exact:
        proven = np.concatenate([score.is_proven for score in results.exact]).mean()
        beams["exact"] = _accuracy(results.exact) | {"proven": round(float(proven), 4)}
    return {
        "splits": len(fitted.models),
        **first,
        "train_s": round(fitted.alone.seconds, 4),
        "train_compile_s": round(fitted.alone.compile_seconds, 3),
        "train_all_s": round(fitted.together.seconds, 4),
        "infer_s": round(seconds, 5),
        "examples": fitted.examples,
        "features": fitted.models[0].num_features,
        "beams": beams,
    }


def _cell(row: dict[str, float]) -> str:
    """Write an accuracy with its interval, and how much of it is proven."""
    proven = f" ({100 * row['proven']:.4g} %)" if "proven" in row else ""
    return f"{row['accuracy_mean']:.2f} ± {row['accuracy_ci95']:.2f}{proven}"


def table_1(document: Document) -> Table:
    """Lay out a document of ``evaluate``: a line for each figure, ours beside the printed ones."""
    rows: list[list[str]] = []

    def line(title: str, text: Callable[[dict[str, Any]], str], is_printed: bool = False) -> None:
        cells = [title]
        for name in MODELS:
            cells += [text(document[name]), text(document["paper"][name]) if is_printed else ""]
        rows.append(cells)

    line("Accuracy % (95 %)", _cell, is_printed=True)
    for beam in document[MODELS[0]]["beams"]:
        title = "exact (proven)" if beam == "exact" else f"beam of {beam}"
        line(f"  {title}", lambda row, beam=beam: _cell(row["beams"][beam]))
    line("Training s", "{train_s:.3f}".format_map, is_printed=True)
    line("  compile s", "{train_compile_s:.2f}".format_map)
    line("  all splits at once s", "{train_all_s:.3f}".format_map)
    line("Inference s", "{infer_s:.4f}".format_map, is_printed=True)
    for name in ("splits", "examples", "features"):
        line(name.capitalize(), f"{{{name}}}".format_map)
    headings = ["", *(heading for name in MODELS for heading in (name, "paper"))]
    return Table(headings=headings, rows=rows, title="Table 1: ours beside the paper's")
