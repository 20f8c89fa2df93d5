"""Scores of grounders on labelled sentences: right, refused or wrong (section 4.1)."""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxlangnav.experiments.table import Table, TableColumns
from jaxlangnav.grounding.grounder import Context, FirstGrounder, GraphGrounder, Grounder
from jaxlangnav.grounding.instruction import GroundingModel
from jaxlangnav.grounding.rewrites import RecordedRewrites, RewriteGrounder, verify_rewrites
from jaxlangnav.language.lexicon import is_reserved
from jaxlangnav.language.phrase import MIN_PROBABILITY
from jaxlangnav.task.comparison import difference
from jaxlangnav.task.labelled import LabelledSentence
from jaxlangnav.training.shipped import Judged, TemperatureFit, fit_source_temperature

CORRECT, REFUSED, WRONG = OUTCOMES = ("right", "refused", "wrong")
MAX_LISTED = 40
"""Maximum number of sentences listed below the table; the document lists all errors."""
GrounderWrapper = Callable[[GraphGrounder], Grounder]
"""Builds the grounder to score from the trained graph, anew for each sentence."""


class Score(NamedTuple):
    """Outcome of one sentence."""

    sentence: LabelledSentence
    outcome: str
    reason: str  # the refusal, or the difference from the label; empty if right
    confidence: float  # probability of the best interpretation; 0 if refused


def score_sentences(
    sentences: Sequence[LabelledSentence],
    model: GroundingModel,
    on_progress: Callable[[int], object] = lambda count: None,
    wrap: GrounderWrapper = lambda graph: graph,
    least_probability: float = MIN_PROBABILITY,
) -> list[Score]:
    """Score labelled sentences, in order.

    Args:
        sentences: with their labels. The detector has all types that these name, and the
            lexicon's.
        model: the trained models.
        on_progress: called after each sentence.
        wrap: builds the grounder to score; the trained graph by default.
        least_probability: minimum probability of a parse, in [0, 1]; see ``parse``.
    """
    scores, labels = [], _list_labels(sentences, model)
    for sentence in sentences:
        graph = GraphGrounder(model, labels, least_probability=least_probability)
        scores.append(_score(sentence, graph, wrap))
        on_progress(1)
    return scores


def summarize_scores(scores: Sequence[Score]) -> dict[str, Any]:
    """Summarize scores of ``score_sentences`` in a JSON document.

    Counts overall and by construction, and all errors, worst first: wrong interpretations before
    refusals, by falling confidence.
    """
    by_name: dict[str, list[Score]] = {}
    for score in scores:
        by_name.setdefault(score.sentence.construction, []).append(score)
    errors = [score for score in scores if score.outcome != CORRECT]
    errors.sort(key=lambda score: (score.outcome != WRONG, -score.confidence, score.sentence.line))
    return {
        **_count_scores(scores),
        "by_construction": {name: _count_scores(group) for name, group in by_name.items()},
        "worst": [
            {
                "line": score.sentence.line,
                "text": score.sentence.text,
                "construction": score.sentence.construction,
                "outcome": score.outcome,
                "why": score.reason,
                "confidence": round(score.confidence, 4),
            }
            for score in errors
        ],
    }


def render_scores(document: dict[str, Any]) -> tuple[Any, list[str]]:
    """Render a ``summarize_scores`` document: a rich table, and lines for the worst sentences."""
    rows = [*document["by_construction"].items(), ("all", document)]
    columns: TableColumns = [
        ("construction", "{name}"),
        *((name, f"{{{name}}}") for name in ("sentences", *OUTCOMES)),
        ("right %", "{right_share:.1f}"),
    ]
    named_rows = [{**row, "name": name or "-"} for name, row in rows]
    table = Table.of(named_rows, columns, title="Sentences as labelled, right or rightly refused")
    worst = document["worst"]
    lines = [
        f"{row['outcome']}, line {row['line']}: {row['text']}\n    {row['why']}"
        for row in worst[:MAX_LISTED]
    ]
    if len(worst) > MAX_LISTED:
        lines.append(f"and {len(worst) - MAX_LISTED} more: --json lists them all")
    return table.text(), lines


def _count_scores(scores: Sequence[Score]) -> dict[str, Any]:
    counts = Counter(score.outcome for score in scores)
    return {
        "sentences": len(scores),
        **{outcome: counts[outcome] for outcome in OUTCOMES},
        "right_share": round(100.0 * counts[CORRECT] / max(len(scores), 1), 2),
    }


def _context_of(sentence: LabelledSentence) -> Context:
    """Build the context of a sentence: as under way if its label is a statement without command."""
    meaning = sentence.meaning
    return Context(is_under_way=meaning is not None and not meaning.reading.commands)


def _list_labels(sentences: Sequence[LabelledSentence], model: GroundingModel) -> tuple[str, ...]:
    """List the model's object types and those that the labels name."""
    meanings = [sentence.meaning for sentence in sentences if sentence.meaning is not None]
    named = [n for meaning in meanings for n in meaning.type_names if not is_reserved(n.lower())]
    return tuple(dict.fromkeys([*model.type_names, *named]))


def _score(sentence: LabelledSentence, graph: GraphGrounder, wrap: GrounderWrapper) -> Score:
    meaning = sentence.meaning
    try:
        grounded = wrap(graph).ground(sentence.text, _context_of(sentence))
    except ValueError as error:
        outcome = CORRECT if meaning is None else REFUSED
        return Score(sentence, outcome, "" if meaning is None else str(error), 0.0)
    confidence = float(np.exp(grounded.instruction.readings.log_probability[0]))
    if meaning is None:
        return Score(sentence, WRONG, "was read, but must be refused", confidence)
    reason = difference(meaning, grounded.instruction, graph.names)
    return Score(sentence, WRONG if reason else CORRECT, reason, confidence)


GRAPH, REWRITES, BOTH = VARIANTS = ("graph alone", "rewrites alone", "both")
"""Grounders to compare; both: the graph, and rewrites of sentences that it refuses."""


def select_recorded(
    sentences: Sequence[LabelledSentence], recorded: RecordedRewrites
) -> list[LabelledSentence]:
    """Select the sentences with recorded rewrites, so that all grounders are scored on the same.

    Raises:
        ValueError: none of them was; one line.
    """
    selected = [sentence for sentence in sentences if sentence.text in recorded.answers]
    if not selected:
        raise ValueError(
            f"none of the {len(sentences)} sentences stands in the file of rewritings: "
            "record the same texts"
        )
    return selected


def score_variants(
    sentences: Sequence[LabelledSentence],
    recorded: RecordedRewrites,
    model: GroundingModel,
    temperature: float,
    on_progress: Callable[[int], object],
) -> dict[str, Any]:
    """Score labelled sentences with the graph, with their rewrites, and with both.

    ``temperature`` is that of the weights of rewrites; ``on_progress`` is called after each
    sentence of each grounder.

    Returns:
        A JSON document: ``temperature``; ``arms``, a summary of ``summarize_scores`` for each
        grounder, with the same counts of the sentences ``meant`` to be read and ``to_refuse``.
    """

    def rewritten(graph: GraphGrounder) -> RewriteGrounder:
        return RewriteGrounder(graph, recorded, temperature=temperature)

    wrappers: dict[str, GrounderWrapper] = {
        GRAPH: lambda graph: graph,
        REWRITES: rewritten,
        BOTH: lambda graph: FirstGrounder(graph, rewritten(graph)),
    }
    summaries = {}
    for name, wrap in wrappers.items():
        scores = score_sentences(sentences, model, on_progress, wrap)
        summaries[name] = {
            **summarize_scores(scores),
            "meant": _count_scores([score for score in scores if score.sentence.meaning]),
            "to_refuse": _count_scores([score for score in scores if not score.sentence.meaning]),
        }
    return {"temperature": temperature, "arms": summaries}


def fit_recorded(
    sentences: Sequence[LabelledSentence], recorded: RecordedRewrites, model: GroundingModel
) -> TemperatureFit:
    """Fit the temperature to recorded rewrites of sentences that are labelled with a meaning.

    Raises:
        ValueError: they hold no evidence about it; one line.
    """
    labels, examples = _list_labels(sentences, model), []
    for sentence in sentences:
        if (meaning := sentence.meaning) is None:
            continue
        graph = GraphGrounder(model, labels)
        verified, _ = verify_rewrites(graph, recorded(sentence.text), _context_of(sentence))
        instructions = [rewrite.grounded.instruction for rewrite in verified]
        is_right = (not difference(meaning, each, graph.names) for each in instructions)
        log_probs = tuple(rewrite.log_probability for rewrite in verified)
        examples.append(Judged(log_probs, tuple(is_right)))
    return fit_source_temperature(examples)


def render_variants(document: dict[str, Any], fit: TemperatureFit | None) -> tuple[Any, list[str]]:
    """Render a ``score_variants`` document and the fit, if any: a rich table, and lines."""
    columns: TableColumns = [
        ("", "{name}"),
        *((f"meant: {name}", f"{{meant[{name}]}}") for name in OUTCOMES),
        ("to refuse: right", f"{{to_refuse[{CORRECT}]}}"),
        ("wrong", f"{{to_refuse[{WRONG}]}}"),
        ("all right %", "{right_share:.1f}"),
    ]
    rows = [{**row, "name": name} for name, row in document["arms"].items()]
    table = Table.of(rows, columns, title="Sentences as labelled, by what reads them")
    lines = [f"temperature {document['temperature']:.3g}"]
    if fit is not None:
        lines.append(
            f"fitted to {fit.used} sentences: mean log-likelihood {fit.log_likelihood:.3f}, at "
            f"temperature 1 {fit.log_likelihood_at_one:.3f}; {fit.left_out} say nothing about it"
            + (" (at the bound of what is looked for)" if fit.is_at_bound else "")
        )
    return table.text(), lines
