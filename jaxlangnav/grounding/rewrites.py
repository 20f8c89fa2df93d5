"""Grounder of paraphrases in the controlled language from another source (sections 3.1, 3.3).

A source, such as a language model, rewrites a sentence in several ways, with log-probabilities.
Rewritings that cannot be parsed are dropped and counted; the trained graph grounds the rest. Their
readings form a mixture, weighted by probability, as evidence for the map.

Commands are not mixed: a compiled clause is log-linear in the phrases of one sentence, and no
clause yields the weighted sum of the behaviors of two. Rewritings of equal meaning are grouped and
their weights summed; the likeliest rewriting of the group with the largest weight is executed.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from jaxlangnav.grounding.command_summary import CommandSummary, summarize_commands
from jaxlangnav.grounding.grounder import Alternative, Context, Grounded, Grounder, WrappedGrounder
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.grounding.readings import NUM_READINGS, Reading, pad_readings, unpad_readings
from jaxlangnav.grounding.search import sum_by_key
from jaxlangnav.inputs.documents import error_prefix, parse_json, read_lines
from jaxlangnav.inputs.sanitize import quote
from jaxlangnav.inputs.schema import Schema, convert
from jaxlangnav.messages import ROBOT
from jaxlangnav.pytree import replace

MAX_REWRITES = 16
"""Maximum number of rewritings of one sentence that are read, likeliest first."""
_MIN_REPORTED = 0.005  # fractions of the weight below this are not reported

Rewrite = tuple[str, float]
"""A sentence of the controlled language, and its log-probability; they need not sum to one."""


class RewriteSource(Protocol):
    """Protocol of a source of rewritings in the controlled language."""

    def __call__(self, text: str) -> Sequence[Rewrite]:
        """Rewrite a sentence: with log-probabilities, in any order; none where it knows of none."""
        ...


def check_temperature(value: float) -> float:
    """Return a temperature rounded to float32; ``ValueError`` if it is none."""
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"temperature is {value}, but must be a finite number above 0")
    return float(np.float32(value))


class Read(NamedTuple):
    """A rewriting that has been parsed and grounded."""

    text: str
    log_probability: float  # as the source has it
    grounded: Grounded


class RewriteGrounder(WrappedGrounder):
    """Grounder of the rewritings of a sentence, in place of the sentence itself."""

    def __init__(self, graph: Grounder, source: RewriteSource, *, temperature: float = 1.0) -> None:
        """Combine a source of rewritings with a grounder of the controlled language.

        Weights are softmax(log-probability / ``temperature``): 1 takes the source as calibrated,
        above 1 as overconfident; ``fit_source_temperature`` finds one for a source.
        """
        super().__init__(graph)
        self.source = source
        self.temperature = check_temperature(temperature)

    def ground(self, text: str, context: Context) -> Grounded:
        """Ground a sentence by its rewritings; see ``Grounder.ground``."""
        rewrites, notes = self._rewrites(text)
        grounded, refusals = verify_rewrites(self.grounder, rewrites, context)
        if not grounded:
            refused, reason = next(iter(refusals.items()))
            raise ValueError(
                f"none of the {len(refusals)} rewritings of {quote(text)} can be read; "
                f"the likeliest is {quote(refused)}: {reason}"
            )
        if refusals:
            log_refused = [score / self.temperature for item, score in rewrites if item in refusals]
            log_all = [score / self.temperature for _, score in rewrites]
            fraction = np.exp(np.logaddexp.reduce(log_refused) - np.logaddexp.reduce(log_all))
            notes += (
                f"{len(refusals)} of {len(rewrites)} rewritings cannot be read and are left out, "
                f"{fraction:.0%} of the weight",
            )
        log_weights = np.array([read.log_probability for read in grounded]) / self.temperature
        log_weights -= np.logaddexp.reduce(log_weights)
        return _mixture(grounded, log_weights, notes)

    def _rewrites(self, text: str) -> tuple[list[Rewrite], tuple[str, ...]]:
        """Query the source: distinct rewritings, likeliest first, and notes."""
        answers = self.source(text)
        for rewrite, score in answers:
            if not isinstance(rewrite, str) or math.isnan(score) or score == math.inf:
                raise ValueError(
                    f"the source gives {quote(rewrite)} the log-probability {score}; it must be a "
                    "text and a number that is finite or -inf"
                )
        ranked = sum_by_key((item for item in answers if item[1] > -math.inf), np.logaddexp)
        if not ranked:
            raise ValueError(f"the source has no rewriting of {quote(text)}: say it in other words")
        left_out = len(ranked) - MAX_REWRITES
        notes = (f"{left_out} less likely rewritings are not read",) if left_out > 0 else ()
        return ranked[:MAX_REWRITES], notes


def verify_rewrites(
    graph: Grounder, rewrites: Sequence[Rewrite], context: Context
) -> tuple[list[Read], dict[str, str]]:
    """Parse and ground rewritings: the grounded ones, and the error of each refused text."""
    reads, refusals = [], {}
    for text, score in rewrites:
        try:
            reads.append(Read(text, score, graph.ground(text, context)))
        except ValueError as error:
            refusals[text] = str(error)
    return reads, refusals


def _mixture(reads: Sequence[Read], log_weights: np.ndarray, notes: tuple[str, ...]) -> Grounded:
    """Mix the readings of rewritings, with the commands of the likeliest meaning."""
    groups: dict[Any, list[int]] = {}
    for index, read in enumerate(reads):
        groups.setdefault(meaning_key(read.grounded.instruction), []).append(index)
    weight = np.exp(log_weights)
    ranked = sorted(groups.values(), key=lambda group: -weight[group].sum())
    alternatives = []
    for group in ranked:  # represented by its likeliest rewriting
        best, prob = reads[max(group, key=lambda index: weight[index])], weight[group].sum()
        alternative = Alternative(says=best.text, probability=float(prob), grounded=best.grounded)
        alternatives.append(alternative)
    likeliest = alternatives[0]
    summary = [f"read as '{likeliest.says}', {likeliest.probability:.0%} of the weight"]
    if reported := [item for item in alternatives[1:] if item.probability >= _MIN_REPORTED]:
        others = ", ".join(f"'{item.says}' {item.probability:.0%}" for item in reported)
        summary.append(f"it may also mean {others}")
    readings, left_out = _mixed_readings(reads, log_weights, [i for group in ranked for i in group])
    if left_out >= _MIN_REPORTED:
        summary.append(f"readings of {left_out:.0%} of the weight are more than are held")
    return Grounded(
        instruction=replace(likeliest.grounded.instruction, readings=pad_readings(readings)),
        annotations=_mixed_annotations(reads, weight),
        notes=(*notes, *summary, *likeliest.grounded.notes),
        spoken=likeliest.grounded.spoken,
        alternatives=tuple(alternatives),
    )


def _mixed_readings(
    reads: Sequence[Read], log_weights: np.ndarray, order: Sequence[int]
) -> tuple[list[tuple[Reading, float]], float]:
    """Sum equal readings by weight: the likeliest ones, and the fraction of the weight left out."""
    scored = [
        (reading, score + float(log_weights[index]))
        for index in order
        for reading, score in unpad_readings(reads[index].grounded.instruction.readings)
    ]
    by_key = {_canonical(reading): reading for reading, _ in reversed(scored)}
    ranked = sum_by_key(((_canonical(reading), score) for reading, score in scored), np.logaddexp)
    left_out = sum(math.exp(score) for _, score in ranked[NUM_READINGS:])
    return [(by_key[key], score) for key, score in ranked[:NUM_READINGS]], left_out


def _canonical(reading: Reading) -> tuple[Any, ...]:
    """Build a key of a reading that does not depend on the order of mentions and relations."""
    kinds = dict(enumerate(reading.mentions))  # NONE stays as it is
    edges = [
        (kinds.get(figure, figure), relation, kinds.get(landmark, landmark), rank)
        for figure, relation, landmark, rank in reading.relations
    ]
    return tuple(sorted(reading.mentions)), tuple(sorted(edges))


def meaning_key(instruction: Instruction) -> tuple[Any, ...]:
    """Build a key of a sentence's annotations and commands, equal for wordings of one meaning."""
    reading, _ = unpad_readings(instruction.readings)[0]

    def description(mention: int) -> tuple[Any, ...]:
        if mention < 0:
            return (mention,)
        if reading.mentions[mention] == ROBOT:
            return (ROBOT,)
        edges = [edge for edge in reading.relations if edge[0] == mention and edge[2] >= 0]
        relations = sorted((edge[1], reading.mentions[edge[2]], edge[3]) for edge in edges)
        return (reading.mentions[mention], *relations)

    def command_key(c: CommandSummary) -> tuple[Any, ...]:
        avoided = sorted((region, description(mention)) for region, mention, _ in c.avoid)
        return (c.action, c.mode, c.region, description(c.mention), tuple(avoided))

    return (_canonical(reading), tuple(map(command_key, summarize_commands(instruction))))


def _mixed_annotations(reads: Sequence[Read], weight: np.ndarray) -> tuple[Mapping[str, Any], ...]:
    """Sum annotations by weight, likeliest first."""
    ranked = sum_by_key(
        (
            tuple(item for item in document.items() if item[0] != "probability"),
            float(w) * float(document["probability"]),
        )
        for read, w in zip(reads, weight, strict=True)
        for document in read.grounded.annotations
    )
    return tuple(dict(key) | {"probability": min(prob, 1.0)} for key, prob in ranked)


# ---------------------------------------------------------------- recorded rewritings

_MAX_FILE_BYTES = 32 * 1024 * 1024  # size limit of a file of rewritings in bytes


class _Recorded(Schema):
    text: str
    rewrites: list[Rewrite]

    def __post_init__(self) -> None:
        """Check that the log-probabilities are finite."""
        for text, score in self.rewrites:
            if not math.isfinite(score):
                raise ValueError(f"rewrites has {score} for {quote(text)}, but must be finite")


class RecordedRewrites:
    """A source of rewritings that were recorded in a file, so that the model is not queried again.

    JSON lines, one sentence a line; the log-probabilities are natural logarithms:

        {"text": "hang out near the bench", "rewrites": [["wait near the bench", -0.3]]}
    """

    def __init__(self, path: Path) -> None:
        """Read a file in the format above; empty lines are left out.

        Raises:
            ValueError: no such file, or a line cannot be; one line that names file and line.
        """
        self.answers: dict[str, tuple[Rewrite, ...]] = {}
        for line_number, line in read_lines(path, max_bytes=_MAX_FILE_BYTES):
            with error_prefix(f"{path}:{line_number}"):
                record = convert(parse_json(line), _Recorded)
                if record.text in self.answers:
                    raise ValueError(f"text {quote(record.text)} stands in an earlier line already")
            self.answers[record.text] = tuple(record.rewrites)
        if not self.answers:
            raise ValueError(f"{path}: holds no rewriting: write one JSON object a line")

    def __call__(self, text: str) -> Sequence[Rewrite]:
        """Look up the rewritings of a sentence; empty if it was not recorded."""
        return self.answers.get(text, ())
