"""Where words go: people read standard output, scripts read one JSON document there instead.

What cannot be done is said in one line on standard error.
"""

import difflib
import json
import math
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from jaxlangnav.experiments.table import Document as Document
from jaxlangnav.inputs.sanitize import Plain, is_plain, sanitize, shorten

_WIDEST = 240  # columns that a table may take
_COMFORTABLE = 100
"""Columns that lines of a story take at most on a terminal: longer ones are hard to read."""
_PLATFORMS = "JAX_PLATFORMS"  # environment variable that tells JAX where to compute
_NO_BACKEND = "Unable to initialize backend"
_LONGEST, _ENDING = 600, 200
"""Characters of a complaint's one line, and those at its end that stay where it is longer."""


class Output:
    """Tells people what happens; keeps silent on standard output where a script listens."""

    def __init__(self, *, is_json: bool) -> None:
        """Bind to standard output, or to standard error where a script listens."""
        self.is_json = is_json

    def say(self, *parts: Any) -> None:
        """Print a line of the narrative; nothing under ``--json``.

        The parts are texts, each within one line, and what rich draws: tables, trees, styled text.
        They may come from others: no markup is read in them, and nothing moves the terminal.
        """
        if not self.is_json:
            from rich.console import Console

            plain: dict[str, Any] = dict.fromkeys(("highlight", "markup", "emoji"), False)
            # A table that is too wide for the screen is better wrapped by it than cut by us.
            console = Console(file=sys.stdout, width=_WIDEST, soft_wrap=True, **plain)
            console.print(*(sanitize(one) if isinstance(one, str) else Plain(one) for one in parts))

    def tell(self, lines: Sequence[str]) -> None:
        """Print a story in plain text; on a terminal long lines hang under their "[ 3 · 2.0 m]"."""
        if self.is_json:
            return
        is_watched = sys.stdout.isatty()
        width = min(shutil.get_terminal_size().columns, _COMFORTABLE)
        for line in lines:
            head = len(line.partition("] ")[0]) + 2 if line.startswith("[") else 0
            # A number and its unit stay together.
            line = sanitize(line)
            kept = re.sub(r"(\d) (?=%|m\b)", "\\1\N{NO-BREAK SPACE}", line)
            hung = textwrap.fill(kept, width, subsequent_indent=" " * head)
            print(hung.replace("\N{NO-BREAK SPACE}", " ") if is_watched else line)

    def note(self, text: str) -> None:
        """Print a plain line on standard error: progress, warnings, repairs."""
        print(sanitize(text), file=sys.stderr, flush=True)


def write_document(document: Document) -> None:
    """Print a document as JSON on standard output; what JSON lacks (NaN, infinity) becomes null."""
    is_unicode = (sys.stdout.encoding or "").lower().startswith("utf")
    text = json.dumps(to_json(document), ensure_ascii=not is_unicode, indent=2)
    # JSON lets a text hold what would steer a terminal; written as an escape it is the same text.
    escaped = (one if is_plain(one) or one == "\n" else json.dumps(one)[1:-1] for one in text)
    sys.stdout.write("".join(escaped) + "\n")


def document_text(document: Document) -> str:
    """Write a document for a file, in JSON's own types, indented."""
    return json.dumps(to_json(document), indent=2) + "\n"


def to_json(value: Any) -> Any:
    """Turn nested mappings, sequences, paths, scalars and arrays into JSON's own types."""
    if isinstance(value, Mapping):
        return {str(key): to_json(one) for key, one in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [to_json(one) for one in value]
    if hasattr(value, "tolist"):
        return to_json(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)


class UsageError(ValueError):
    """Bad input from the command line; the message is one line that names value and remedy."""


def one_line(error: BaseException) -> str:
    """Say an error in one printable line, cut in its middle; its type's name if it says nothing."""
    message = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, OSError) and error.strerror:
        where = (
            f"{shorten(str(error.filename), _LONGEST // 2)}: " if error.filename is not None else ""
        )
        message = f"{where}{error.strerror}"
    message = sanitize(message)
    if len(message) <= _LONGEST:
        return message
    # What was given stands first, why it is refused last: neither may push the other out.
    return f"{message[: _LONGEST - _ENDING - 1]}…{message[-_ENDING:]}"


def is_refusal(error: BaseException) -> bool:
    """Tell bad input from a fault of ours.

    The package refuses bad input by raising a ``ValueError`` itself; one that comes out of the
    depth of a library is a fault. Files that cannot be read or written are the person's matter.
    """
    if isinstance(error, OSError):
        return True
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    raised_in = trace.tb_frame.f_globals.get("__name__", "") if trace is not None else ""
    is_ours = raised_in.split(".")[0] == "jaxlangnav"
    return isinstance(error, UsageError) or (isinstance(error, ValueError) and is_ours)


def platform_fault(failure: Exception) -> str | None:
    """Find out after a failure whether JAX was told to compute on what is not here; else None."""
    jax, named = sys.modules.get("jax"), os.environ.get(_PLATFORMS)
    if jax is None or not named:
        return None
    try:
        is_here = _NO_BACKEND not in str(failure) and bool(jax.devices())
    except (RuntimeError, AssertionError):
        is_here = False
    if is_here:
        return None
    return (
        f'{_PLATFORMS} is "{shorten(named)}", but JAX can compute on no such device here: '
        "unset it, or set it to cpu"
    )


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Suggest the nearest known name, '; did you mean "follow"?'; nothing where none is near."""
    lower = {one.lower(): one for one in known}
    near = difflib.get_close_matches(name.lower(), lower, n=1, cutoff=0.6)
    return f'; did you mean "{lower[near[0]]}"?' if near else ""
