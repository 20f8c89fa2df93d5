"""Annotation form: a JSON document of an instruction's annotations and commands (section 3.1).

A person, a program or a language model fills it in. Its schema is ``annotation_schema()``, and
errors name the first invalid field.
"""

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from jaxlangnav.grounding.readings import Relation
from jaxlangnav.inputs.documents import error_prefix, parse_json, read_shipped
from jaxlangnav.inputs.sanitize import quote
from jaxlangnav.messages import ACTIONS, AT, BETWEEN, MODES, REGIONS, ROBOT
from jaxlangnav.relations.table import ORDERS, REGISTRY

MAX_FORM_CHARACTERS = 65_536
"""Length limit; the largest form that the arrays hold has a tenth of it."""
ROBOT_ID = "robot"
_TOLERANCE = 0.01
"""Allowed deviation of the sum of probabilities from 1, as people and models round them."""


def validate(value: Any, schema: Mapping[str, Any] | None = None, *, path: str = "$") -> None:
    """Validate a parsed JSON value against ``annotation_schema()``.

    Or against ``schema`` with its definitions; ``path`` is the JSON path of the value.

    Raises:
        ValueError: the first field that does not fit, in one line with its JSON path.
    """
    from jsonschema import Draft202012Validator

    full_schema = {**annotation_schema(), **(schema or {})}
    error: Any = next(iter(Draft202012Validator(full_schema).iter_errors(value)), None)
    if error is None:
        return
    where, instance, limit = f"{path}{error.json_path[1:]}", error.instance, error.validator_value
    match error.validator:
        case "required":
            missing = next(name for name in limit if name not in instance)
            raise ValueError(f"{where}.{missing} is missing: add it")
        case "additionalProperties":
            known = error.schema["properties"]
            name = quote(next(name for name in instance if name not in known))
            raise ValueError(
                f"{where} has a field {name}, but may only have {', '.join(known)}: leave it out"
            )
        case "maxItems":
            raise ValueError(f"{where} has {len(instance)} entries, but at most {limit} are held")
        case "enum":
            expected = f"one of {', '.join(limit)}"
        case "type":
            expected = f"of type {limit}: {error.schema['description']}"
        case _:
            expected = error.schema["description"]
    raise ValueError(f"{where} is {quote(instance)}, but must be {expected}")


@dataclasses.dataclass(frozen=True)
class FormCommand:
    """A command: action, mode, goal region, and objects to avoid."""

    action: int  # index into ACTIONS
    mode: int  # index into MODES
    region: int  # index into REGIONS
    thing: int  # landmark of the region
    avoid: tuple[int, ...]
    metres: float = 0.0  # from landmark to goal; 0: the relation's typical distance


@dataclasses.dataclass(frozen=True)
class FormReading:
    """One interpretation of an instruction, with its probability."""

    probability: float
    types: tuple[int, ...]  # object type of each object
    relations: tuple[Relation, ...]  # between object indices, or ``ROBOT``
    commands: tuple[FormCommand, ...]

    def type_of(self, thing: int) -> int:
        """Look up the object type of an object index; that of ``ROBOT`` is ``ROBOT``."""
        return thing if thing == ROBOT else self.types[thing]


@dataclasses.dataclass(frozen=True)
class Form:
    """A validated form: readings whose probabilities sum to one, and notes."""

    readings: tuple[FormReading, ...]
    notes: tuple[str, ...]


@cache
def annotation_schema() -> Mapping[str, Any]:
    """Read the published JSON Schema of the form."""
    return json.loads(read_shipped("grounding", "annotations.schema.json"))


def read_form(text: str, type_names: Sequence[str]) -> Form:
    """Read JSON that fits ``annotation_schema()``; ``type_names`` are the types a thing may have.

    Raises:
        ValueError: it is no JSON, or a field cannot be; one line with the field's JSON path.
    """
    if len(text) > MAX_FORM_CHARACTERS:
        raise ValueError(
            f"the annotations have {len(text):,} characters; at most {MAX_FORM_CHARACTERS:,} are "
            "read"
        )
    with error_prefix("annotations"):
        document = parse_json(text)
    validate(document)
    readings = [
        _to_reading(r, type_names, f"$.readings[{i}]") for i, r in enumerate(document["readings"])
    ]
    total = math.fsum(reading.probability for reading in readings)
    if abs(total - 1.0) > _TOLERANCE:
        raise ValueError(
            f"$.readings: the probabilities sum to {total:.3g}, but must sum to 1: divide each by "
            "their sum, or add the reading that is missing"
        )
    first_commands = readings[0].commands
    for i, reading in enumerate(readings):
        if len(reading.commands) != len(first_commands):
            raise ValueError(
                f"$.readings[{i}].commands has {len(reading.commands)} entries, but the first "
                f"reading has {len(first_commands)}: every reading needs as many"
            )
        for j, (command, first) in enumerate(zip(reading.commands, first_commands, strict=True)):
            if command.metres != first.metres:
                raise ValueError(
                    f"$.readings[{i}].commands[{j}].goal.metres is {command.metres:g}, but "
                    f"{first.metres:g} in the first reading: it must be the same in all"
                )
    scaled = [dataclasses.replace(r, probability=r.probability / total) for r in readings]
    return Form(tuple(scaled), tuple(document.get("notes", ())))


def _to_reading(document: Mapping[str, Any], type_names: Sequence[str], path: str) -> FormReading:
    """Read a reading that matches the schema: ids become indices."""
    index: dict[str, int] = {ROBOT_ID: ROBOT}
    for i, thing in enumerate(document["things"]):
        where = f"{path}.things[{i}]"
        if thing["id"] in index:
            raise ValueError(f"{where}.id is {quote(thing['id'])}, which an earlier thing has")
        if thing["type"] not in type_names:
            raise ValueError(
                f"{where}.type is {quote(thing['type'])}, but must be one of "
                f"{', '.join(type_names)}: those are what the detector tells apart"
            )
        index[thing["id"]] = i
    relations = tuple(
        _read_relation(item, index, f"{path}.relations[{i}]")
        for i, item in enumerate(document.get("relations", ()))
    )
    ids = {thing: quote(name) for name, thing in index.items()}
    between = [item for item in relations if item.relation == BETWEEN]
    for figure in dict.fromkeys(item.figure for item in between):
        landmarks = sorted({item.landmark for item in between if item.figure == figure})
        if len(landmarks) != 2:
            raise ValueError(
                f"{path}.relations has {ids[figure]} between "
                f"{', '.join(ids[item] for item in landmarks)}, but a thing lies "
                "between two: one entry for each of its two landmarks"
            )
    commands = tuple(
        _read_command(item, index, f"{path}.commands[{i}]")
        for i, item in enumerate(document.get("commands", ()))
    )
    types = tuple(type_names.index(thing["type"]) for thing in document["things"])
    return FormReading(float(document["probability"]), types, relations, commands)


def _look_up(name: str, index: Mapping[str, int], path: str, *, may_be_robot: bool = True) -> int:
    if name not in index:
        raise ValueError(
            f"{path} is {quote(name)}, but this reading has no such thing: use one of "
            f"{', '.join(index)}, or add it to things"
        )
    if index[name] == ROBOT and not may_be_robot:
        raise ValueError(f"{path} is 'robot', but must be a thing of this reading")
    return index[name]


def _read_relation(document: Mapping[str, Any], index: Mapping[str, int], path: str) -> Relation:
    figure = _look_up(document["figure"], index, f"{path}.figure", may_be_robot=False)
    landmark = _look_up(document["landmark"], index, f"{path}.landmark")
    if figure == landmark:
        raise ValueError(
            f"{path}.landmark is {quote(document['landmark'])}, as the figure is: "
            "nothing is its own landmark"
        )
    rank = int(document.get("rank", 0))
    relation = [item.name for item in REGISTRY].index(document["relation"])
    if rank and relation not in ORDERS:
        raise ValueError(
            f"{path}.rank is {rank}, but nothing is ordered by {document['relation']}: use near, "
            "far, left or right"
        )
    if relation == BETWEEN and landmark == ROBOT:
        raise ValueError(
            f"{path}.landmark is 'robot', but what lies between the robot and a thing cannot "
            "be told: say that it is near, or in front"
        )
    return Relation(figure, relation, landmark, rank)


def _read_command(document: Mapping[str, Any], index: Mapping[str, int], path: str) -> FormCommand:
    goal = document["goal"]
    region = REGIONS.index(goal.get("region", REGIONS[AT]))
    thing, metres = _look_up(goal["thing"], index, f"{path}.goal.thing"), goal.get("metres", 0.0)
    if metres and region == AT:
        raise ValueError(
            f"{path}.goal.metres is {metres:g}, but to be at a thing is to be no metres from it: "
            "name a region"
        )
    if thing == ROBOT and region == AT:
        raise ValueError(
            f"{path}.goal.thing is 'robot', but the robot is always at itself: name a region"
        )
    avoid = tuple(
        _look_up(name, index, f"{path}.avoid[{i}]", may_be_robot=False)
        for i, name in enumerate(document.get("avoid", ()))
    )
    if thing in avoid and region == AT:
        raise ValueError(f"{path}.avoid holds {quote(goal['thing'])}, which is the goal")
    return FormCommand(
        action=ACTIONS.index(document.get("action", ACTIONS[0])),
        mode=MODES.index(document.get("mode", MODES[0])),
        region=region,
        thing=thing,
        avoid=avoid,
        metres=float(metres),
    )


def read_meaning(document: Any, *, path: str) -> tuple[FormReading, tuple[str, ...]]:
    """Read a single reading without a probability: the meaning of a labelled sentence.

    Also returns the object types that it names, in index order.

    Raises:
        ValueError: a field cannot be; one line that begins with the JSON ``path`` of the document.
    """
    schema = annotation_schema()["$defs"]["reading"]
    fields = {name: item for name, item in schema["properties"].items() if name != "probability"}
    validate(document, {**schema, "properties": fields, "required": ["things"]}, path=path)
    names = tuple(dict.fromkeys(thing["type"] for thing in document["things"]))
    return _to_reading({**document, "probability": 1.0}, names, path), names
