"""Grounders: from what a person says to what the navigator needs (sections 3.1 and 3.3).

The door through which any source of annotations comes in: the trained graph here, a form in
``annotated``, one of your own. Nothing behind the door asks which one it is.
"""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any, Protocol, Self

from jaxlangnav.grounding.binding import Detector
from jaxlangnav.grounding.instruction import GroundingModel, Instruction, Spoken, understand
from jaxlangnav.kinds import noun_of
from jaxlangnav.language.reference import Antecedent
from jaxlangnav.messages import NONE


@dataclasses.dataclass(frozen=True, kw_only=True)
class Context:
    """What a grounder is told besides the text."""

    is_under_way: bool  # the robot has had an instruction before, and may be following it
    about: int = NONE  # object type that earlier utterances have been about, for "it" and "one"
    is_at: bool = False  # the robot is at one of those, or on its way to it


@dataclasses.dataclass(frozen=True, kw_only=True)
class Grounded:
    """What was understood: for the engine, and for people."""

    instruction: Instruction
    annotations: tuple[Mapping[str, Any], ...]
    """What is said of the world, likeliest first: figure, relation, landmark, superlative and
    probability, as ``jaxlangnav ground --json`` prints them."""
    notes: tuple[str, ...] = ()
    """What else people should know, a line each."""
    spoken: Spoken | None = None
    """What it speaks of, for what was said before and comes after; None: as its readings show."""
    alternatives: "tuple[Alternative, ...]" = ()
    """Whole ways to understand it, likeliest first, where the grounder tells them apart."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Alternative:
    """One way to understand what was said."""

    says: str  # for people, one line
    probability: float
    grounded: Grounded


class Grounder(Protocol):
    """What understands instructions."""

    @property
    def type_names(self) -> tuple[str, ...]:
        """Object types that it speaks of; a detection names its type by the index into them."""
        ...

    def ground(self, text: str, context: Context) -> Grounded:
        """Understand an instruction.

        Args:
            text: what was said, in whatever form the grounder takes.
            context: what else it may want to know.

        Returns:
            What was understood; an instruction without a command informs only, or says what to
            keep away from.

        Raises:
            ValueError: the text is refused; one line that says why and what to do about it.
        """
        ...


def names_of(grounder: Grounder) -> tuple[str, ...]:
    """List the types of a grounder, and after them nouns that it has met and had no type for."""
    return getattr(grounder, "names", grounder.type_names)


class GraphGrounder:
    """The trained Distributed Correspondence Graph: sentences of the controlled language."""

    def __init__(
        self,
        model: GroundingModel,
        labels: Iterable[str] | None = None,
        attributes: Iterable[str] = (),
    ) -> None:
        """Bind the graph to a detector.

        Args:
            model: trained models.
            labels: what the detector tells apart, in the order of its indices; the types of the
                models by default.
            attributes: groups of ``kinds.ATTRIBUTES`` that it reports.

        Raises:
            ValueError: labels or groups are refused; one line.
        """
        self.model = model
        self.detector = Detector(model.type_names if labels is None else labels, attributes)

    @classmethod
    def of_detector(cls, model: GroundingModel, detector: Detector) -> Self:
        """Bind the graph to a detector to which nouns of earlier sentences are what they were."""
        bound = cls(model, detector.labels, detector.attribute_groups)
        bound.detector = detector
        return bound

    @property
    def type_names(self) -> tuple[str, ...]:
        """The detector's labels."""
        return self.detector.labels

    @property
    def names(self) -> tuple[str, ...]:
        """The labels, and after them nouns of sentences that there was no label for."""
        return self.detector.names

    def ground(self, text: str, context: Context) -> Grounded:
        """Understand a sentence; see ``Grounder.ground``."""
        earlier = None
        if context.about != NONE:
            kind = noun_of(context.about, self.names)
            earlier = Antecedent(kind=kind, is_at=context.is_at)
        understood = understand(text, self.model, self.detector, earlier)
        # A robot under way may also be told of the map, and what to keep away from.
        if not context.is_under_way or int(understood.instruction.num_clauses):
            understood.check_task(is_first=not context.is_under_way)
        bound = understood.type_names
        unknown = [f"'{word}'" for word in understood.unknown_words if word not in bound]
        return Grounded(
            instruction=understood.instruction,
            annotations=tuple(understood.annotations),
            notes=(
                *(f"not in the lexicon: {word}" for word in unknown),
                *(
                    f"left out, as it says nothing of the task: '{said}'"
                    for said in understood.parse.unread
                ),
                *understood.notes,
            ),
            spoken=understood.spoken,
        )
