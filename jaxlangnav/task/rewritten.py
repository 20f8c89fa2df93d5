"""Labelled sentences by their recorded rewritings: what they add to the trained graph (4.1)."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

from rich.table import Table

from jaxlangnav.grounding.choosing import FirstGrounder
from jaxlangnav.grounding.grounder import GraphGrounder
from jaxlangnav.grounding.instruction import GroundingModel
from jaxlangnav.grounding.recorded import RecordedRewrites
from jaxlangnav.grounding.rewrites import RewriteGrounder, default_rewrite_params, verify_rewrites
from jaxlangnav.task.compared import difference
from jaxlangnav.task.labelled import LabelledSentence
from jaxlangnav.task.scored import (
    CORRECT,
    OUTCOMES,
    WRONG,
    ReadAs,
    Score,
    Wrapping,
    context_of,
    count_scores,
    labels_of,
    score_sentences,
    summarize_scores,
)
from jaxlangnav.training.temperature import Judged, TemperatureFit, fit_source_temperature

GRAPH, REWRITES, BOTH = ARMS = ("graph alone", "rewrites alone", "both")
"""What reads the sentences; both: the graph, and rewritings of what it refuses."""


def recorded_of(
    sentences: Sequence[LabelledSentence], recorded: RecordedRewrites
) -> list[LabelledSentence]:
    """Keep the sentences that were recorded, so that all arms are scored on the same.

    Args:
        sentences: labelled.
        recorded: answers of a source; a sentence may have been answered by none.

    Returns:
        Those recorded.

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
    """Score sentences as the graph reads them, as rewritings say, and both.

    Args:
        sentences: labelled.
        recorded: their rewritings.
        model: the trained models.
        temperature: of the weights of rewritings.
        on_progress: told after each sentence of each arm.

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
    return {
        "temperature": temperature,
        "arms": {
            name: _summary(score_sentences(sentences, model, on_progress, builds[name]))
            for name in ARMS
        },
    }


def _summary(scores: Sequence[Score]) -> dict[str, Any]:
    """Count scores, those of sentences that mean something and of others apart."""
    meant = [one for one in scores if one.sentence.meaning is not None]
    others = [one for one in scores if one.sentence.meaning is None]
    return {
        **summarize_scores(scores),
        "meant": count_scores(meant),
        "to_refuse": count_scores(others),
    }


def fit_recorded(
    sentences: Sequence[LabelledSentence], recorded: RecordedRewrites, model: GroundingModel
) -> TemperatureFit:
    """Fit the temperature to recorded rewritings of labelled sentences.

    Args:
        sentences: labelled; those that must be refused say nothing.
        recorded: their rewritings.
        model: the trained models.

    Returns:
        The likeliest temperature.

    Raises:
        ValueError: they say nothing about it; one line.
    """
    labels = labels_of(sentences, model)
    return fit_source_temperature(
        [_judge(one, recorded, GraphGrounder(model, labels)) for one in sentences if one.meaning]
    )


def _judge(sentence: LabelledSentence, recorded: RecordedRewrites, graph: GraphGrounder) -> Judged:
    """Judge each rewriting that can be read by the label."""
    found, _ = verify_rewrites(graph, recorded(sentence.text), context_of(sentence))
    is_right = [
        sentence.meaning is not None
        and not difference(sentence.meaning, ReadAs(one.grounded.instruction, graph.names))
        for one in found
    ]
    return Judged(tuple(one.log_probability for one in found), tuple(is_right))


def render_arms(document: dict[str, Any], fit: TemperatureFit | None) -> tuple[Table, list[str]]:
    """Draw the table for people, and the lines below it.

    Args:
        document: of ``compare_arms``.
        fit: of the temperature, if it was fitted.

    Returns:
        A rich table; lines.
    """
    table = Table(title="Sentences as labelled, by what reads them")
    headings = [f"meant: {name}" for name in OUTCOMES]
    for name in ("", *headings, "to refuse: right", "wrong", "all right %"):
        table.add_column(name, justify="right" if name else "left")
    for name, row in document["arms"].items():
        meant = [str(row["meant"][one]) for one in OUTCOMES]
        others = [str(row["to_refuse"][one]) for one in (CORRECT, WRONG)]
        table.add_row(name, *meant, *others, f"{row['right_share']:.1f}")
    lines = [f"temperature {document['temperature']:.3g}"]
    if fit is not None:
        told = dataclasses.asdict(fit)
        lines.append(
            "fitted to {used} sentences: mean log-likelihood {log_likelihood:.3f}, at temperature "
            "1 {log_likelihood_at_one:.3f}; {left_out} say nothing about it".format(**told)
            + (" (at the bound of what is looked for)" if fit.is_at_bound else "")
        )
    return table, lines
