"""A document against a JSON Schema, refused at the first field that does not fit.

A refusal names the field by its JSON path, the value, the limit and the remedy.
"""

from collections.abc import Mapping
from typing import Any

_LONGEST = 40
"""Characters of a value that a refusal repeats."""


def quote(value: Any) -> str:
    """Repeat a value in a refusal: on one line, and not too long."""
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def validate(value: Any, schema: Mapping[str, Any], *, root: Mapping[str, Any], path: str) -> None:
    """Refuse a value, as ``json`` has read it, that does not fit a schema.

    Definitions are those of ``root``; ``path`` is the JSON path of the value.

    Raises:
        ValueError: the first field that does not fit, in one line with its JSON path.
    """
    from jsonschema import Draft202012Validator

    whole = {**schema, "$defs": root["$defs"]}
    error: Any = next(iter(Draft202012Validator(whole).iter_errors(value)), None)
    if error is None:
        return
    place, found, limit = f"{path}{error.json_path[1:]}", error.instance, error.validator_value
    if error.validator == "required":
        missing = next(name for name in limit if name not in found)
        raise ValueError(f"{place}.{missing} is missing: add it")
    if error.validator == "additionalProperties":
        known = error.schema["properties"]
        name = quote(next(name for name in found if name not in known))
        raise ValueError(
            f"{place} has a field {name}, but may only have {', '.join(known)}: leave it out"
        )
    if error.validator == "maxItems":
        raise ValueError(f"{place} has {len(found)} entries, but at most {limit} are held")
    wanted = error.schema["description"]
    if error.validator == "enum":
        wanted = f"one of {', '.join(limit)}"
    elif error.validator == "type":
        wanted = f"of type {limit}: {wanted}"
    raise ValueError(f"{place} is {quote(found)}, but must be {wanted}")
