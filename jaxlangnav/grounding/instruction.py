"""From text to what the navigator needs (sections 3.1 and 3.3): once per instruction, on the host.

``understand`` parses, infers the annotations, and contracts the words for behavior inference. The
result has fixed shapes: any sentence is data for one compiled program.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax import Array

from jaxlangnav.grounding.annotation import Belief, describe_annotation, infer_annotations
from jaxlangnav.grounding.binding import BoundSentence, Detector, said_noun
from jaxlangnav.grounding.model import CorrespondenceModel
from jaxlangnav.grounding.program import BehaviorProgram, compile_clause, empty_program
from jaxlangnav.grounding.readings import to_readings
from jaxlangnav.grounding.symbols import AnnotationSpace, BehaviorSpace, count_factors
from jaxlangnav.inputs.object_types import ANYTHING
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import COMMAND, LEAST_PROBABILITY, Measure, Parse, Phrase
from jaxlangnav.language.reference import (
    Antecedent,
    head_of,
    is_constraint,
    is_thing,
    leaves,
    type_sense,
)
from jaxlangnav.messages import NONE, Readings
from jaxlangnav.pytree import pytree


@dataclasses.dataclass(frozen=True, kw_only=True)
class Spoken:
    """What a sentence speaks of; object types by their index."""

    goals: tuple[int, ...] = ()
    """What each command is about: its type; ANYTHING; NONE where that is not known."""
    known: frozenset[int] = frozenset()  # a statement says of the one spoken of before
    others: frozenset[int] = frozenset()  # another one is meant: "the other hydrant"
    avoided: tuple[tuple[int, bool], ...] = ()  # to keep away from, and whether from all of a type
    steps: tuple[tuple[float, float], ...] = ()
    """Where commands end that are told from the robot as it hears them: metres, its frame."""
    ways: tuple[tuple[int, ...], ...] = ()
    """Types that one noun may be any of; the first of them stands for the noun in ``goals``."""

    def may_be(self, kind: int) -> tuple[int, ...]:
        """List the types that the noun of a goal may be, ``kind`` first."""
        return next((way for way in self.ways if way[0] == kind), (kind,))


def _spoken_of(tree: Parse, types_of: Callable[[str], tuple[int, ...]]) -> Spoken:
    """Find what a sentence speaks of; ``types_of`` lists the types that a noun of it may be."""
    goals: list[int] = []
    known: set[int] = set()
    others: set[int] = set()
    avoided: list[tuple[int, bool]] = []
    ways: dict[tuple[int, ...], None] = {}

    def told(phrase: Phrase) -> tuple[int, ...]:
        """List the types that the thing may be which a phrase is about."""
        leaf = head_of(phrase)
        if leaf is not None and is_thing(leaf):
            return (ANYTHING,)
        types = () if leaf is None else types_of((type_sense(leaf) or "").removeprefix("type:"))
        ways.setdefault(types)
        return types

    for clause, kind in zip(tree.clauses, tree.kinds, strict=True):
        nouns = [child for child in clause.children if child.label == "NP"]
        for leaf in leaves(clause):
            if leaf.says("other"):
                others.update(told(leaf))
        if is_constraint(clause):
            avoided += [(type_, not one.children) for one in nouns for type_ in told(one)]
        elif kind == COMMAND:
            goals.append(next(iter(told(clause)), NONE))
        else:  # what it names as known, and says no more of
            for one in (noun for noun in nouns if not noun.children):
                if not {word.text for word in one.words} & {"a", "an", "another"}:
                    known.update(told(one))
    return Spoken(
        goals=tuple(goals),
        known=frozenset(known),
        others=frozenset(others),
        avoided=tuple(avoided),
        steps=tuple(one.end for one in tree.measures if one.end is not None),
        ways=tuple(way for way in ways if len(way) > 1),
    )


# ---------------------------------------------------------------- the instruction


NUM_CLAUSES = 3
_MIN_PROBABILITY = 1e-4


@dataclasses.dataclass(frozen=True)
class GroundingModel:
    """Both trained models and the object types they speak of."""

    annotation: CorrespondenceModel
    behavior: CorrespondenceModel
    type_names: tuple[str, ...]

    def zeroed(self) -> "GroundingModel":
        """Copy the model with every weight zero: it knows nothing."""
        return GroundingModel(self.annotation.zeroed(), self.behavior.zeroed(), self.type_names)


@pytree
class Instruction:
    """A grounded instruction as data; commands in order, padded to C clauses."""

    readings: Readings  # what it says of the world
    program: BehaviorProgram  # every leaf leads with C
    num_clauses: Array  # i32[] commands; statements inform and ask for nothing
    metres: Array  # f32[C] told, from the landmark to the goal place; 0: what the relation suggests
    frame: Array  # f32[C, 3] from where a command is meant: x, y, heading; metres, radians, frame
    # of the robot as it hears the sentence


@dataclasses.dataclass(frozen=True)
class Understanding:
    """What was understood, for people and for the navigator."""

    parse: Parse
    belief: Belief
    instruction: Instruction
    names: tuple[str, ...]  # types of the sentence, which ``belief`` speaks of
    type_names: tuple[str, ...]  # what the detector tells apart, which ``instruction`` speaks of
    notes: tuple[str, ...]  # what of the words is not used, a line each
    spoken: Spoken  # what the sentence speaks of

    @property
    def annotations(self) -> list[dict[str, Any]]:
        """Annotations with probabilities, likeliest first, as ``ground --json`` prints them."""
        return [
            describe_annotation(symbol, rank, probability, self.names)
            for symbol, rank, probability in self.belief.marginals()
            if probability >= _MIN_PROBABILITY
        ]

    def check_task(self, *, is_first: bool = True) -> None:
        """Refuse a sentence that asks for nothing to be done, or for another where there is none.

        Raises:
            ValueError: it only informs, or only says what to keep away from, or, where nothing has
                been said before (``is_first``), speaks of "the other one"; one line.
        """
        if is_first:
            self._check_others()
        kinds = zip(self.parse.clauses, self.parse.kinds, strict=True)
        commands = [clause for clause, kind in kinds if kind == COMMAND]
        text = f"'{self.parse.instruction}'"
        if not commands:
            raise ValueError(
                f"{text} informs but asks for nothing to be done: "
                "give a command, as in 'go to the hydrant'"
            )
        alone = [clause for clause in commands if is_constraint(clause)]
        if len(alone) == len(commands):
            raise ValueError(
                f"{text} says what to keep away from, but not where to go: say it with a command, "
                "as in 'go to the bench but avoid the cone'"
            )
        if alone:
            words = " ".join(word.text for word in alone[0].all_words())
            raise ValueError(
                f"'{words}' asks to keep away from where the command before it ends: "
                "say where to go then, as in 'then go to the bench'"
            )

    def _check_others(self) -> None:
        """Refuse "the other hydrant" where no hydrant has been spoken of before."""
        named: set[str] = set()
        for clause in self.parse.clauses:
            things = [one for one in clause.walk() if one.label == "NP" and not one.children]
            others = [one for one in things if one.says("other")]
            named |= {type_sense(one) or "" for one in things if one not in others} - {""}
            for one in others:
                kind = type_sense(one)
                if kind not in named and (kind is not None or not named):
                    noun = "thing" if kind is None else said_noun(one) or kind.partition(":")[2]
                    raise ValueError(
                        f"'{self.parse.instruction}': no {noun} has been spoken of yet, so there "
                        "is no other: say which, as in 'the hydrant by the cone'"
                    )

    @property
    def unknown_words(self) -> list[str]:
        """Words that the lexicon does not know."""
        return [word for word, _ in self.parse.unknown_words]

    def graph(self, num_objects: int) -> dict[str, dict[str, int]]:
        """Count both factor graphs, by model; that of behavior over so many objects."""
        annotation = count_factors(self.parse.clauses, AnnotationSpace(len(self.names)))
        behavior = count_factors(self.parse.clauses, BehaviorSpace(num_objects))
        return {"annotation": annotation, "behavior": {**behavior, "objects": num_objects}}


def understand(
    text: str,
    model: GroundingModel,
    detector: Detector | None = None,
    earlier: Antecedent | None = None,
    least_probability: float = LEAST_PROBABILITY,
) -> Understanding:
    """Understand an instruction: parse, annotations, and a program for behavior inference.

    Args:
        text: what the person said.
        model: trained models.
        detector: what is told apart; the types of the models by default.
        earlier: what earlier utterances have been about.
        least_probability: of what the trained reader makes of it, in [0, 1]; see ``parse``.

    Raises:
        LanguageError: the text is refused by the parser.
        UnknownObjectError: its goal is nothing that the detector has a label for.
        ValueError: the sentence says more than the arrays hold.
    """
    labels = () if detector is None else detector.plain_labels
    tree = parse(text, labels, earlier, least_probability=least_probability)
    return understand_parse(tree, model, detector)


def understand_parse(
    tree: Parse, model: GroundingModel, detector: Detector | None = None
) -> Understanding:
    """Understand a sentence that has been parsed already; see ``understand``."""
    detector = Detector(model.type_names) if detector is None else detector
    bound = BoundSentence(tree, model.type_names, detector)
    tree, names = bound.tree, tuple(bound.names)
    belief = infer_annotations(tree, model.annotation, names)
    kinds = zip(tree.clauses, tree.kinds, strict=True)
    commands = [
        i for i, (one, kind) in enumerate(kinds) if kind == COMMAND and not is_constraint(one)
    ]
    if len(commands) > NUM_CLAUSES:
        raise ValueError(
            f"the sentence has {len(commands)} commands; at most {NUM_CLAUSES} are held: "
            "say less at once"
        )
    programs = [
        compile_clause(tree.clauses[i], i, model.behavior, belief.rank, names) for i in commands
    ]
    programs = [fields | {"own": bound.rewrite(fields["own"])} for fields in programs]
    instruction = pack_instruction(
        to_readings(belief, bound.kinds_of), programs, [tree.measures[i] for i in commands]
    )

    return Understanding(
        parse=tree,
        belief=belief,
        instruction=instruction,
        names=names,
        type_names=detector.names,
        notes=tuple(bound.notes),
        spoken=_spoken_of(tree, bound.labels_of),
    )


def pack_instruction(
    readings: Readings, commands: Sequence[dict[str, np.ndarray]], measures: Sequence[Measure] = ()
) -> Instruction:
    """Put readings and the programs of commands together, padded to ``NUM_CLAUSES``.

    Args:
        readings: what is said of the world.
        commands: fields of a program for each, in order, host arrays.
        measures: how far each goes; by default as far as its words suggest.
    """
    fields = [*commands, *[empty_program()] * (NUM_CLAUSES - len(commands))]
    told = [*measures, *[Measure()] * (NUM_CLAUSES - len(measures))]
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *fields)
    numbers = {
        "num_clauses": np.int32(len(commands)),
        "metres": np.array([one.metres for one in told], np.float32),
        "frame": np.array([one.frame for one in told], np.float32),
    }
    program = BehaviorProgram(**jax.device_put(stacked))
    return Instruction(readings=readings, program=program, **jax.device_put(numbers))
