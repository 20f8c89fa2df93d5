"""Output streams: text for people or one JSON document for scripts on standard output.

Errors are one line on standard error.
"""

import contextlib
import json
import math
import os
import re
import shutil
import sys
import textwrap
import traceback
from collections.abc import Mapping, Sequence
from typing import Any

from jaxlangnav.experiments.table import Document as Document
from jaxlangnav.inputs.sanitize import Escaped, is_printable, sanitize, shorten

_MAX_TABLE_WIDTH = 240  # columns
_MAX_LINE_WIDTH = 100  # columns to which narrative lines are wrapped on a terminal
_PLATFORMS = "JAX_PLATFORMS"  # environment variable of JAX that selects the backend
_NO_BACKEND = "Unable to initialize backend"
_MAX_CHARS, _TAIL = 600, 200
"""Characters of an error message; those kept at its end if it is truncated."""


class Output:
    """Writer for text output that leaves standard output to the document under ``--json``."""

    def __init__(self, *, is_json: bool) -> None:
        """Create a writer; with ``is_json`` only notes are printed, on standard error."""
        self.is_json = is_json

    def print(self, *parts: Any) -> None:
        """Print texts, tables and trees; nothing under ``--json``.

        The parts are texts, each within one line, and what rich draws: tables, trees, styled text.
        They may come from others: no markup is read in them, and nothing moves the terminal.
        """
        if not self.is_json:
            from rich.console import Console

            kwargs: dict[str, Any] = dict.fromkeys(("highlight", "markup", "emoji"), False)
            # A table wider than the screen is wrapped by the terminal, not cropped.
            console = Console(file=sys.stdout, width=_MAX_TABLE_WIDTH, soft_wrap=True, **kwargs)
            console.print(*(sanitize(x) if isinstance(x, str) else Escaped(x) for x in parts))

    def print_wrapped(self, lines: Sequence[str]) -> None:
        """Print narrative lines; a terminal wraps them with a hanging indent."""
        if self.is_json:
            return
        is_terminal = sys.stdout.isatty()
        width = min(shutil.get_terminal_size().columns, _MAX_LINE_WIDTH)
        for line in lines:
            indent = len(line.partition("] ")[0]) + 2 if line.startswith("[") else 0
            # A no-break space keeps a number and its unit on one line.
            line = sanitize(line)
            joined = re.sub(r"(\d) (?=%|m\b)", "\\1\N{NO-BREAK SPACE}", line)
            wrapped = textwrap.fill(joined, width, subsequent_indent=" " * indent)
            print(wrapped.replace("\N{NO-BREAK SPACE}", " ") if is_terminal else line)

    def note(self, text: str) -> None:
        """Print a plain line on standard error: progress, warnings, repairs."""
        print(sanitize(text), file=sys.stderr, flush=True)


def write_document(document: Document) -> None:
    """Print a document as JSON on standard output; NaN and infinity become null."""
    is_unicode = (sys.stdout.encoding or "").lower().startswith("utf")
    text = json.dumps(to_jsonable(document), ensure_ascii=not is_unicode, indent=2)
    # JSON strings may contain terminal control characters: escape them.
    escaped = (c if is_printable(c) or c == "\n" else json.dumps(c)[1:-1] for c in text)
    sys.stdout.write("".join(escaped) + "\n")


def document_text(document: Document) -> str:
    """Serialize a document as indented JSON."""
    return json.dumps(to_jsonable(document), indent=2) + "\n"


def to_jsonable(value: Any) -> Any:
    """Convert nested mappings, sequences, paths, scalars and arrays to JSON types."""
    if isinstance(value, Mapping):
        return {str(key): to_jsonable(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [to_jsonable(item) for item in value]
    if hasattr(value, "tolist"):
        return to_jsonable(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)


class UsageError(ValueError):
    """Bad input from the command line; the message is one line that names value and remedy."""


def one_line(error: BaseException) -> str:
    """Format an error as one printable line, truncated in its middle; the type if it is empty."""
    message = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, OSError) and error.strerror:
        name = f"{shorten(str(error.filename), 300)}: " if error.filename is not None else ""
        message = f"{name}{error.strerror}"
    message = sanitize(message)
    if len(message) <= _MAX_CHARS:
        return message
    # Keep both ends: the bad value comes first, the reason last.
    return f"{message[: _MAX_CHARS - _TAIL - 1]}…{message[-_TAIL:]}"


def is_user_error(error: BaseException) -> bool:
    """Test whether an error is due to bad input rather than an internal error.

    The package rejects bad input by raising ``ValueError`` itself; one raised inside a library
    is an internal error. Files that cannot be read or written count as bad input.
    """
    if isinstance(error, OSError):
        return True
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    module = frames[-1].f_globals.get("__name__", "") if frames else ""
    is_ours = module.split(".")[0] == "jaxlangnav"
    return isinstance(error, UsageError) or (isinstance(error, ValueError) and is_ours)


def platform_fault(failure: Exception) -> str | None:
    """Describe an unavailable backend in JAX_PLATFORMS as the cause of a failure, else None."""
    jax, platforms = sys.modules.get("jax"), os.environ.get(_PLATFORMS)
    if jax is None or not platforms:
        return None
    with contextlib.suppress(RuntimeError, AssertionError):
        if _NO_BACKEND not in str(failure) and jax.devices():
            return None
    return (
        f'{_PLATFORMS} is "{shorten(platforms)}", but JAX can compute on no such device here: '
        "unset it, or set it to cpu"
    )
