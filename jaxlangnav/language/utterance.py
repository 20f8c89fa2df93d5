"""What an utterance of a conversation is: the words that say so, and what is left to understand.

Most utterances are sentences, which the parser understands: commands, statements, constraints.
Some are told by their wording (``data/utterances.toml``): "the other one" speaks of what the robot
is at, "then …" of what comes after it, "the left one" of a question. This module knows no state
but whether a question has been asked; what the wording comes to is the navigator's business.
"""

import enum
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache

from jaxlangnav.inputs.documents import parse_toml, read_shipped
from jaxlangnav.language.halting import MAX_HALTING_CHARACTERS, act_of
from jaxlangnav.language.tokens import words_of

_LEFT_OVER = " \t\r\n,.;:!?-\u2013\u2014\u2026"


class Kind(enum.StrEnum):
    """What an utterance was taken for."""

    COMMAND = "command"  # a task in place of the present one
    ADDITION = "addition"  # something to be done after it
    STATEMENT = "statement"  # says something of the map, and changes no task
    CORRECTION = "correction"  # rules out, or names, what is meant
    HALT = "halt"
    RESUME = "resume"
    CANCEL = "cancel"
    RETURN = "return"  # to where the conversation began
    CONSTRAINT = "constraint"  # what to keep away from
    ANSWER = "answer"  # to a question of the robot's


Wording = enum.StrEnum(
    "Wording",
    "OTHER CLOSER RETURN YES NO DENIAL ANY LEFT RIGHT NEAREST FARTHEST "
    "FIRST SECOND THIRD FOURTH FIFTH SIXTH LAST",
)
"""Wordings that are all that was said, by their names in the table. ``DENIAL`` is "no", and nothing
else: to a question, or of what is being approached."""


_KINDS = {
    Wording.OTHER: Kind.CORRECTION,
    Wording.CLOSER: Kind.CORRECTION,
    Wording.RETURN: Kind.RETURN,
}


@dataclass(frozen=True, kw_only=True)
class Utterance:
    """What was said, as far as its wording tells."""

    kind: Kind | None  # None: what it is shows once the rest is understood
    wording: Wording | None = None  # where the wording is all that was said
    rest: str = ""  # what is left to be understood
    is_not_that: bool = False  # what is being approached is not what is meant


def classify(text: str, *, is_asked: bool = False) -> Utterance:
    """Tell what an utterance is, as far as its wording does, and what is left to be understood.

    ``is_asked``: the robot has asked a question, to which this may be the answer. What is no text
    is left to the parser.
    """
    act = act_of(text)
    if not isinstance(text, str) or len(text) > MAX_HALTING_CHARACTERS:
        return Utterance(kind=None, rest=text)
    wording = _whole(text, is_asked=is_asked)
    # "No" and "right" answer a question, whatever they mean elsewhere.
    if act is not None and not (is_asked and wording is not None):
        return Utterance(kind=Kind(act.value))
    if wording is not None:
        return Utterance(kind=_KINDS.get(wording, Kind.ANSWER), wording=wording)
    return _opened(text)


def _opened(text: str) -> Utterance:
    """Look for an opening that says how what follows bears on what the robot is at."""
    opening, rest = _opening(text, ("not_that", "meant", "then"))
    if opening is None or not rest:
        return Utterance(kind=None, rest=text)
    if opening == "then":
        return Utterance(kind=Kind.ADDITION, rest=rest)
    inner, shorter = _opening(rest, ("not_that", "meant"))
    rest = shorter or rest
    if _whole(rest, is_asked=False) == Wording.OTHER:
        return Utterance(kind=Kind.CORRECTION, wording=Wording.OTHER)
    is_not_that = "not_that" in (opening, inner)
    return Utterance(kind=Kind.CORRECTION, rest=rest, is_not_that=is_not_that)


def _whole(text: str, *, is_asked: bool) -> Wording | None:
    """Look up a wording that is all that was said; answers only where there is a question."""
    table, _, around = _wordings()
    words = tuple(word for word, _, _ in words_of(text))
    while words:
        found = table.get(words)
        if found == Wording.DENIAL:
            found = Wording.NO if is_asked else Wording.OTHER
        if found is not None and (is_asked or found in _KINDS):
            return found
        ends = [n for n in range(1, 4) if words[:n] in around or words[-n:] in around]
        if not ends:
            return None
        count = ends[-1]
        words = words[count:] if words[:count] in around else words[:-count]
    return None


def _opening(text: str, allowed: Collection[str]) -> tuple[str | None, str]:
    """Find the longest opening that a text begins with, and what follows it."""
    _, openings, around = _wordings()
    found = words_of(text)
    words = tuple(word for word, _, _ in found)
    first = next((i for i in range(len(words)) if words[i : i + 1] not in around), len(words))
    for start in sorted({0, first}):
        for end in range(min(len(words), start + 6), start, -1):
            name = openings.get(words[start:end])
            if name in allowed:
                return name, text[found[end - 1][2] :].lstrip(_LEFT_OVER)
    return None, ""


@cache
def _wordings() -> tuple[
    dict[tuple[str, ...], Wording], dict[tuple[str, ...], str], frozenset[tuple[str, ...]]
]:
    """Read the wordings, the openings, and what is said around them."""
    table = parse_toml(read_shipped("language", "utterances.toml"))
    whole = {tuple(said.split()): one for one in Wording for said in table["whole"][one.value]}
    begin = {tuple(said.split()): name for name, row in table["begin"].items() for said in row}
    return whole, begin, frozenset(tuple(said.split()) for said in table["around"])
