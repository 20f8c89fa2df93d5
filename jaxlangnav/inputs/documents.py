"""Parsing of untrusted TOML and JSON with limits on depth and numbers, and one-line errors.

Deeply nested documents and numbers of thousands of digits break code that traverses or prints them;
a key with many dots takes the TOML parser minutes. All are rejected here, before any other code
uses the document.
"""

import contextlib
import functools
import json
import os
import re
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

from jaxlangnav.inputs.atomic_files import read_file
from jaxlangnav.inputs.sanitize import shorten

MAX_NEST = 32
"""Limit of the nesting depth of tables and lists."""
_MAX_BITS = 64  # limit of an integer's size
_MAX_TEXT = 200  # length to which a parser's error message is shortened
# The parser's time is quadratic in the parts of a dotted key. Matches only where a key may start.
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"""(?<![\w"'-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MAX_NEST}}}""")


class DocumentError(ValueError):
    """Raised for an invalid document; the message is one line and does not name the file."""


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML; DocumentError if invalid, too deep, or with an integer above 64 bits."""
    if _LONG_KEY.search(text):
        raise DocumentError(f"has a key of more than {MAX_NEST} parts: use fewer dots")
    return _parse(tomllib.loads, text, "TOML")


def parse_json(text: str) -> Any:
    """Parse JSON; DocumentError if invalid, too deep, or with NaN or an integer above 64 bits.

    Duplicate fields are rejected, since one would be lost.
    """
    loads = functools.partial(
        json.loads, object_pairs_hook=_unique_fields, parse_constant=_reject_constant
    )
    return _parse(loads, text, "JSON")


def _unique_fields(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    for name, value in pairs:
        if name in fields:
            raise DocumentError(f"has a field {shorten(name, 40)!r} twice: leave one out")
        fields[name] = value
    return fields


def _reject_constant(name: str) -> NoReturn:
    raise DocumentError(f"holds {name}, which is no number of JSON")


def read_document(path: Path, *, max_bytes: int) -> Any:
    """Read a JSON or TOML file (by its extension .json or another) of at most ``max_bytes`` bytes.

    Raises:
        ValueError: it cannot be read or is not valid; one line that names the file.
    """
    if not os.path.lexists(path):
        raise ValueError(f"{path}: no such file")
    text = read_text(path, max_bytes=max_bytes)
    with error_prefix(path):
        return parse_json(text) if path.suffix.lower() == ".json" else parse_toml(text)


def read_text(path: str | Path, *, max_bytes: int) -> str:
    """Read a text file of at most ``max_bytes`` bytes.

    Raises:
        ValueError: it cannot be read, is no regular file, too large, or no UTF-8; one line that
            names the file.
    """
    try:
        return read_file(path, max_bytes=max_bytes).decode("utf-8")
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: is no text: save it as UTF-8") from None


def read_lines(path: str | Path, *, max_bytes: int) -> list[tuple[int, str]]:
    """Read the nonempty lines of a file, with their line numbers from 1, as ``read_text``."""
    lines = enumerate(read_text(path, max_bytes=max_bytes).split("\n"), start=1)
    return [(number, line) for number, line in lines if line.strip()]


@contextlib.contextmanager
def error_prefix(prefix: object) -> Iterator[None]:
    """Context that prefixes the message of a ValueError with a location: a file, or its line."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{prefix}: {error}") from None


def shipped_file(subpackage: str, name: str) -> Path:
    """Return the path of a file in the folder ``data`` of a subpackage, such as "language"."""
    return Path(__file__).parent.parent / subpackage / "data" / name


def read_shipped(subpackage: str, name: str) -> str:
    """Read a text file from the folder ``data`` of a subpackage."""
    return shipped_file(subpackage, name).read_text("utf-8")


def _parse(loads: Callable[[str], Any], text: str, syntax: str) -> Any:
    """Parse a document, and check its depth and numbers."""
    too_deep = f"is nested more than {MAX_NEST} deep: use fewer tables inside tables"
    try:
        document = loads(text)
    except DocumentError:
        raise
    except RecursionError:
        raise DocumentError(too_deep) from None
    except (tomllib.TOMLDecodeError, json.JSONDecodeError) as error:
        raise DocumentError(f"is no valid {syntax}: {shorten(str(error), _MAX_TEXT)}") from None
    except ValueError:
        # Python's limit on the digits of an integer, or an invalid date.
        reason = "a number of too many digits, or no such date"
        raise DocumentError(f"is no valid {syntax}: {reason}") from None
    level, depth = [document], 0
    while level:  # breadth-first, so that depth needs no recursion
        if depth > MAX_NEST:
            raise DocumentError(too_deep)
        children: list[Any] = []
        for value in level:
            if isinstance(value, dict | list):
                children += value.values() if isinstance(value, dict) else value
            elif isinstance(value, int) and value.bit_length() > _MAX_BITS:
                bits = f"{value.bit_length()} bits: use at most {_MAX_BITS}"
                raise DocumentError(f"holds a whole number of {bits}")
        level, depth = children, depth + 1
    return document
