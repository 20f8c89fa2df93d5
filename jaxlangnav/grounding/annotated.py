"""Grounder of annotations from an external source: a person or language model (section 3.1).

It parses JSON, not language. The annotations are evidence for the map, like those of the trained
graph, and their probabilities become probabilities of readings.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxlangnav.grounding.annotation import describe_annotation
from jaxlangnav.grounding.form import Form, FormCommand, FormReading, read_form
from jaxlangnav.grounding.form_program import clause_of_form
from jaxlangnav.grounding.grounder import Context, Grounded
from jaxlangnav.grounding.instruction import Instruction, Referents, pack_instruction
from jaxlangnav.grounding.readings import (
    NUM_EDGES,
    NUM_MENTIONS,
    CapacityError,
    Reading,
    Relation,
    pad_readings,
    topological_order,
)
from jaxlangnav.grounding.search import sum_by_key
from jaxlangnav.grounding.symbols import AnnotationSymbol, object_symbol, relation_symbol
from jaxlangnav.inputs.object_types import MAX_LABELS
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.language.phrase import Measure
from jaxlangnav.messages import ACTIONS, AT, NONE, ROBOT


@dataclass(frozen=True)
class AnnotationGrounder:
    """Grounder of instructions in JSON that matches ``form.annotation_schema()``."""

    type_names: tuple[str, ...] = field(default_factory=lambda: load_lexicon().type_names)
    """Object types of the robot's detector, any names; the lexicon's by default."""

    def __post_init__(self) -> None:
        """Refuse duplicate type names, none, or too many."""
        count, distinct = len(self.type_names), len(set(self.type_names))
        if not 0 < distinct == count <= MAX_LABELS:
            raise ValueError(
                f"type_names has {count} names, {distinct} of them different; "
                f"1 to {MAX_LABELS} are held, each once"
            )

    def ground(self, text: str, context: Context) -> Grounded:
        """Read a form; see ``Grounder.ground``.

        A robot without a task refuses a form without commands.
        """
        form = read_form(text, self.type_names)
        first = form.readings[0]
        if not context.is_under_way and not first.commands:
            raise ValueError(
                "$.readings[0].commands is missing: the annotations inform, but ask for nothing "
                "to be done"
            )
        return Grounded(
            instruction=form_instruction(form),
            annotations=tuple(_annotations(form, self.type_names)),
            notes=form.notes,
            spoken=Referents(goals=tuple(first.type_of(c.thing) for c in first.commands)),
        )


def form_instruction(form: Form) -> Instruction:
    """Convert a form to an instruction: its readings, and a compiled clause for each command."""
    readings = [
        (reading_of_form(reading, f"$.readings[{i}]"), float(np.log(reading.probability)))
        for i, reading in enumerate(form.readings)
    ]
    commands = form.readings[0].commands
    return pack_instruction(
        pad_readings(sorted(readings, key=lambda item: -item[1])),
        [clause_of_form(form, i) for i in range(len(commands))],
        [Measure(metres=command.metres) for command in commands],
    )


def come_here() -> Instruction:
    """Build the instruction to come to the person who gives it ("come here")."""
    action = ACTIONS.index("navigate")
    command = FormCommand(action=action, mode=0, region=AT, thing=ROBOT, avoid=())
    return form_instruction(Form((FormReading(1.0, (), (), (command,)),), notes=()))


def reading_of_form(form: FormReading, path: str) -> Reading:
    """Convert one reading to mentions and relations, landmarks before their figures.

    Raises:
        CapacityError: the arrays do not hold it; one line that begins with its JSON ``path``.
    """
    edges = topological_order(form.relations)
    related = [end for edge in edges for end in (edge.landmark, edge.figure)]
    unrelated = [thing for thing in range(len(form.types)) if thing not in related]
    things = list(dict.fromkeys((*related, *range(len(form.types)))))
    mention = {thing: index for index, thing in enumerate(things)}
    relations = [
        edge._replace(figure=mention[edge.figure], landmark=mention[edge.landmark])
        for edge in dict.fromkeys(edges)
    ]
    relations += [Relation(mention[thing], NONE, NONE, 0) for thing in unrelated]
    if len(things) > NUM_MENTIONS:
        raise CapacityError(
            f"{path} speaks of {len(things)} things, with the robot; at most {NUM_MENTIONS} are "
            "held: say less at once"
        )
    if len(relations) > NUM_EDGES:
        raise CapacityError(
            f"{path} has {len(edges)} relations and {len(unrelated)} things in none; at most "
            f"{NUM_EDGES} of both are held: say less at once"
        )
    return Reading(tuple(form.type_of(thing) for thing in things), tuple(relations))


def _annotations(form: Form, type_names: tuple[str, ...]) -> Iterator[Mapping[str, Any]]:
    """List the annotations with their marginal probabilities over the readings, likeliest first."""

    def symbols(reading: FormReading) -> Iterator[tuple[AnnotationSymbol, int]]:
        type_of = reading.type_of
        for r in reading.relations:
            yield relation_symbol(type_of(r.figure), r.relation, type_of(r.landmark)), r.rank
        related = {end for r in reading.relations for end in (r.figure, r.landmark)}
        for thing, object_type in enumerate(reading.types):
            if thing not in related:
                yield object_symbol(object_type), 0

    total = sum_by_key(
        (entry, r.probability) for r in form.readings for entry in dict.fromkeys(symbols(r))
    )
    for (symbol, rank), probability in total:
        yield describe_annotation(symbol, rank, min(probability, 1.0), type_names)
