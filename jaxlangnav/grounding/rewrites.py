"""A grounder for rewritings: what others put into the controlled language (sections 3.1, 3.3).

A source, such as a language model, gives a sentence in other words, several times, with
log-probabilities. What the parser cannot read is dropped and counted, and the trained graph grounds
the rest. Their readings are mixed by weight, as evidence for the map.

Commands are not mixed: a behavior program is log-linear in the phrases of one sentence, and no
program has as its behaviors the weighted sum of those of two. Rewritings that mean the same put
their weights together, and of the weightiest meaning the likeliest rewriting commands.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.grounding.asked import CommandSummary, summarize_commands
from jaxlangnav.grounding.form import quote
from jaxlangnav.grounding.grounder import Alternative, Context, Grounded, Grounder, OtherTypes
from jaxlangnav.grounding.readings import NUM_READINGS, Reading, pad_readings, unpad_readings
from jaxlangnav.grounding.search import add_up
from jaxlangnav.inputs.documents import naming, parse_json, read_lines
from jaxlangnav.inputs.schema import Schema, convert
from jaxlangnav.messages import ROBOT
from jaxlangnav.pytree import pytree, replace

MOST_REWRITES = 16
"""Rewritings of one sentence that are read: the likeliest."""
_LEAST_TOLD = 0.005
"""Shares of the weight smaller than this are not told."""

Rewrite = tuple[str, float]
"""A sentence of the controlled language, and its log-probability; they need not sum to one."""


class RewriteSource(Protocol):
    """What puts sentences into the controlled language."""

    def __call__(self, text: str) -> Sequence[Rewrite]:
        """Rewrite a sentence: with log-probabilities, in any order; none where it knows of none."""
        ...


@pytree
class RewriteParams:
    """How far the source's log-probabilities are believed."""

    temperature: Array  # f32[] above 0; weights are softmax(log-probability / temperature)


def default_rewrite_params(temperature: float = 1.0) -> RewriteParams:
    """Build parameters; ``fit_source_temperature`` finds a temperature for a source.

    1 believes the source; above 1 it is taken to be too sure of itself.

    Raises:
        ValueError: the temperature is none; one line.
    """
    if not (math.isfinite(temperature) and temperature > 0.0):
        raise ValueError(f"temperature is {temperature}, but must be a finite number above 0")
    return RewriteParams(temperature=jnp.float32(temperature))


@dataclasses.dataclass(frozen=True)
class Read:
    """A rewriting that could be read."""

    text: str
    log_probability: float  # as the source has it
    grounded: Grounded


class RewriteGrounder(OtherTypes):
    """Grounds rewritings of what is said, and not its own words."""

    def __init__(
        self, graph: Grounder, source: RewriteSource, *, params: RewriteParams | None = None
    ) -> None:
        """Join what puts sentences into the controlled language to what reads those."""
        super().__init__(graph)
        self.graph = graph
        self.source = source
        self.params = default_rewrite_params() if params is None else params

    def ground(self, text: str, context: Context) -> Grounded:
        """Understand a sentence by its rewritings; see ``Grounder.ground``."""
        rewrites, notes = self._rewrites(text)
        found, refusals = verify_rewrites(self.graph, rewrites, context)
        if not found:
            first, why = next(iter(refusals.items()))
            raise ValueError(
                f"none of the {len(refusals)} rewritings of {quote(text)} can be read; "
                f"the likeliest is {quote(first)}: {why}"
            )
        temperature = float(self.params.temperature)
        if refusals:
            log_lost = [score / temperature for one, score in rewrites if one in refusals]
            log_all = [score / temperature for _, score in rewrites]
            lost = np.exp(np.logaddexp.reduce(log_lost) - np.logaddexp.reduce(log_all))
            notes += (
                f"{len(refusals)} of {len(rewrites)} rewritings cannot be read and are left out, "
                f"{lost:.0%} of the weight",
            )
        log_weights = np.array([one.log_probability for one in found]) / temperature
        log_weights -= np.logaddexp.reduce(log_weights)
        return _mixed(found, log_weights, notes)

    def _rewrites(self, text: str) -> tuple[list[Rewrite], tuple[str, ...]]:
        """Ask the source: the likeliest first, each text once, and what to note."""
        given = self.source(text)
        for one, score in given:
            if not isinstance(one, str) or math.isnan(score) or score == math.inf:
                raise ValueError(
                    f"the source gives {quote(one)} the log-probability {score}; it must be a "
                    "text and a number that is finite or -inf"
                )
        ranked = add_up((one for one in given if one[1] > -math.inf), np.logaddexp)
        if not ranked:
            raise ValueError(f"the source has no rewriting of {quote(text)}: say it in other words")
        left_out = len(ranked) - MOST_REWRITES
        notes = (f"{left_out} less likely rewritings are not read",) if left_out > 0 else ()
        return ranked[:MOST_REWRITES], notes


def verify_rewrites(
    graph: Grounder, rewrites: Sequence[Rewrite], context: Context
) -> tuple[list[Read], dict[str, str]]:
    """Parse and ground rewritings, each once: those that can be read, why others cannot."""
    found, refusals = [], {}
    for text, score in rewrites:
        try:
            found.append(Read(text, score, graph.ground(text, context)))
        except ValueError as error:
            refusals[text] = str(error)
    return found, refusals


def _mixed(found: Sequence[Read], log_weights: np.ndarray, notes: tuple[str, ...]) -> Grounded:
    """Mix what rewritings say, and let those of the weightiest meaning command."""
    groups: dict[Any, list[int]] = {}
    for index, one in enumerate(found):
        groups.setdefault(_meaning(one.grounded), []).append(index)
    weight = np.exp(log_weights)
    ranked = sorted(groups.values(), key=lambda group: -weight[group].sum())
    alternatives = []
    for group in ranked:  # the weightiest of the rewritings that mean the same speaks for them
        best, share = found[max(group, key=lambda index: weight[index])], weight[group].sum()
        one = Alternative(says=best.text, probability=float(share), grounded=best.grounded)
        alternatives.append(one)
    first = alternatives[0]
    chosen = [f"read as '{first.says}', {first.probability:.0%} of the weight"]
    told = [one for one in alternatives[1:] if one.probability >= _LEAST_TOLD]
    if told:
        others = ", ".join(f"'{one.says}' {one.probability:.0%}" for one in told)
        chosen.append(f"it may also mean {others}")
    readings, left_out = _mixed_readings(found, log_weights, [i for group in ranked for i in group])
    if left_out >= _LEAST_TOLD:
        chosen.append(f"readings of {left_out:.0%} of the weight are more than are held")
    return Grounded(
        instruction=replace(first.grounded.instruction, readings=pad_readings(readings)),
        annotations=_mixed_annotations(found, weight),
        notes=(*notes, *chosen, *first.grounded.notes),
        spoken=first.grounded.spoken,
        alternatives=tuple(alternatives),
    )


def _mixed_readings(
    found: Sequence[Read], log_weights: np.ndarray, order: Sequence[int]
) -> tuple[list[tuple[Reading, float]], float]:
    """Sum readings by weight: the likeliest that are held, and the share of those that are not."""
    given = [
        (reading, score + float(log_weights[index]))
        for index in order
        for reading, score in unpad_readings(found[index].grounded.instruction.readings)
    ]
    first = {_said(reading): reading for reading, _ in reversed(given)}
    ranked = add_up(((_said(reading), share) for reading, share in given), np.logaddexp)
    left_out = sum(math.exp(share) for _, share in ranked[NUM_READINGS:])
    return [(first[key], share) for key, share in ranked[:NUM_READINGS]], left_out


def _said(reading: Reading) -> tuple[Any, ...]:
    """Tell what a reading says, in whatever order it says it."""
    kinds = dict(enumerate(reading.mentions))  # NONE stays as it is
    edges = [
        (kinds.get(figure, figure), relation, kinds.get(landmark, landmark), rank)
        for figure, relation, landmark, rank in reading.relations
    ]
    return tuple(sorted(reading.mentions)), tuple(sorted(edges))


def _meaning(grounded: Grounded) -> tuple[Any, ...]:
    """Tell what a sentence says and asks for, so that wordings of one meaning compare equal."""
    reading, _ = unpad_readings(grounded.instruction.readings)[0]

    def thing(mention: int) -> tuple[Any, ...]:
        if mention < 0:
            return (mention,)
        if reading.mentions[mention] == ROBOT:
            return (ROBOT,)
        own = [edge for edge in reading.relations if edge[0] == mention and edge[2] >= 0]
        places = sorted((edge[1], reading.mentions[edge[2]], edge[3]) for edge in own)
        return (reading.mentions[mention], *places)

    def ask(one: CommandSummary) -> tuple[Any, ...]:
        avoided = sorted((region, thing(mention)) for region, mention, _ in one.avoid)
        return (one.action, one.mode, one.region, thing(one.mention), tuple(avoided))

    return (_said(reading), tuple(ask(one) for one in summarize_commands(grounded.instruction)))


def _mixed_annotations(found: Sequence[Read], weight: np.ndarray) -> tuple[Mapping[str, Any], ...]:
    """Sum annotations by weight, likeliest first."""
    ranked = add_up(
        (
            tuple(item for item in said.items() if item[0] != "probability"),
            float(share) * float(said["probability"]),
        )
        for one, share in zip(found, weight, strict=True)
        for said in one.grounded.annotations
    )
    return tuple(dict(key) | {"probability": min(share, 1.0)} for key, share in ranked)


# ---------------------------------------------------------------- recorded rewritings


_LARGEST_FILE = 32 * 1024 * 1024
"""Bytes of such a file."""


class _Recorded(Schema):
    text: str
    rewrites: list[Rewrite]

    def __post_init__(self) -> None:
        """Take any characters, and finite numbers alone."""
        for one, score in self.rewrites:
            if not math.isfinite(score):
                raise ValueError(f"rewrites has {score} for {quote(one)}, but must be finite")


class RecordedRewrites:
    """A source that answers from a file, so that nothing has to be asked again.

    JSON lines, one sentence a line; the log-probabilities are natural logarithms:

        {"text": "hang out near the bench", "rewrites": [["wait near the bench", -0.3]]}
    """

    def __init__(self, path: Path) -> None:
        """Read a file in the format above; empty lines are left out.

        Raises:
            ValueError: no such file, or a line cannot be; one line that names file and line.
        """
        self.answers: dict[str, tuple[Rewrite, ...]] = {}
        for number, line in read_lines(path, at_most=_LARGEST_FILE):
            with naming(f"{path}:{number}"):
                document = parse_json(line)
                if not isinstance(document, dict):
                    why = "must be an object with text and rewrites"
                    raise ValueError(f"is {quote(document)}, but {why}")
                one = convert(document, _Recorded)
                if one.text in self.answers:
                    raise ValueError(f"text {quote(one.text)} stands in an earlier line already")
            self.answers[one.text] = tuple(one.rewrites)
        if not self.answers:
            raise ValueError(f"{path}: holds no rewriting: write one JSON object a line")

    def __call__(self, text: str) -> Sequence[Rewrite]:
        """Look a sentence up; nothing where it was not recorded."""
        return self.answers.get(text, ())
