"""Recorded rewritings: what a source answered once, so that nothing has to be asked again.

A file of JSON lines, one sentence a line; the log-probabilities are natural logarithms:

    {"text": "hang out near the bench", "rewrites": [["wait near the bench", -0.3]]}
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxlangnav.files.documents import parse_json, read_text
from jaxlangnav.grounding.json_schema import quote
from jaxlangnav.grounding.rewrites import Rewrite

_LARGEST_FILE = 32 * 1024 * 1024
"""Bytes of such a file."""


class RecordedRewrites:
    """A source that answers from a file."""

    def __init__(self, path: Path) -> None:
        """Read a file.

        Args:
            path: of a file in the format above; empty lines are left out.

        Raises:
            ValueError: no such file, or a line cannot be; one line that names file and line.
        """
        self.answers: dict[str, tuple[Rewrite, ...]] = {}
        try:
            text = read_text(path, at_most=_LARGEST_FILE)
        except OSError as error:
            raise ValueError(f"cannot read {path}: {error.strerror}") from None
        for number, line in enumerate(text.split("\n"), start=1):
            if not line.strip():
                continue
            try:
                said, rewrites = _read_line(parse_json(line))
                if said in self.answers:
                    raise ValueError(f"text {quote(said)} stands in an earlier line already")
            except ValueError as error:
                raise ValueError(f"{path}:{number}: {error}") from None
            self.answers[said] = rewrites
        if not self.answers:
            raise ValueError(f"{path}: holds no rewriting: write one JSON object a line")

    def __call__(self, text: str) -> Sequence[Rewrite]:
        """Look a sentence up; nothing where it was not recorded."""
        return self.answers.get(text, ())


def _read_line(document: Any) -> tuple[str, tuple[Rewrite, ...]]:
    """Read one line."""
    if not isinstance(document, dict) or set(document) != {"text", "rewrites"}:
        raise ValueError(f"is {quote(document)}, but must be an object with text and rewrites")
    text, rewrites = document["text"], document["rewrites"]
    if not isinstance(text, str):
        raise ValueError(f"text is {quote(text)}, but must be a string")
    if not isinstance(rewrites, list):
        raise ValueError(f"rewrites is {quote(rewrites)}, but must be a list of pairs")
    return text, tuple(_read_rewrite(one, i) for i, one in enumerate(rewrites))


def _read_rewrite(document: Any, index: int) -> Rewrite:
    """Read one rewriting."""
    match document:
        case [str(text), float() | int() as score] if not isinstance(score, bool):
            if math.isfinite(score):
                return text, float(score)
    raise ValueError(
        f"rewrites[{index}] is {quote(document)}, but must be a sentence and its log-probability, "
        'as in ["go to the cone", -0.7]'
    )
