"""The ``Grounder`` protocol, from text to instruction, and its implementations (sections 3.1, 3.3).

A source of annotations is a grounder: the trained graph, a form (``annotated``), one of your own,
or a combination of others: a fallback, or one whose alternatives a person chooses from.
"""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np

from jaxlangnav.grounding.annotation import annotation_document
from jaxlangnav.grounding.binding import Detector
from jaxlangnav.grounding.instruction import GroundingModel, Instruction, Referents, understand
from jaxlangnav.grounding.readings import pad_readings, unpad_readings
from jaxlangnav.inputs.object_types import name_of, noun_of
from jaxlangnav.language.phrase import MIN_PROBABILITY
from jaxlangnav.language.reference import Antecedent
from jaxlangnav.messages import NONE, ROBOT
from jaxlangnav.pytree import replace


@dataclasses.dataclass(frozen=True, kw_only=True)
class Context:
    """Dialogue context of a text to ground."""

    is_under_way: bool  # the robot has had an instruction before, and may be following it
    about: int = NONE  # object type that is the antecedent of "it" and "one"
    is_at: bool = False  # the robot is at such an object, or on its way to it


@dataclasses.dataclass(frozen=True, kw_only=True)
class Grounded:
    """Result of grounding a text: the instruction, and its description for people."""

    instruction: Instruction
    annotations: tuple[Mapping[str, Any], ...]
    """Annotations of the world, likeliest first: figure, relation, landmark, superlative and
    probability, as ``jaxlangnav ground --json`` prints them."""
    notes: tuple[str, ...] = ()
    """Further remarks for people, a line each."""
    spoken: Referents | None = None
    """Object types referred to, for the dialogue state; None: derived from the readings."""
    alternatives: "tuple[Alternative, ...]" = ()
    """Alternative interpretations, likeliest first, if the grounder distinguishes them."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Alternative:
    """One interpretation of a text, with its probability."""

    says: str  # paraphrase for people, one line
    probability: float
    grounded: Grounded


@runtime_checkable
class Grounder(Protocol):
    """Protocol of a grounder, which turns text into an instruction."""

    @property
    def type_names(self) -> tuple[str, ...]:
        """Object types of the grounder; the type of a detection is an index into them."""
        ...

    def ground(self, text: str, context: Context) -> Grounded:
        """Ground an instruction.

        Args:
            text: the instruction, in a form that the grounder accepts.
            context: state of the dialogue.

        Returns:
            The grounded text; without a command, it only informs, or says what to keep away
            from.

        Raises:
            ValueError: the text is refused; one line that says why and what to do about it.
        """
        ...


def names_of(grounder: Grounder) -> tuple[str, ...]:
    """List the types of a grounder, then nouns of earlier sentences that have no type."""
    return getattr(grounder, "names", grounder.type_names)


class WrappedGrounder:
    """Base class of grounders that wrap another grounder and share its object types."""

    def __init__(self, grounder: Grounder) -> None:
        """Store the grounder whose types are shared."""
        self.grounder = grounder

    @property
    def type_names(self) -> tuple[str, ...]:
        """The types of the wrapped grounder."""
        return self.grounder.type_names

    @property
    def names(self) -> tuple[str, ...]:
        """The types, then nouns without a type."""
        return names_of(self.grounder)


class GraphGrounder:
    """Grounder of the controlled language: the trained Distributed Correspondence Graph."""

    def __init__(
        self,
        model: GroundingModel,
        labels: Iterable[str] | None = None,
        attributes: Iterable[str] = (),
        *,
        least_probability: float = MIN_PROBABILITY,
    ) -> None:
        """Bind the graph to a detector.

        Args:
            model: trained models.
            labels: labels of the detector, in index order; the types of the models by default.
            attributes: groups of ``ATTRIBUTES`` that it reports.
            least_probability: threshold on the probability of the trained reader's rewriting of
                free speech, in [0, 1]; below it, the text is refused.

        Raises:
            ValueError: labels or groups are refused; one line.
        """
        self.model = model
        self.least_probability = least_probability
        self.detector = Detector(model.type_names if labels is None else labels, attributes)

    @classmethod
    def of_detector(cls, model: GroundingModel, detector: Detector) -> Self:
        """Bind the graph to a detector that keeps the nouns of earlier sentences."""
        bound = cls(model, detector.labels, detector.attribute_groups)
        bound.detector = detector
        return bound

    @property
    def type_names(self) -> tuple[str, ...]:
        """The detector's labels."""
        return self.detector.labels

    @property
    def names(self) -> tuple[str, ...]:
        """The labels, then nouns of sentences without a label."""
        return self.detector.names

    def ground(self, text: str, context: Context) -> Grounded:
        """Ground a sentence; see ``Grounder.ground``."""
        earlier = None
        if context.about != NONE:
            earlier = Antecedent(kind=noun_of(context.about, self.names), is_at=context.is_at)
        understood = understand(text, self.model, self.detector, earlier, self.least_probability)
        # A robot under way also accepts statements and constraints.
        if not context.is_under_way or int(understood.instruction.num_clauses):
            understood.check_task(is_first=not context.is_under_way)
        unknown = [w for w in understood.unknown_words if w not in understood.type_names]
        unread = understood.parse.unread
        return Grounded(
            instruction=understood.instruction,
            annotations=tuple(understood.annotations),
            notes=(
                *(f"not in the lexicon: '{word}'" for word in unknown),
                *(f"left out, as it says nothing of the task: '{words}'" for words in unread),
                *understood.notes,
            ),
            spoken=understood.spoken,
        )


# ---------------------------------------------------------------- combined grounders

Chooser = Callable[[str, Sequence[Alternative]], int | None]
"""Callback that is given the text and its alternatives, likeliest first, and returns the index of
the chosen one, or None to reject all."""
MIN_ASKED = 0.05
"""Alternatives less probable than this are not asked about."""


class FirstGrounder(WrappedGrounder):
    """Fallback: grounds with one grounder, and with another if the first refuses."""

    def __init__(self, first: Grounder, then: Grounder) -> None:
        """Combine two grounders of one detector: if ``first`` refuses, ``then`` is used."""
        if first.type_names != then.type_names:
            raise ValueError("the grounders have different type_names: give both one detector's")
        super().__init__(first)
        self.then = then

    def ground(self, text: str, context: Context) -> Grounded:
        """Ground an instruction; if both refuse, the first's error is raised."""
        try:
            return self.grounder.ground(text, context)
        except ValueError as error:
            refusal = error
        try:
            reply = self.then.ground(text, context)
        except ValueError as error:
            raise refusal from error
        return dataclasses.replace(reply, notes=(f"not read as it stands: {refusal}", *reply.notes))


class ChoosingGrounder(WrappedGrounder):
    """Clarification: a person chooses among the alternatives of an ambiguous instruction."""

    def __init__(self, grounder: Grounder, choose: Chooser, *, least: float = MIN_ASKED) -> None:
        """Wrap a grounder.

        Args:
            grounder: yields the alternatives.
            choose: asks the person; not called if there is only one alternative.
            least: alternatives less probable than this are not asked about.
        """
        super().__init__(grounder)
        self.choose = choose
        self.least = least

    def ground(self, text: str, context: Context) -> Grounded:
        """Ground an instruction, and ask which alternative is meant; see ``Grounder.ground``."""
        grounded = self.grounder.ground(text, context)
        options = grounded.alternatives or tuple(_by_reading(grounded, self.names))
        options = [option for option in options if option.probability >= self.least]
        if len(options) < 2:
            return grounded
        answer = self.choose(text, options)
        if answer is None:
            raise ValueError(
                f"none of the {len(options)} ways to understand it is meant: say it in other words"
            )
        if not 0 <= answer < len(options):
            raise ValueError(f"the answer is {answer}, but there are ways 0 to {len(options) - 1}")
        chosen = options[answer]
        note = f"chosen: '{chosen.says}'"
        return dataclasses.replace(chosen.grounded, notes=(note, *chosen.grounded.notes))


def _by_reading(grounded: Grounded, names: Sequence[str]) -> Iterator[Alternative]:
    """Yield each reading as an alternative; the commands are those of the sentence."""
    ranked = sorted(unpad_readings(grounded.instruction.readings), key=lambda item: -item[1])
    for reading, score in ranked:
        nouns = ["robot" if m == ROBOT else name_of(m, names) for m in reading.mentions]
        entries = [*nouns, None]  # NONE is the last index
        documents = tuple(
            annotation_document(entries[figure], entries[landmark], relation, rank, 1.0)
            for figure, relation, landmark, rank in reading.relations
        )
        instruction = replace(grounded.instruction, readings=pad_readings([(reading, 0.0)]))
        yield Alternative(
            says="; ".join(map(_describe, documents)),
            probability=float(np.exp(score)),
            grounded=dataclasses.replace(grounded, instruction=instruction, annotations=documents),
        )


def _describe(annotation: Mapping[str, Any]) -> str:
    """Describe an annotation in words: "cone near car, number 1 of its kind"."""
    if annotation["relation"] is None:
        return f"there is a {annotation['figure']}"
    rank = annotation.get("rank", int(annotation["superlative"]))
    ranked = f", number {rank} of its kind" if rank else ""
    return f"{annotation['figure']} {annotation['relation']} {annotation['landmark']}{ranked}"
