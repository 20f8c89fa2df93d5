"""Validation of documents by schemas: what msgspec complains of becomes one line for people.

What a document must be is a ``Schema`` or any other type that msgspec knows. The line says which
part does not fit, its value, the limit and the remedy, as in "area.x_max is 3, but must be at
least 4".
"""

import ctypes
import difflib
import re
from collections.abc import Iterable
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta, inspect

from jaxlangnav.inputs.sanitize import LONGEST_NAME, as_text, name_fault, sanitize, shorten

_T = TypeVar("_T")
Name = Annotated[str, Meta(pattern=r"\S", max_length=LONGEST_NAME)]
"""A text that stands in lines of ours: the name of a world, of an object in it, of a sweep."""
PlainText = Annotated[str, Meta(pattern=r"\S", max_length=1000)]
"""What is said to a robot, or the path of a file."""
_PART = re.compile(r"\.(\w+)|\[(\d+)\]")
_LIMITS = (("at least", "ge"), ("above", "gt"), ("at most", "le"), ("below", "lt"))
_WORDS: dict[type, str] = {
    inspect.StructType: "a table of keys and values",
    inspect.DictType: "a table of keys and values",
    inspect.ListType: "a list",
    inspect.TupleType: "a list",
    inspect.StrType: "a text that is not empty",
    inspect.FloatType: "a number",
    inspect.IntType: "a whole number",
}


class Schema(msgspec.Struct, forbid_unknown_fields=True):
    """A schema of a table: of known keys, its texts such that a terminal can show them.

    A subclass that checks more raises a ``ValueError`` whose message begins with the key.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        """Keep the class for ever: msgspec 0.22 frees a nested one twice at exit (issue 717)."""
        super().__init_subclass__(**options)
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(cls))

    def __post_init__(self) -> None:
        """Refuse texts that would move a terminal's cursor or turn the direction of writing."""
        for name in self.__struct_fields__:
            value = getattr(self, name)
            for text in value if isinstance(value, list) else [value]:
                if isinstance(text, str) and (fault := name_fault(text, longest=len(text))):
                    raise ValueError(f"{name} {fault}")


def convert(document: Any, schema: type[_T], *, where: str = "") -> _T:
    """Read a document of JSON's or TOML's types by its schema.

    ``where`` are the keys that lead to it, such as "sensor"; empty for a whole file.

    Raises:
        ValueError: the first part that does not fit; one line.
    """
    try:
        return msgspec.convert(document, schema)
    except msgspec.ValidationError as error:
        complaint = str(error)
    try:
        line = _explain(complaint, document, inspect.type_info(schema), where)
    except (LookupError, TypeError):  # what looks like a path is a key of odd characters
        line = complaint
    raise ValueError(sanitize(shorten(line, 500)))


def _explain(complaint: str, value: Any, kind: inspect.Type, where: str) -> str:
    """Write the line of a complaint about what its path leads to."""
    problem, _, path = complaint.partition(" - at `$")
    path = path[:-1]
    kind = _meant(kind, value)
    for name, index in _PART.findall(path):
        value = value[name or int(index)]
        if isinstance(kind, inspect.StructType):
            below = next(one.type for one in kind.fields if one.encode_name == name)
        elif isinstance(kind, inspect.TupleType):
            below = kind.item_types[int(index)]
        else:
            below = kind.item_type if isinstance(kind, inspect.ListType) else inspect.AnyType()
        kind = _meant(below, value)
    place = f"{where}{path}".removeprefix(".")
    inside = f"{place}." if place else ""
    start, _, rest = problem.partition(" field `")
    if start == "Object missing required":
        return f"{inside}{rest[:-1]} is missing: add it"
    if start == "Object contains unknown" and isinstance(kind, inspect.StructType):
        return f"{inside}{unknown_key(rest[:-1], (one.encode_name for one in kind.fields))}"
    if not problem.startswith(("Expected", "Invalid enum", "Number out")):
        return inside + problem  # of a ``__post_init__``
    if isinstance(kind, inspect.LiteralType):
        return no_choice(place, value, map(str, kind.values))
    return f"{place or 'the file'} {_fault(value, kind)}"


def _meant(kind: inspect.Type, value: Any) -> inspect.Type:
    """Choose of several types the one that a value was meant to have."""
    if isinstance(kind, inspect.Metadata):
        kind = kind.type
    if not isinstance(kind, inspect.UnionType):
        return kind
    wanted = {list: inspect.ListType, dict: inspect.StructType}.get(type(value), inspect.Type)
    return next((one for one in kind.types if isinstance(one, wanted)), kind.types[0])


def _fault(value: Any, kind: inspect.Type) -> str:
    most = getattr(kind, "max_length", None)
    if isinstance(value, str) and most is not None and len(value) > most:
        return f"has {len(value)} characters, but must have at most {most}: shorten it"
    if isinstance(value, list) and isinstance(kind, inspect.ListType):
        limits = f"{kind.min_length or 0} to {most}" if most else f"at least {kind.min_length}"
        return f"has {len(value)} entries, but must have {limits}: add or remove"
    if isinstance(value, list) and isinstance(kind, inspect.TupleType):
        return f"has {len(value)} entries, but must have {len(kind.item_types)}: add or remove"
    found = ((words, getattr(kind, name, None)) for words, name in _LIMITS)
    limits = " and ".join(f"{words} {limit:.10g}" for words, limit in found if limit is not None)
    wanted = _WORDS.get(type(kind), "something else")
    is_quoted = isinstance(value, str) and isinstance(kind, inspect.FloatType | inspect.IntType)
    remedy = ": write it without quotes" if is_quoted else ""
    return f"is {as_text(value)}, but must be {wanted}{', ' if limits else ''}{limits}{remedy}"


def unknown_key(name: str, known: Iterable[str]) -> str:
    """Say that a key is unknown, which ones there are, and which may be meant."""
    names = sorted(known)
    known = f"known keys are {', '.join(names)}{closest_choice(name, names)}"
    return f"{shorten(name)} is unknown: {known}"


def no_choice(name: str, value: Any, choices: Iterable[str], what: str = "one of") -> str:
    """Say that the value of a key is none of some words, and which of them may be meant."""
    words = list(choices)
    known = ", ".join(words) or "none so far"
    return f"{name} is {as_text(value)}, but must be {what}: {known}{closest_choice(value, words)}"


def closest_choice(value: Any, choices: Iterable[str]) -> str:
    """Suggest the closest choice, as in ". Did you mean 'hydrant'?", or nothing."""
    close = difflib.get_close_matches(shorten(str(value)), list(choices), n=1)
    return f". Did you mean {close[0]!r}?" if close else ""
