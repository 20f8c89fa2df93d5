"""Validation of documents by msgspec schemas, with one-line error messages for users.

The type of a document is a ``Schema`` or any other type that msgspec supports. A message names the
invalid part, its value, the limit and the remedy, as in "area.x_max is 3, but must be at
least 4".
"""

import ctypes
import re
from collections.abc import Iterable
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta, inspect

from jaxlangnav.inputs.sanitize import (
    MAX_NAME,
    as_text,
    did_you_mean,
    name_fault,
    sanitize,
    shorten,
)

_Document = TypeVar("_Document")
Name = Annotated[str, Meta(pattern=r"\S", max_length=MAX_NAME)]
"""A name that appears in our messages: of a world, of an object in it, of a sweep."""
PlainText = Annotated[str, Meta(pattern=r"\S", max_length=1000)]
"""An utterance, or the path of a file."""
_PATH_PART = re.compile(r"\.(\w+)|\[(\d+)\]")
_LIMITS = (("at least", "ge"), ("above", "gt"), ("at most", "le"), ("below", "lt"))
_TYPE_NAMES: dict[type, str] = {
    inspect.StructType: "a table of keys and values",
    inspect.DictType: "a table of keys and values",
    inspect.ListType: "a list",
    inspect.TupleType: "a list",
    inspect.StrType: "a text that is not empty",
    inspect.FloatType: "a number",
    inspect.IntType: "a whole number",
}


class Schema(msgspec.Struct, forbid_unknown_fields=True):
    """Base class of table schemas: forbids unknown keys and unprintable texts.

    A subclass with further checks raises a ``ValueError`` whose message begins with the key.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        """Leak a reference to the class: msgspec 0.22 frees a nested one twice (issue 717)."""
        super().__init_subclass__(**options)
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(cls))

    def __post_init__(self) -> None:
        """Reject texts with control or bidirectional characters."""
        for name in self.__struct_fields__:
            value = getattr(self, name)
            for text in value if isinstance(value, list) else [value]:
                if isinstance(text, str) and (fault := name_fault(text, max_length=len(text))):
                    raise ValueError(f"{name} {fault}")


def convert(document: Any, schema: type[_Document], *, where: str = "") -> _Document:
    """Convert a document of JSON or TOML types by a schema.

    ``where``: the path of keys to it, such as "sensor"; empty for a whole document.

    Raises:
        ValueError: the first part that does not fit; one line.
    """
    try:
        return msgspec.convert(document, schema)
    except msgspec.ValidationError as error:
        message = str(error)
    try:
        explanation = _explain(message, document, inspect.type_info(schema), where)
    except (LookupError, TypeError):  # a key with special characters looks like a path
        explanation = message
    raise ValueError(sanitize(shorten(explanation, 500)))


def _explain(message: str, value: Any, node: inspect.Type, where: str) -> str:
    """Build the message for a validation error, from the value at its path."""
    problem, _, path = message.partition(" - at `$")
    path = path[:-1]
    node = _intended_type(node, value)
    for name, index in _PATH_PART.findall(path):
        value = value[name or int(index)]
        if isinstance(node, inspect.StructType):
            child = next(item.type for item in node.fields if item.encode_name == name)
        elif isinstance(node, inspect.TupleType):
            child = node.item_types[int(index)]
        else:
            child = node.item_type if isinstance(node, inspect.ListType) else inspect.AnyType()
        node = _intended_type(child, value)
    key = f"{where}{path}".removeprefix(".")
    prefix = f"{key}." if key else ""
    start, _, rest = problem.partition(" field `")
    if start == "Object missing required":
        return f"{prefix}{rest[:-1]} is missing: add it"
    if start == "Object contains unknown" and isinstance(node, inspect.StructType):
        return f"{prefix}{unknown_key(rest[:-1], (item.encode_name for item in node.fields))}"
    if not problem.startswith(("Expected", "Invalid enum", "Number out")):
        return prefix + problem  # of a ``__post_init__``
    if isinstance(node, inspect.LiteralType):
        return bad_choice(key, value, map(str, node.values))
    return f"{key or 'the document'} {_describe(value, node)}"


def _intended_type(node: inspect.Type, value: Any) -> inspect.Type:
    """Select the member of a union that a value was probably meant for."""
    if isinstance(node, inspect.Metadata):
        node = node.type
    if not isinstance(node, inspect.UnionType):
        return node
    base = {list: inspect.ListType, dict: inspect.StructType}.get(type(value), inspect.Type)
    return next((type_ for type_ in node.types if isinstance(type_, base)), node.types[0])


def _describe(value: Any, node: inspect.Type) -> str:
    cap = getattr(node, "max_length", None)
    if isinstance(value, str) and cap is not None and len(value) > cap:
        return f"has {len(value)} characters, but must have at most {cap}: shorten it"
    if isinstance(value, list) and isinstance(node, inspect.ListType):
        limits = f"{node.min_length or 0} to {cap}" if cap else f"at least {node.min_length}"
        return f"has {len(value)} entries, but must have {limits}: add or remove"
    if isinstance(value, list) and isinstance(node, inspect.TupleType):
        return f"has {len(value)} entries, but must have {len(node.item_types)}: add or remove"
    bounds = ((phrase, getattr(node, name, None)) for phrase, name in _LIMITS)
    limits = " and ".join(f"{phrase} {limit:.10g}" for phrase, limit in bounds if limit is not None)
    expected = _TYPE_NAMES.get(type(node), "something else")
    is_quoted = isinstance(value, str) and isinstance(node, inspect.FloatType | inspect.IntType)
    remedy = ": write it without quotes" if is_quoted else ""
    return f"is {as_text(value)}, but must be {expected}{', ' if limits else ''}{limits}{remedy}"


def unknown_key(name: str, known: Iterable[str]) -> str:
    """Build the message for an unknown key, with the known ones and the closest."""
    names = sorted(known)
    known = f"known keys are {', '.join(names)}{did_you_mean(name, names)}"
    return f"{shorten(name)} is unknown: {known}"


def bad_choice(name: str, value: Any, choices: Iterable[str], what: str = "one of") -> str:
    """Build the message for a value outside some choices, with the closest one."""
    words = list(choices)
    listed = f"{', '.join(words) or 'none so far'}{did_you_mean(str(value), words)}"
    return f"{name} is {as_text(value)}, but must be {what}: {listed}"
