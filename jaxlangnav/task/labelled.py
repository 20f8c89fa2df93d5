"""Anyone's labelled sentences: what each means, or that it must be refused (section 4.1).

A file of JSON lines. Each line is an object with

- ``text``: the sentence;
- ``label``: ``"refuse"``, or one reading of the published form (``grounding.form``) without its
  probability: ``things``, ``relations`` among them, and ``commands`` in order;
- ``construction``: what the sentence is an example of; may be left out.

    {"text": "stop behind the car", "label": {"things": [{"id": "c", "type": "car"}],
     "commands": [{"goal": {"region": "behind", "thing": "c"}}]}, "construction": "regions"}
"""

import dataclasses
from pathlib import Path
from typing import Any

from jaxlangnav.files.documents import DocumentError, parse_json, read_text
from jaxlangnav.grounding.form import FormReading, read_meaning
from jaxlangnav.grounding.json_schema import quote
from jaxlangnav.language.lexicon import type_called

REFUSE = "refuse"
MOST_SENTENCES = 20_000
"""Lines that a file may have."""
_LARGEST_FILE = 32 * 1024 * 1024
"""Bytes of such a file."""
_LONGEST_NAME = 60
"""Characters of the name of a construction."""


@dataclasses.dataclass(frozen=True)
class Meaning:
    """What a sentence means."""

    reading: FormReading
    type_names: tuple[str, ...]  # object types by index; those of the lexicon by their own names

    def type_of(self, thing: int) -> str:
        """Name the object type of a thing that is not the robot."""
        return self.type_names[self.reading.types[thing]]


@dataclasses.dataclass(frozen=True, kw_only=True)
class LabelledSentence:
    """One line of a file."""

    line: int  # 1-based
    text: str
    construction: str
    meaning: Meaning | None  # None where it must be refused


def read_sentences(path: Path) -> list[LabelledSentence]:
    """Read a file of labelled sentences.

    Args:
        path: of a file in the format above; empty lines are left out.

    Returns:
        Its sentences, in order.

    Raises:
        ValueError: no such file, or a line cannot be; one line that names file, line and remedy.
    """
    try:
        text = read_text(path, at_most=_LARGEST_FILE)
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from None
    lines = [(i, line) for i, line in enumerate(text.split("\n"), start=1) if line.strip()]
    if not lines:
        raise ValueError(f"{path}: holds no sentence: write one JSON object a line")
    if len(lines) > MOST_SENTENCES:
        raise ValueError(
            f"{path}: holds {len(lines)} sentences; at most {MOST_SENTENCES} are read: split it"
        )
    found = []
    for number, line in lines:
        try:
            found.append(_read_line(number, parse_json(line)))
        except DocumentError as error:
            raise ValueError(f"{path}:{number}: {error}") from None
        except ValueError as error:
            raise ValueError(f"{path}:{number}: {error}") from None
    return found


def _read_line(number: int, document: Any) -> LabelledSentence:
    """Read one line."""
    if not isinstance(document, dict):
        raise ValueError(f"is {quote(document)}, but must be an object with text and label")
    unknown = set(document) - {"text", "label", "construction"}
    if unknown:
        names = ", ".join(sorted(quote(name) for name in unknown))
        raise ValueError(f"has {names}, but only text, label and construction are known")
    for name in ("text", "label"):
        if name not in document:
            raise ValueError(f"{name} is missing: every line needs text and label")
    construction = document.get("construction", "")
    for name, value in (("text", document["text"]), ("construction", construction)):
        if not isinstance(value, str):
            raise ValueError(f"{name} is {quote(value)}, but must be a string")
    if len(construction) > _LONGEST_NAME:
        raise ValueError(
            f"construction has {len(construction)} characters, but at most {_LONGEST_NAME} are "
            "held: shorten it"
        )
    return LabelledSentence(
        line=number,
        text=document["text"],
        construction=construction,
        meaning=_read_label(document["label"]),
    )


def _read_label(label: Any) -> Meaning | None:
    """Read what a sentence means."""
    if label == REFUSE:
        return None
    if isinstance(label, str):
        raise ValueError(f"label is {quote(label)}, but must be 'refuse' or an object")
    reading, names = read_meaning(label, path="label")
    return Meaning(reading, tuple(type_called(name.lower()) or name for name in names))
