"""Dialogue act classification of an utterance by its wording, and the remainder to parse.

Most utterances are sentences, which the parser reads: commands, statements, constraints. Some are
recognised by their wording (``data/utterances.toml``): "the other one" corrects the current goal,
"then …" adds a command, "the left one" answers a question. The only dialogue state used here is
whether a question has been asked; the navigator interprets the result.
"""

import enum
from collections.abc import Collection
from functools import cache
from typing import NamedTuple

from jaxlangnav.inputs.documents import parse_toml, read_shipped
from jaxlangnav.language.halting import MAX_HALTING_CHARACTERS, act_of
from jaxlangnav.language.tokens import words_of

_SEPARATORS = " \t\r\n,.;:!?-\u2013\u2014\u2026"


class Kind(enum.StrEnum):
    """Dialogue act of an utterance."""

    COMMAND = "command"  # a task that replaces the current one
    ADDITION = "addition"  # a task that follows the current one
    STATEMENT = "statement"  # informs about the map, leaves the task
    CORRECTION = "correction"  # rejects or replaces the current goal
    HALT = "halt"
    RESUME = "resume"
    CANCEL = "cancel"
    RETURN = "return"  # to the start of the dialogue
    CONSTRAINT = "constraint"  # objects to avoid
    ANSWER = "answer"  # to a question of the robot


Wording = enum.StrEnum(
    "Wording",
    "OTHER CLOSER RETURN YES NO DENIAL ANY LEFT RIGHT NEAREST FARTHEST "
    "FIRST SECOND THIRD FOURTH FIFTH SIXTH LAST",
)
"""Wordings of whole utterances, named as in the table. ``DENIAL`` is "no" alone: the answer to a
question, or a rejection of the current goal."""
_KINDS = {
    Wording.OTHER: Kind.CORRECTION,
    Wording.CLOSER: Kind.CORRECTION,
    Wording.RETURN: Kind.RETURN,
}


class Utterance(NamedTuple):
    """An utterance classified by its wording."""

    kind: Kind | None  # None: undecided until the rest is parsed
    wording: Wording | None = None  # if it is the whole utterance
    rest: str = ""  # remainder to parse
    rejects_goal: bool = False  # the current goal is rejected


def classify(text: str, *, is_asked: bool = False) -> Utterance:
    """Classify an utterance by its wording, and return the remainder to parse.

    ``is_asked``: the robot has asked a question, to which this may be the answer. Input that is not
    a string is left to the parser.
    """
    act = act_of(text)
    if not isinstance(text, str) or len(text) > MAX_HALTING_CHARACTERS:
        return Utterance(kind=None, rest=text)
    wording = _match_whole(text, is_asked=is_asked)
    # After a question, "no" and "right" are answers.
    if act is not None and not (is_asked and wording is not None):
        return Utterance(kind=Kind(act.value))
    if wording is not None:
        return Utterance(kind=_KINDS.get(wording, Kind.ANSWER), wording=wording)
    # Opening words: "no, …", "I meant …", "then …".
    opening, rest = _match_opening(text, ("not_that", "meant", "then"))
    if opening is None or not rest:
        return Utterance(kind=None, rest=text)
    if opening == "then":
        return Utterance(kind=Kind.ADDITION, rest=rest)
    inner, inner_rest = _match_opening(rest, ("not_that", "meant"))
    rest = inner_rest or rest
    if _match_whole(rest, is_asked=False) == Wording.OTHER:
        return Utterance(kind=Kind.CORRECTION, wording=Wording.OTHER)
    return Utterance(kind=Kind.CORRECTION, rest=rest, rejects_goal="not_that" in (opening, inner))


def _match_whole(text: str, *, is_asked: bool) -> Wording | None:
    """Look up a whole utterance, ignoring polite words around it; answers need a question."""
    table, _, around = _wordings()
    words = tuple(word for word, _, _ in words_of(text))
    while words:
        wording = table.get(words)
        if wording == Wording.DENIAL:
            wording = Wording.NO if is_asked else Wording.OTHER
        if wording is not None and (is_asked or wording in _KINDS):
            return wording
        ends = [n for n in range(1, 4) if words[:n] in around or words[-n:] in around]
        if not ends:
            return None
        count = ends[-1]
        words = words[count:] if words[:count] in around else words[:-count]
    return None


def _match_opening(text: str, allowed: Collection[str]) -> tuple[str | None, str]:
    """Find the longest opening phrase of a text, and the remainder after it."""
    _, openings, around = _wordings()
    spans = words_of(text)
    words = tuple(word for word, _, _ in spans)
    skipped = next((i for i in range(len(words)) if words[i : i + 1] not in around), len(words))
    for start in sorted({0, skipped}):
        for end in range(min(len(words), start + 6), start, -1):
            name = openings.get(words[start:end])
            if name in allowed:
                return name, text[spans[end - 1][2] :].lstrip(_SEPARATORS)
    return None, ""


@cache
def _wordings() -> tuple[
    dict[tuple[str, ...], Wording], dict[tuple[str, ...], str], frozenset[tuple[str, ...]]
]:
    """Load wordings of whole utterances, openings, and polite words around them."""
    table = parse_toml(read_shipped("language", "utterances.toml"))
    whole = {tuple(text.split()): w for w in Wording for text in table["whole"][w.value]}
    openings = {tuple(text.split()): name for name, row in table["begin"].items() for text in row}
    return whole, openings, frozenset(tuple(text.split()) for text in table["around"])
