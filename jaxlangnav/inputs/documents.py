"""TOML and JSON from outside: read with limits, refused in one line.

A document that nests a thousand deep, or holds a number of ten thousand digits, breaks whoever
walks through it or prints it; one key of many dots keeps the TOML parser busy for minutes. Each is
refused here, before anything else sees the document.
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

from jaxlangnav.inputs.sanitize import shorten
from jaxlangnav.inputs.whole_files import read_file

DEEPEST = 32
"""Tables and lists inside one another that a document may have."""
_BITS = 64
"""Of a whole number; so many digits stand for no size, place or count of ours."""
_MESSAGE = 200
"""Characters that a parser's complaint is cut to."""
# Keys joined by dots cost the parser the square of their number. Starts only where a key may.
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_DOTTED = re.compile(rf"""(?<![\w"'-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEEPEST}}}""")


class DocumentError(ValueError):
    """A document cannot be used; the message is one line and does not name the file."""


def parse_toml(text: str) -> dict[str, Any]:
    """Read TOML; DocumentError if it is none, too deep, or has a number beyond 64 bits."""
    if _DOTTED.search(text):
        raise DocumentError(f"has a key of more than {DEEPEST} parts: use fewer dots")
    return _parse(tomllib.loads, text, "TOML")


def parse_json(text: str) -> Any:
    """Read JSON; DocumentError if it is none, too deep, or has NaN or a number beyond 64 bits.

    Of an object that has a field twice one would be lost: it is refused.
    """
    loads = functools.partial(
        json.loads, object_pairs_hook=_once_each, parse_constant=_refuse_constant
    )
    return _parse(loads, text, "JSON")


def _once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise DocumentError(f"has a field {shorten(name, 40)!r} twice: leave one out")
        found[name] = value
    return found


def _refuse_constant(name: str) -> NoReturn:
    raise DocumentError(f"holds {name}, which is no number of JSON")


def read_document(path: Path, *, at_most: int) -> Any:
    """Read a file of JSON, or of TOML if its name does not end in .json, of so many bytes at most.

    Raises:
        ValueError: it cannot be read or is not valid; one line that names the file.
    """
    if not os.path.lexists(path):
        raise ValueError(f"{path}: no such file")
    text = read_text(path, at_most=at_most)
    with naming(path):
        return parse_json(text) if path.suffix.lower() == ".json" else parse_toml(text)


def read_text(path: str | Path, *, at_most: int) -> str:
    """Read a file of text of so many bytes at most.

    Raises:
        ValueError: it cannot be read, is no regular file, too large, or no UTF-8; one line that
            names the file.
    """
    try:
        return read_file(path, at_most=at_most).decode("utf-8")
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: is no text: save it as UTF-8") from None


def read_lines(path: str | Path, *, at_most: int) -> list[tuple[int, str]]:
    """Read the lines of a file that are not empty, with their numbers from 1, as ``read_text``."""
    lines = enumerate(read_text(path, at_most=at_most).split("\n"), start=1)
    return [(number, line) for number, line in lines if line.strip()]


@contextlib.contextmanager
def naming(place: object) -> Iterator[None]:
    """Begin what a ValueError says with the place of its cause: a file, or a line of it."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from None


def shipped_file(floor: str, name: str) -> Path:
    """Find a file in the folder ``data`` of a part of this package, such as "language"."""
    return Path(__file__).parent.parent / floor / "data" / name


def read_shipped(floor: str, name: str) -> str:
    """Read such a file of text."""
    return shipped_file(floor, name).read_text("utf-8")


def _parse(loads: Callable[[str], Any], text: str, kind: str) -> Any:
    """Read a document and check its depth and numbers."""
    too_deep = f"is nested more than {DEEPEST} deep: use fewer tables inside tables"
    try:
        document = loads(text)
    except DocumentError:
        raise
    except RecursionError:
        raise DocumentError(too_deep) from None
    except (tomllib.TOMLDecodeError, json.JSONDecodeError) as error:
        raise DocumentError(f"is no valid {kind}: {shorten(str(error), _MESSAGE)}") from None
    except ValueError:
        # Python's own limit on the digits of a whole number, or a date that is none.
        why = "a number of too many digits, or no such date"
        raise DocumentError(f"is no valid {kind}: {why}") from None
    level, depth = [document], 0
    while level:  # level by level, so that depth costs no stack
        if depth > DEEPEST:
            raise DocumentError(too_deep)
        below: list[Any] = []
        for value in level:
            if isinstance(value, dict | list):
                below += value.values() if isinstance(value, dict) else value
            elif isinstance(value, int) and value.bit_length() > _BITS:
                bits = f"{value.bit_length()} bits: use at most {_BITS}"
                raise DocumentError(f"holds a whole number of {bits}")
        level, depth = below, depth + 1
    return document
