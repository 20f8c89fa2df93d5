"""A grounder for annotations that others give: a form, a person, a language model (section 3.1).

It reads no words. The annotations are evidence for the map, like those of the trained graph, and
their doubt is doubt about the map.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from jaxlangnav.grounding.annotation import describe_annotation
from jaxlangnav.grounding.form import Form, FormCommand, FormReading, read_form
from jaxlangnav.grounding.form_program import clause_of_form
from jaxlangnav.grounding.grounder import Context, Grounded
from jaxlangnav.grounding.instruction import Instruction, Spoken, pack_instruction
from jaxlangnav.grounding.readings import (
    NUM_EDGES,
    NUM_MENTIONS,
    CapacityError,
    Reading,
    Relation,
    pad_readings,
    topological_order,
)
from jaxlangnav.grounding.search import add_up
from jaxlangnav.grounding.symbols import AnnotationSymbol, object_symbol, relation_symbol
from jaxlangnav.inputs.object_types import MOST_LABELS
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.language.phrase import Measure
from jaxlangnav.messages import ACTIONS, AT, NONE, ROBOT


@dataclasses.dataclass(frozen=True)
class AnnotationGrounder:
    """Takes instructions as JSON that fits ``form.annotation_schema()``."""

    type_names: tuple[str, ...] = dataclasses.field(
        default_factory=lambda: load_lexicon().type_names
    )
    """Object types that the robot's detector tells apart, any names; the lexicon's by default."""

    def __post_init__(self) -> None:
        """Refuse types that the programs cannot tell apart."""
        number, different = len(self.type_names), len(set(self.type_names))
        if not 0 < different == number <= MOST_LABELS:
            raise ValueError(
                f"type_names has {number} names, {different} of them different; "
                f"1 to {MOST_LABELS} are held, each once"
            )

    def ground(self, text: str, context: Context) -> Grounded:
        """Read a form; see ``Grounder.ground``.

        A robot without a task takes no form that only informs.
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
            spoken=Spoken(goals=tuple(first.type_of(one.thing) for one in first.commands)),
        )


def form_instruction(form: Form) -> Instruction:
    """Turn a form into what the navigator takes: its readings, and a program for each command."""
    readings = [
        (_reading(one, f"$.readings[{i}]"), float(np.log(one.probability)))
        for i, one in enumerate(form.readings)
    ]
    commands = form.readings[0].commands
    return pack_instruction(
        pad_readings(sorted(readings, key=lambda one: -one[1])),
        [clause_of_form(form, i) for i in range(len(commands))],
        [Measure(metres=one.metres) for one in commands],
    )


def returning() -> Instruction:
    """Build the instruction to come to where the one who gives it stands."""
    action = ACTIONS.index("navigate")
    command = FormCommand(action=action, mode=0, region=AT, thing=ROBOT, avoid=())
    return form_instruction(Form((FormReading(1.0, (), (), (command,)),), notes=()))


def _reading(form: FormReading, path: str) -> Reading:
    """Turn one reading into mentions and relations, landmarks before the figures beside them."""
    said = topological_order(form.relations)
    touched = [end for one in said for end in (one.landmark, one.figure)]
    alone = [thing for thing in range(len(form.types)) if thing not in touched]
    things = list(dict.fromkeys((*touched, *range(len(form.types)))))
    place = {thing: mention for mention, thing in enumerate(things)}
    relations = [
        one._replace(figure=place[one.figure], landmark=place[one.landmark])
        for one in dict.fromkeys(said)
    ]
    relations += [Relation(place[thing], NONE, NONE, 0) for thing in alone]
    if len(things) > NUM_MENTIONS:
        raise CapacityError(
            f"{path} speaks of {len(things)} things, with the robot; at most {NUM_MENTIONS} are "
            "held: say less at once"
        )
    if len(relations) > NUM_EDGES:
        raise CapacityError(
            f"{path} has {len(said)} relations and {len(alone)} things in none; at most "
            f"{NUM_EDGES} of both are held: say less at once"
        )
    return Reading(tuple(form.type_of(thing) for thing in things), tuple(relations))


def _annotations(form: Form, type_names: tuple[str, ...]) -> Iterator[Mapping[str, Any]]:
    """List what is said with its probability over the readings, likeliest first."""

    def said(reading: FormReading) -> Iterator[tuple[AnnotationSymbol, int]]:
        of = reading.type_of
        for one in reading.relations:
            yield relation_symbol(of(one.figure), one.relation, of(one.landmark)), one.rank
        touched = {end for one in reading.relations for end in (one.figure, one.landmark)}
        for thing, kind in enumerate(reading.types):
            if thing not in touched:
                yield object_symbol(kind), 0

    total = add_up(
        (entry, one.probability) for one in form.readings for entry in dict.fromkeys(said(one))
    )
    for (symbol, rank), probability in total:
        yield describe_annotation(symbol, rank, min(probability, 1.0), type_names)
