"""What an utterance of a conversation is: the words that say so, and what is left to understand.

Most utterances are sentences, which the parser understands: commands, statements, constraints.
Some are told by their wording (``data/utterances.toml``): "the other one" speaks of what the robot
is at, "then …" of what comes after it, "the left one" of a question. This module knows no state
but whether a question has been asked; what the wording comes to is the navigator's business.
"""

import enum
import re
import tomllib
import unicodedata
from dataclasses import dataclass
from functools import cache
from importlib import resources

from jaxlangnav.language.halting import MAX_HALTING_CHARACTERS, Act, act_of

_WORD = re.compile(r"[^\W_]+(?:['\u2019`][^\W_]+)*")
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


class Wording(enum.StrEnum):
    """A wording that is all that was said, by its name in the table."""

    OTHER = "other"
    CLOSER = "closer"
    RETURN = "return"
    YES = "yes"
    NO = "no"
    DENIAL = "denial"  # "no", and nothing else: to a question, or of what is being approached
    ANY = "any"
    LEFT = "left"
    RIGHT = "right"
    NEAREST = "nearest"
    FARTHEST = "farthest"
    FIRST = "first"
    SECOND = "second"
    THIRD = "third"
    FOURTH = "fourth"
    FIFTH = "fifth"
    SIXTH = "sixth"
    LAST = "last"


_KINDS = {
    Wording.OTHER: Kind.CORRECTION,
    Wording.CLOSER: Kind.CORRECTION,
    Wording.RETURN: Kind.RETURN,
}
_ACTS = {Act.HALT: Kind.HALT, Act.RESUME: Kind.RESUME, Act.CANCEL: Kind.CANCEL}


@dataclass(frozen=True, kw_only=True)
class Utterance:
    """What was said, as far as its wording tells."""

    kind: Kind | None  # None: what it is shows once the rest is understood
    wording: Wording | None = None  # where the wording is all that was said
    rest: str = ""  # what is left to be understood
    is_not_that: bool = False  # what is being approached is not what is meant


def classify(text: str, *, is_asked: bool = False) -> Utterance:
    """Tell what an utterance is, as far as its wording does.

    Args:
        text: what the person said.
        is_asked: whether the robot has asked a question, to which this may be the answer.

    Returns:
        Its kind, and what is left to be understood. What is no text is left to the parser.
    """
    act = act_of(text)
    if not isinstance(text, str) or len(text) > MAX_HALTING_CHARACTERS:
        return Utterance(kind=None, rest=text)
    words = _words(text)
    wording = _whole(tuple(word for word, _ in words), is_asked=is_asked)
    if is_asked and wording is not None:
        # "No" and "right" answer a question, whatever they mean elsewhere.
        return Utterance(kind=_KINDS.get(wording, Kind.ANSWER), wording=wording)
    if act is not None:
        return Utterance(kind=_ACTS[act])
    if wording is not None:
        return Utterance(kind=_KINDS[wording], wording=wording)
    return _opened(text, words)


def _opened(text: str, words: list[tuple[str, int]]) -> Utterance:
    """Look for an opening that says how what follows bears on what the robot is at."""
    opening, length = _opening(tuple(word for word, _ in words))
    rest = text[words[length - 1][1] :].lstrip(_LEFT_OVER) if length else text
    if opening is None or not rest:
        return Utterance(kind=None, rest=text)
    if opening == "then":
        return Utterance(kind=Kind.ADDITION, rest=rest)
    is_not_that = opening == "not_that"
    inner, skipped = _opening(tuple(word for word, _ in _words(rest)), ("not_that", "meant"))
    if inner is not None:
        words = _words(rest)
        shorter = rest[words[skipped - 1][1] :].lstrip(_LEFT_OVER)
        rest, is_not_that = shorter or rest, is_not_that or inner == "not_that"
    if _whole(tuple(word for word, _ in _words(rest)), is_asked=False) == Wording.OTHER:
        return Utterance(kind=Kind.CORRECTION, wording=Wording.OTHER)
    return Utterance(kind=Kind.CORRECTION, rest=rest, is_not_that=is_not_that)


def _words(text: str) -> list[tuple[str, int]]:
    """Split a text into plain words, each with where it ends in the text."""
    return [
        (
            re.sub(r"['\u2019`]", "", unicodedata.normalize("NFKC", match.group()).lower()),
            match.end(),
        )
        for match in _WORD.finditer(text)
    ]


def _whole(words: tuple[str, ...], *, is_asked: bool) -> Wording | None:
    """Look up a wording that is all that was said; answers only where there is a question."""
    table, _, around = _wordings()
    denial = Wording.NO if is_asked else Wording.OTHER
    meant = {key: denial if one == Wording.DENIAL else one for key, one in table.items()}
    known = {key: one for key, one in meant.items() if is_asked or one in _KINDS}
    while words:
        if words in known:
            return known[words]
        ends = [n for n in range(1, 4) if words[:n] in around or words[-n:] in around]
        if not ends:
            return None
        count = ends[-1]
        words = words[count:] if words[:count] in around else words[:-count]
    return None


def _opening(
    words: tuple[str, ...], allowed: tuple[str, ...] = ("not_that", "meant", "then")
) -> tuple[str | None, int]:
    """Find the longest opening that words begin with, and how many words it has."""
    _, openings, around = _wordings()
    first = 0
    while first < len(words) and words[first : first + 1] in around:
        first += 1
    for start in sorted({0, first}):
        for end in range(min(len(words), start + 6), start, -1):
            name = openings.get(words[start:end])
            if name in allowed:
                return name, end
    return None, 0


@cache
def _wordings() -> tuple[
    dict[tuple[str, ...], Wording], dict[tuple[str, ...], str], frozenset[tuple[str, ...]]
]:
    """Read the wordings, the openings, and what is said around them."""
    file = resources.files("jaxlangnav.language").joinpath("data/utterances.toml")
    table = tomllib.loads(file.read_text("utf-8"))
    whole = {
        tuple(wording.split()): one for one in Wording for wording in table["whole"][one.value]
    }
    begin = {
        tuple(wording.split()): name for name, row in table["begin"].items() for wording in row
    }
    return whole, begin, frozenset(tuple(wording.split()) for wording in table["around"])
