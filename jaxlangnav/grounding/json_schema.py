"""A document against a JSON Schema, refused at the first field that does not fit.

Of the schema language this knows what ``data/annotations.schema.json`` needs, so that the published
file is the only place that says what a form may hold. A refusal names the field by its JSON path,
the value, the limit and the remedy.
"""

import math
import re
from collections.abc import Mapping
from typing import Any

_LONGEST = 40
"""Characters of a value that a refusal repeats."""
_TYPES: dict[str, tuple[str, type | tuple[type, ...]]] = {
    "object": ("an object", dict),
    "array": ("a list", list),
    "string": ("a string", str),
    "integer": ("a whole number", (int, float)),
    "number": ("a number", (int, float)),
}


def quote(value: Any) -> str:
    """Repeat a value in a refusal: on one line, and not too long."""
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def validate(value: Any, schema: Mapping[str, Any], *, root: Mapping[str, Any], path: str) -> None:
    """Refuse a value that does not fit a schema.

    Args:
        value: as ``json`` has read it.
        schema: what it must fit; ``$ref`` leads to definitions of ``root``.
        root: the whole schema.
        path: JSON path of the value.

    Raises:
        ValueError: the first field that does not fit, in one line.
    """
    if "$ref" in schema:
        schema = root["$defs"][schema["$ref"].rpartition("/")[2]]
    _check_type(value, schema, path)
    if isinstance(value, dict):
        _check_object(value, schema, root, path)
    elif isinstance(value, list):
        _check_list(value, schema, root, path)
    elif isinstance(value, str):
        _check_string(value, schema, path)
    else:
        _check_number(value, schema, path)


def _check_type(value: Any, schema: Mapping[str, Any], path: str) -> None:
    """Refuse a value of another type; true and false are no numbers, 1.0 is a whole one."""
    name, types = _TYPES[schema["type"]]
    is_it = isinstance(value, types) and not isinstance(value, bool)
    if is_it and schema["type"] == "integer":
        is_it = isinstance(value, int) or value.is_integer()
    if not is_it:
        raise ValueError(f"{path} is {quote(value)}, but must be {name}: {schema['description']}")


def _check_object(
    value: dict[str, Any], schema: Mapping[str, Any], root: Mapping[str, Any], path: str
) -> None:
    """Refuse a field that is missing, unknown, or does not fit."""
    fields = schema["properties"]
    for name in schema["required"]:
        if name not in value:
            raise ValueError(f"{path}.{name} is missing: {_describe(fields[name], root)}")
    for name, own in value.items():
        if name not in fields:
            raise ValueError(
                f"{path} has a field {quote(name)}, but may only have {', '.join(fields)}: "
                "leave it out"
            )
        validate(own, fields[name], root=root, path=f"{path}.{name}")


def _describe(schema: Mapping[str, Any], root: Mapping[str, Any]) -> str:
    """Say what a field is for."""
    if "$ref" in schema:
        schema = root["$defs"][schema["$ref"].rpartition("/")[2]]
    return str(schema["description"])


def _check_list(
    value: list[Any], schema: Mapping[str, Any], root: Mapping[str, Any], path: str
) -> None:
    """Refuse a list that is too long or too short, or an entry that does not fit."""
    most, least = schema["maxItems"], schema.get("minItems", 0)
    if len(value) > most:
        raise ValueError(
            f"{path} has {len(value)} entries, but at most {most} are held: say less at once"
        )
    if len(value) < least:
        raise ValueError(
            f"{path} has {len(value)} entries, but must have at least {least}: "
            f"{schema['description']}"
        )
    for index, own in enumerate(value):
        validate(own, schema["items"], root=root, path=f"{path}[{index}]")


def _check_string(value: str, schema: Mapping[str, Any], path: str) -> None:
    """Refuse a string that is none of those allowed, not of the form, or too long."""
    if "enum" in schema and value not in schema["enum"]:
        raise ValueError(
            f"{path} is {quote(value)}, but must be one of {', '.join(schema['enum'])}"
        )
    is_too_long = len(value) > schema.get("maxLength", math.inf)
    if is_too_long or not re.search(schema.get("pattern", ""), value):
        raise ValueError(f"{path} is {quote(value)}, but must be {schema['description']}")


def _check_number(value: float, schema: Mapping[str, Any], path: str) -> None:
    """Refuse a number beyond its limits; what is no number at all is beyond any."""
    is_low = value < schema.get("minimum", -math.inf)
    is_low = is_low or value <= schema.get("exclusiveMinimum", -math.inf)
    if is_low or value > schema.get("maximum", math.inf) or not math.isfinite(value):
        raise ValueError(f"{path} is {quote(value)}, but must be {schema['description']}")
