"""How many labelled sentences are read as labelled, refused, and read wrongly (section 4.1)."""

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxlangnav.experiments.table import Table, TableColumns
from jaxlangnav.grounding.grounder import Context, FirstGrounder, GraphGrounder, Grounder
from jaxlangnav.grounding.instruction import GroundingModel
from jaxlangnav.grounding.rewrites import (
    RecordedRewrites,
    RewriteGrounder,
    default_rewrite_params,
    verify_rewrites,
)
from jaxlangnav.language.own_words import is_reserved
from jaxlangnav.language.phrase import MIN_PROBABILITY
from jaxlangnav.task.compared import difference
from jaxlangnav.task.labelled import LabelledSentence
from jaxlangnav.training.shipped import Judged, TemperatureFit, fit_source_temperature

CORRECT, REFUSED, WRONG = OUTCOMES = ("right", "refused", "wrong")
WORST_SHOWN = 40
"""Sentences listed below the table; the document has all that are not right."""
Wrapping = Callable[[GraphGrounder], Grounder]
"""Builds the grounder that is scored around the trained graph, anew for each sentence."""


@dataclasses.dataclass(frozen=True)
class Score:
    """What became of one sentence."""

    sentence: LabelledSentence
    outcome: str
    why: str  # the refusal, or what differs; empty where it is right
    confidence: float  # probability of the likeliest reading; 0 of a refusal


def score_sentences(
    sentences: Sequence[LabelledSentence],
    model: GroundingModel,
    on_progress: Callable[[int], None] | None = None,
    arm: Wrapping = lambda graph: graph,
    least_probability: float = MIN_PROBABILITY,
) -> list[Score]:
    """Score labelled sentences, in order.

    Args:
        sentences: with what they mean. The detector tells apart all types that these name, and
            the lexicon's.
        model: the trained models.
        on_progress: told after each sentence.
        arm: what reads them; the trained graph by default.
        least_probability: of what the trained reader makes of them, in [0, 1]; see ``parse``.
    """
    scores, labels = [], _labels_of(sentences, model)
    for sentence in sentences:
        graph = GraphGrounder(model, labels, least_probability=least_probability)
        scores.append(_score(sentence, graph, arm))
        if on_progress is not None:
            on_progress(1)
    return scores


def summarize_scores(scores: Sequence[Score]) -> dict[str, Any]:
    """Count scores of ``score_sentences`` in a JSON document.

    Counts of all and by construction, and what is not right, worst first: a wrong reading before a
    refusal, the surer the worse.
    """
    by_name: dict[str, list[Score]] = {}
    for one in scores:
        by_name.setdefault(one.sentence.construction, []).append(one)
    missed = [score for score in scores if score.outcome != CORRECT]
    missed.sort(key=lambda one: (one.outcome != WRONG, -one.confidence, one.sentence.line))
    return {
        **_count_scores(scores),
        "by_construction": {name: _count_scores(ones) for name, ones in by_name.items()},
        "worst": [
            {
                "line": one.sentence.line,
                "text": one.sentence.text,
                "construction": one.sentence.construction,
                "outcome": one.outcome,
                "why": one.why,
                "confidence": round(one.confidence, 4),
            }
            for one in missed
        ],
    }


def render_scores(document: dict[str, Any]) -> tuple[Any, list[str]]:
    """Draw a document of ``summarize_scores``: a rich table, and a line for each of the worst."""
    rows = [*document["by_construction"].items(), ("all", document)]
    columns: TableColumns = [
        ("construction", "{name}"),
        *((name, f"{{{name}}}") for name in ("sentences", *OUTCOMES)),
        ("right %", "{right_share:.1f}"),
    ]
    named = [{**row, "name": name or "-"} for name, row in rows]
    table = Table.of(named, columns, title="Sentences as labelled, right or rightly refused")
    worst = document["worst"]
    lines = [
        f"{one['outcome']}, line {one['line']}: {one['text']}\n    {one['why']}"
        for one in worst[:WORST_SHOWN]
    ]
    if len(worst) > WORST_SHOWN:
        lines.append(f"and {len(worst) - WORST_SHOWN} more: --json lists them all")
    return table.text(), lines


def _count_scores(scores: Sequence[Score]) -> dict[str, Any]:
    counts = Counter(score.outcome for score in scores)
    share = 100.0 * counts[CORRECT] / max(len(scores), 1)
    return {
        "sentences": len(scores),
        **{outcome: counts[outcome] for outcome in OUTCOMES},
        "right_share": round(share, 2),
    }


def _context_of(sentence: LabelledSentence) -> Context:
    """Tell what a grounder is told: only what is meant to inform may ask for nothing."""
    meaning = sentence.meaning
    return Context(is_under_way=meaning is not None and not meaning.reading.commands)


def _labels_of(sentences: Sequence[LabelledSentence], model: GroundingModel) -> tuple[str, ...]:
    """List what a detector tells apart for whom the sentences are meant."""
    meanings = [one.meaning for one in sentences if one.meaning is not None]
    named = [n for one in meanings for n in one.type_names if not is_reserved(n.lower())]
    return tuple(dict.fromkeys([*model.type_names, *named]))


def _score(sentence: LabelledSentence, graph: GraphGrounder, arm: Wrapping) -> Score:
    meaning = sentence.meaning
    try:
        grounded = arm(graph).ground(sentence.text, _context_of(sentence))
    except ValueError as error:
        outcome = CORRECT if meaning is None else REFUSED
        return Score(sentence, outcome, "" if meaning is None else str(error), 0.0)
    confidence = float(np.exp(grounded.instruction.readings.log_probability[0]))
    if meaning is None:
        return Score(sentence, WRONG, "was read, but must be refused", confidence)
    why = difference(meaning, grounded.instruction, graph.names)
    return Score(sentence, WRONG if why else CORRECT, why, confidence)


GRAPH, REWRITES, BOTH = ARMS = ("graph alone", "rewrites alone", "both")
"""What reads the sentences; both: the graph, and rewritings of what it refuses."""


def recorded_of(
    sentences: Sequence[LabelledSentence], recorded: RecordedRewrites
) -> list[LabelledSentence]:
    """Keep the sentences that were recorded, so that all arms are scored on the same.

    Raises:
        ValueError: none of them was; one line.
    """
    found = [one for one in sentences if one.text in recorded.answers]
    if not found:
        raise ValueError(
            f"none of the {len(sentences)} sentences stands in the file of rewritings: "
            "record the same texts"
        )
    return found


def compare_arms(
    sentences: Sequence[LabelledSentence],
    recorded: RecordedRewrites,
    model: GroundingModel,
    temperature: float,
    on_progress: Callable[[int], None] | None = None,
) -> dict[str, Any]:
    """Score labelled sentences as the graph reads them, as their rewritings say, and both.

    ``temperature`` is of the weights of rewritings; ``on_progress`` is told after each sentence of
    each arm.

    Returns:
        A JSON document: ``temperature``; ``arms``, by name as ``summarize_scores`` counts, and
        the same counts of the sentences that are ``meant`` to be read and those ``to_refuse``.
    """
    params = default_rewrite_params(temperature)

    def rewritten(graph: GraphGrounder) -> RewriteGrounder:
        return RewriteGrounder(graph, recorded, params=params)

    builds: dict[str, Wrapping] = {
        GRAPH: lambda graph: graph,
        REWRITES: rewritten,
        BOTH: lambda graph: FirstGrounder(graph, rewritten(graph)),
    }
    arms = {}
    for name in ARMS:
        scores = score_sentences(sentences, model, on_progress, builds[name])
        arms[name] = {
            **summarize_scores(scores),
            "meant": _count_scores([one for one in scores if one.sentence.meaning is not None]),
            "to_refuse": _count_scores([one for one in scores if one.sentence.meaning is None]),
        }
    return {"temperature": temperature, "arms": arms}


def fit_recorded(
    sentences: Sequence[LabelledSentence], recorded: RecordedRewrites, model: GroundingModel
) -> TemperatureFit:
    """Fit the temperature to recorded rewritings of sentences that are labelled with a meaning.

    Raises:
        ValueError: they say nothing about it; one line.
    """
    labels, judged = _labels_of(sentences, model), []
    for one in sentences:
        if one.meaning is None:
            continue
        graph = GraphGrounder(model, labels)
        found, _ = verify_rewrites(graph, recorded(one.text), _context_of(one))
        is_right = [
            not difference(one.meaning, read.grounded.instruction, graph.names) for read in found
        ]
        judged.append(Judged(tuple(read.log_probability for read in found), tuple(is_right)))
    return fit_source_temperature(judged)


def render_arms(document: dict[str, Any], fit: TemperatureFit | None) -> tuple[Any, list[str]]:
    """Draw a document of ``compare_arms``, and a fit if there was one: a rich table, and lines."""
    columns: TableColumns = [
        ("", "{name}"),
        *((f"meant: {name}", f"{{meant[{name}]}}") for name in OUTCOMES),
        ("to refuse: right", f"{{to_refuse[{CORRECT}]}}"),
        ("wrong", f"{{to_refuse[{WRONG}]}}"),
        ("all right %", "{right_share:.1f}"),
    ]
    arms = [{**row, "name": name} for name, row in document["arms"].items()]
    table = Table.of(arms, columns, title="Sentences as labelled, by what reads them")
    lines = [f"temperature {document['temperature']:.3g}"]
    if fit is not None:
        told = dataclasses.asdict(fit)
        lines.append(
            "fitted to {used} sentences: mean log-likelihood {log_likelihood:.3f}, at temperature "
            "1 {log_likelihood_at_one:.3f}; {left_out} say nothing about it".format(**told)
            + (" (at the bound of what is looked for)" if fit.is_at_bound else "")
        )
    return table.text(), lines
