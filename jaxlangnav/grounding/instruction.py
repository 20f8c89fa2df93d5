"""Ground a sentence into arrays for the navigator (sections 3.1, 3.3), once, on the host.

``understand`` parses, infers the annotations, and contracts the words for behavior inference. The
result has fixed shapes: any sentence is data for one compiled program.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax import Array

from jaxlangnav.grounding.annotation import AnnotationBelief, describe_annotation, infer_annotations
from jaxlangnav.grounding.binding import BoundSentence, Detector, noun_text
from jaxlangnav.grounding.model import CorrespondenceModel
from jaxlangnav.grounding.program import CompiledClause, compile_clause, empty_clause
from jaxlangnav.grounding.readings import Capacity, to_readings
from jaxlangnav.grounding.symbols import AnnotationSpace, BehaviorSpace, count_factors
from jaxlangnav.inputs.object_types import ANYTHING
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import COMMAND, MIN_PROBABILITY, Measure, Parse, Phrase
from jaxlangnav.language.reference import (
    Antecedent,
    head_of,
    is_constraint,
    is_untyped,
    leaves,
    type_sense,
)
from jaxlangnav.messages import NONE, Readings
from jaxlangnav.pytree import pytree, replace


@dataclasses.dataclass(frozen=True, kw_only=True)
class Referents:
    """Object types that a sentence refers to, by index, as the dialogue state needs them."""

    goals: tuple[int, ...] = ()
    """Object type of each command's goal; ANYTHING; NONE if unknown."""
    known: frozenset[int] = frozenset()  # types that a statement takes as known
    others: frozenset[int] = frozenset()  # types with "other": "the other hydrant"
    avoided: tuple[tuple[int, bool], ...] = ()  # types to avoid, and whether all of a type
    steps: tuple[tuple[float, float], ...] = ()
    """End positions of metric commands ("go 2 m left"): metres, robot frame when it hears them."""
    candidates: tuple[tuple[int, ...], ...] = ()
    """Candidate types of each ambiguous noun; the first stands for the noun in ``goals``."""

    def types_of(self, label: int) -> tuple[int, ...]:
        """List the candidate types of a goal's noun, ``label`` first."""
        return next((types for types in self.candidates if types[0] == label), (label,))


def _collect_references(tree: Parse, types_of: Callable[[str], tuple[int, ...]]) -> Referents:
    """Collect the types a sentence refers to; ``types_of`` lists the candidate types of a noun."""
    goals: list[int] = []
    known: set[int] = set()
    others: set[int] = set()
    avoided: list[tuple[int, bool]] = []
    candidates: dict[tuple[int, ...], None] = {}

    def types_at(phrase: Phrase) -> tuple[int, ...]:
        """List the candidate types of a phrase's head noun."""
        leaf = head_of(phrase)
        if leaf is not None and is_untyped(leaf):
            return (ANYTHING,)
        types = () if leaf is None else types_of((type_sense(leaf) or "").removeprefix("type:"))
        candidates.setdefault(types)
        return types

    for clause, clause_kind in zip(tree.clauses, tree.kinds, strict=True):
        nouns = [child for child in clause.children if child.label == "NP"]
        for leaf in leaves(clause):
            if leaf.has_sense("other"):
                others.update(types_at(leaf))
        if is_constraint(clause):
            avoided += [(type_, not noun.children) for noun in nouns for type_ in types_at(noun)]
        elif clause_kind == COMMAND:
            goals.append(next(iter(types_at(clause)), NONE))
        else:  # definite nouns without a modifier are taken as known
            for noun in (noun for noun in nouns if not noun.children):
                if not {word.text for word in noun.words} & {"a", "an", "another"}:
                    known.update(types_at(noun))
    return Referents(
        goals=tuple(goals),
        known=frozenset(known),
        others=frozenset(others),
        avoided=tuple(avoided),
        steps=tuple(m.end for m in tree.measures if m.end is not None),
        candidates=tuple(types for types in candidates if len(types) > 1),
    )


# ---------------------------------------------------------------- the instruction

NUM_CLAUSES = 3
_MIN_PROBABILITY = 1e-4


@dataclasses.dataclass(frozen=True)
class GroundingModel:
    """The two trained correspondence models and the object types that they know."""

    annotation: CorrespondenceModel
    behavior: CorrespondenceModel
    type_names: tuple[str, ...]


@pytree
class Instruction:
    """A grounded instruction as data; commands in order, padded to C clauses."""

    readings: Readings  # annotations of the world
    clauses: CompiledClause  # every leaf leads with C
    num_clauses: Array  # i32[] commands; statements are not counted
    metres: Array  # f32[C] from landmark to goal, as commanded; 0: the relation's typical distance
    frame: Array  # f32[C, 3] reference pose of a command: x, y, heading; metres, radians, frame of
    # the robot as it hears the sentence


def pad_instruction(instruction: Instruction, capacity: Capacity) -> Instruction:
    """Pad the readings of one sentence to the sizes of a whole dialogue (host)."""
    padded = {}
    for name in ("mention_type", "figure", "relation", "landmark", "rank"):
        leaf = np.asarray(getattr(instruction.readings, name))
        size = capacity.num_mentions if name == "mention_type" else capacity.num_relations
        widths = ((0, 0), (0, size - leaf.shape[1]))
        padded[name] = np.pad(leaf, widths, constant_values=0 if name == "rank" else NONE)
    readings = replace(instruction.readings, **jax.device_put(padded))
    return replace(instruction, readings=readings)


@dataclasses.dataclass(frozen=True)
class Understanding:
    """Result of grounding a sentence: its parse, annotations, instruction and notes."""

    parse: Parse
    belief: AnnotationBelief
    instruction: Instruction
    names: tuple[str, ...]  # object types of the sentence, indexed by ``belief``
    type_names: tuple[str, ...]  # of the detector, indexed by ``instruction``
    notes: tuple[str, ...]  # words that are not used, a line each
    spoken: Referents  # object types that the sentence refers to

    @property
    def annotations(self) -> list[dict[str, Any]]:
        """Annotations with probabilities, likeliest first, as ``ground --json`` prints them."""
        return [
            describe_annotation(symbol, rank, probability, self.names)
            for symbol, rank, probability in self.belief.marginals()
            if probability >= _MIN_PROBABILITY
        ]

    def check_task(self, *, is_first: bool = True) -> None:
        """Refuse a sentence without a command to go somewhere, or with an unresolved "other".

        Raises:
            ValueError: it only informs, or only says what to keep away from, or, where nothing has
                been said before (``is_first``), speaks of "the other one"; one line.
        """
        if is_first:
            self.check_others()
        clauses = zip(self.parse.clauses, self.parse.kinds, strict=True)
        commands = [clause for clause, kind in clauses if kind == COMMAND]
        text = f"'{self.parse.instruction}'"
        if not commands:
            raise ValueError(
                f"{text} informs but asks for nothing to be done: "
                "give a command, as in 'go to the hydrant'"
            )
        constraints = [clause for clause in commands if is_constraint(clause)]
        if len(constraints) == len(commands):
            raise ValueError(
                f"{text} says what to keep away from, but not where to go: say it with a command, "
                "as in 'go to the bench but avoid the cone'"
            )
        if constraints:
            words = " ".join(word.text for word in constraints[0].all_words())
            raise ValueError(
                f"'{words}' asks to keep away from where the command before it ends: "
                "say where to go then, as in 'then go to the bench'"
            )

    def check_others(self) -> None:
        """Refuse "the other hydrant" where no hydrant has been mentioned before."""
        mentioned: set[str] = set()
        for clause in self.parse.clauses:
            nouns = [noun for noun in clause.walk() if noun.label == "NP" and not noun.children]
            others = [noun for noun in nouns if noun.has_sense("other")]
            mentioned |= {type_sense(noun) or "" for noun in nouns if noun not in others} - {""}
            for noun in others:
                kind = type_sense(noun)
                if kind not in mentioned and (kind is not None or not mentioned):
                    name = "thing" if kind is None else noun_text(noun) or kind.partition(":")[2]
                    raise ValueError(
                        f"'{self.parse.instruction}': no {name} has been spoken of yet, so there "
                        "is no other: say which, as in 'the hydrant by the cone'"
                    )

    @property
    def unknown_words(self) -> list[str]:
        """Words that the lexicon does not know."""
        return [word for word, _ in self.parse.unknown_words]

    def graph(self, num_objects: int) -> dict[str, dict[str, int]]:
        """Count the factor graphs of both models; that of behavior over ``num_objects`` objects."""
        annotation = count_factors(self.parse.clauses, AnnotationSpace(len(self.names)))
        behavior = count_factors(self.parse.clauses, BehaviorSpace(num_objects))
        return {"annotation": annotation, "behavior": {**behavior, "objects": num_objects}}


def understand(
    text: str,
    model: GroundingModel,
    detector: Detector | None = None,
    earlier: Antecedent | None = None,
    least_probability: float = MIN_PROBABILITY,
) -> Understanding:
    """Parse a sentence, infer its annotations, and compile its clauses for behavior inference.

    Args:
        text: what the person said.
        model: trained models.
        detector: its labels and attributes; the types of the models by default.
        earlier: antecedent from earlier utterances.
        least_probability: of the trained reader's rewriting, in [0, 1]; see ``parse``.

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
    """Ground a parsed sentence; see ``understand``."""
    detector = Detector(model.type_names) if detector is None else detector
    bound = BoundSentence(tree, model.type_names, detector)
    tree, names = bound.tree, tuple(bound.names)
    belief = infer_annotations(tree, model.annotation, names)
    kinds = zip(tree.clauses, tree.kinds, strict=True)
    commands = [i for i, (c, kind) in enumerate(kinds) if kind == COMMAND and not is_constraint(c)]
    if len(commands) > NUM_CLAUSES:
        raise ValueError(
            f"the sentence has {len(commands)} commands; at most {NUM_CLAUSES} are held: "
            "say less at once"
        )
    clauses = [
        compile_clause(tree.clauses[i], i, model.behavior, belief.rank, names) for i in commands
    ]
    clauses = [c | {"named_types": bound.type_codes(c["named_types"])} for c in clauses]
    instruction = pack_instruction(
        to_readings(belief, bound.codes_of), clauses, [tree.measures[i] for i in commands]
    )

    return Understanding(
        parse=tree,
        belief=belief,
        instruction=instruction,
        names=names,
        type_names=detector.names,
        notes=tuple(bound.notes),
        spoken=_collect_references(tree, bound.labels_of),
    )


def pack_instruction(
    readings: Readings, commands: Sequence[dict[str, np.ndarray]], measures: Sequence[Measure] = ()
) -> Instruction:
    """Pack readings and compiled commands into an instruction, padded to ``NUM_CLAUSES``.

    Args:
        readings: distribution over annotations of the world.
        commands: fields of each command's compiled clause, in order, host arrays.
        measures: distance of each command; by default the relation's typical one.
    """
    fields = [*commands, *[empty_clause()] * (NUM_CLAUSES - len(commands))]
    padded = [*measures, *[Measure()] * (NUM_CLAUSES - len(measures))]
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *fields)
    arrays = {
        "num_clauses": np.int32(len(commands)),
        "metres": np.array([measure.metres for measure in padded], np.float32),
        "frame": np.array([measure.frame for measure in padded], np.float32),
    }
    clauses = CompiledClause(**jax.device_put(stacked))
    return Instruction(readings=readings, clauses=clauses, **jax.device_put(arrays))
