"""Grounders: from what a person says to what the navigator needs (sections 3.1 and 3.3).

Any source of annotations comes in here: the trained graph, a form (``annotated``), one of your own,
or one made of others: one after the other, or one whose readings a person picks from.
"""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Protocol, Self

import numpy as np

from jaxlangnav.grounding.annotation import annotation_document
from jaxlangnav.grounding.binding import Detector
from jaxlangnav.grounding.instruction import GroundingModel, Instruction, Spoken, understand
from jaxlangnav.grounding.readings import pad_readings, unpad_readings
from jaxlangnav.inputs.object_types import name_of, noun_of
from jaxlangnav.language.phrase import LEAST_PROBABILITY
from jaxlangnav.language.reference import Antecedent
from jaxlangnav.messages import NONE, ROBOT
from jaxlangnav.pytree import replace


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


class OtherTypes:
    """What speaks of the types of another grounder."""

    def __init__(self, grounder: Grounder) -> None:
        """Take the grounder that tells the types."""
        self._types_of = grounder

    @property
    def type_names(self) -> tuple[str, ...]:
        """The types of the other grounder."""
        return self._types_of.type_names

    @property
    def names(self) -> tuple[str, ...]:
        """The types, and nouns that there was none for."""
        return names_of(self._types_of)


class GraphGrounder:
    """The trained Distributed Correspondence Graph: sentences of the controlled language."""

    def __init__(
        self,
        model: GroundingModel,
        labels: Iterable[str] | None = None,
        attributes: Iterable[str] = (),
        *,
        least_probability: float = LEAST_PROBABILITY,
    ) -> None:
        """Bind the graph to a detector.

        Args:
            model: trained models.
            labels: what the detector tells apart, in the order of its indices; the types of the
                models by default.
            attributes: groups of ``ATTRIBUTES`` that it reports.
            least_probability: of what the trained reader makes of free speech, in [0, 1]: at less
                it is refused.

        Raises:
            ValueError: labels or groups are refused; one line.
        """
        self.model = model
        self.least_probability = least_probability
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
        least = self.least_probability
        understood = understand(text, self.model, self.detector, earlier, least)
        # A robot under way may also be told of the map, and what to keep away from.
        if not context.is_under_way or int(understood.instruction.num_clauses):
            understood.check_task(is_first=not context.is_under_way)
        bound = understood.type_names
        unknown = [word for word in understood.unknown_words if word not in bound]
        unread = understood.parse.unread
        return Grounded(
            instruction=understood.instruction,
            annotations=tuple(understood.annotations),
            notes=(
                *(f"not in the lexicon: '{word}'" for word in unknown),
                *(f"left out, as it says nothing of the task: '{said}'" for said in unread),
                *understood.notes,
            ),
            spoken=understood.spoken,
        )


# ---------------------------------------------------------------- grounders made of grounders

Chooser = Callable[[str, Sequence[Alternative]], int | None]
"""Told what was said and the ways to understand it, likeliest first; answers with the index of one,
or None where it is none of them."""
LEAST_ASKED = 0.05
"""Ways less probable than this are not asked about."""


class FirstGrounder(OtherTypes):
    """Asks one grounder, and another where the first refuses."""

    def __init__(self, first: Grounder, then: Grounder) -> None:
        """Join two grounders of one detector: where ``first`` refuses, ``then`` is asked."""
        if first.type_names != then.type_names:
            raise ValueError("the grounders have different type_names: give both one detector's")
        super().__init__(first)
        self.first = first
        self.then = then

    def ground(self, text: str, context: Context) -> Grounded:
        """Understand an instruction; where both refuse, the first's reason is given."""
        try:
            return self.first.ground(text, context)
        except ValueError as error:
            refusal = error
        try:
            found = self.then.ground(text, context)
        except ValueError as error:
            raise refusal from error
        return dataclasses.replace(found, notes=(f"not read as it stands: {refusal}", *found.notes))


class ChoosingGrounder(OtherTypes):
    """Lets a person pick among the ways to understand an instruction."""

    def __init__(self, grounder: Grounder, choose: Chooser, *, least: float = LEAST_ASKED) -> None:
        """Wrap a grounder.

        Args:
            grounder: tells the ways.
            choose: asks the person; not called where there is one way only.
            least: ways less probable than this are not asked about.
        """
        super().__init__(grounder)
        self.grounder = grounder
        self.choose = choose
        self.least = least

    def ground(self, text: str, context: Context) -> Grounded:
        """Understand an instruction, and ask which way; see ``Grounder.ground``."""
        found = self.grounder.ground(text, context)
        ways = found.alternatives or tuple(_by_reading(found, self.names))
        ways = [one for one in ways if one.probability >= self.least]
        if len(ways) < 2:
            return found
        answer = self.choose(text, ways)
        if answer is None:
            raise ValueError(
                f"none of the {len(ways)} ways to understand it is meant: say it in other words"
            )
        if not 0 <= answer < len(ways):
            raise ValueError(f"the answer is {answer}, but there are ways 0 to {len(ways) - 1}")
        chosen = ways[answer]
        note = f"chosen: '{chosen.says}'"
        return dataclasses.replace(chosen.grounded, notes=(note, *chosen.grounded.notes))


def _by_reading(grounded: Grounded, names: Sequence[str]) -> Iterator[Alternative]:
    """Take each reading for a way; the commands are those of the sentence."""
    ranked = sorted(unpad_readings(grounded.instruction.readings), key=lambda item: -item[1])
    for reading, score in ranked:
        kinds = ["robot" if one == ROBOT else name_of(one, names) for one in reading.mentions]
        named = [*kinds, None]  # what stands at NONE, the last place
        told = tuple(
            annotation_document(named[figure], named[landmark], relation, rank, 1.0)
            for figure, relation, landmark, rank in reading.relations
        )
        alone = replace(grounded.instruction, readings=pad_readings([(reading, 0.0)]))
        yield Alternative(
            says="; ".join(_worded(one) for one in told),
            probability=float(np.exp(score)),
            grounded=dataclasses.replace(grounded, instruction=alone, annotations=told),
        )


def _worded(said: Mapping[str, Any]) -> str:
    """Write an annotation for people: "cone near car, rank 1"."""
    if said["relation"] is None:
        return f"there is a {said['figure']}"
    rank = said.get("rank", int(said["superlative"]))
    ranked = f", number {rank} of its kind" if rank else ""
    return f"{said['figure']} {said['relation']} {said['landmark']}{ranked}"
