"""Safety utterances, recognised before any parser or model: halt, resume, cancel.

A robot that is told to stop must stop, whatever else is said. So utterances that only halt, resume
or cancel are recognised by table (``data/halting.toml``): polite words, vocatives, punctuation and
repetition are removed, and the rest is looked up. "Stop behind the cone" is not in the table and
remains a command. Misspelled words that halt are recognised too, as people type in haste.
"""

import enum
import re
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

from jaxlangnav.inputs.documents import parse_toml, read_shipped
from jaxlangnav.language.tokens import APOSTROPHES, MAX_CHARACTERS, normalize, words_of

MAX_HALTING_CHARACTERS = 400
"""Length limit of utterances that only halt, resume or cancel."""
_BREAK = re.compile(r"[^\w\s]+")
_REPEATS = re.compile(r"(.)\1+")
_MIN_LETTERS = 4  # minimum length of a halting word whose misspellings are recognised


class Act(enum.StrEnum):
    """Safety act of an utterance, the most urgent first."""

    HALT = "halt"  # stand still, keep the task
    CANCEL = "cancel"  # stand still and drop the task
    RESUME = "resume"  # go on with the task after a halt


def act_of(text: str) -> Act | None:
    """Recognise an utterance that only halts, resumes or cancels.

    Returns:
        The act; None if the utterance says anything else, or is not a string. If its parts have
        different acts ("stop! never mind, go on"), halting has priority over cancelling, and both
        over resuming.
    """
    parsed = [_acts_in(part) for part in _parts(text)]
    acts = [act for part in parsed for act in part or ()]
    return None if None in parsed or not acts else min(acts, key=list(Act).index)


def opening_of(text: str) -> tuple[Act, str] | None:
    """Recognise a halt or cancel at the start of an utterance: "Stop! The car…", "cancel and …".

    Returns:
        The act and the remainder, verbatim; None if it begins with neither, or nothing follows. The
        remainder must follow punctuation, "and" or "then", or be a command: "never mind the cone"
        is no such utterance.
    """
    if not isinstance(text, str) or len(text) > MAX_HALTING_CHARACTERS:
        return None
    spans = words_of(text)
    words = [word for word, _, _ in spans]
    for size in range(len(words) - 1, 0, -1):
        start = spans[size][1]
        between = text[spans[size - 1][2] : start].replace("-", "")
        is_split = words[size - 1] in ("and", "then") or words[size] in _table()["onward"]
        acts = _acts_in(words[:size]) if is_split or _BREAK.search(between) else None
        if acts and (act := min(acts, key=list(Act).index)) != Act.RESUME:
            return act, text[start:]
    return None


def alarm_in(text: str, is_object: Callable[[str], bool]) -> str | None:
    """Find a reason for a moving robot to halt in an utterance that was not understood.

    It contains a word that halts, warns or mentions harm; or begins like a denial or a correction;
    or forbids something without naming a known object to avoid. A verb that halts is ignored if it
    is negated ("never stop"), or belongs to a command with a known object ("go to the cone and
    stop").

    Args:
        text: the refused utterance.
        is_object: whether an expression of one or more words names a known object.

    Returns:
        The reason, for people: "'careful' may ask to halt"; None if there is none.
    """
    parts = [[_correct(word) for word in part] for part in _parts(text, MAX_CHARACTERS)]
    tagged = " . ".join(" ".join(_tag(part, is_object)) for part in parts)
    unbound = _BOUND.sub("", tagged)
    has_command = -1 < _FORBIDDEN.sub("", tagged).find("go:") < tagged.rfind(" object:")
    if has_command:  # "go carefully to the cone"
        unbound = re.sub(r"manner:\S+", "", unbound)
    if match := re.search(r"(?:verb|warning|manner):(\S+)", unbound):
        return f"'{match[1].replace('_', ' ')}' may ask to halt"
    table, max_words = _alarms()
    prefixes = (tuple(parts[0][:size]) for size in range(max_words, 0, -1)) if parts else ()
    if match := next((words for words in prefixes if words in table["denial"]), None):
        return f"'{' '.join(match)}' may begin a correction"
    if "object:" not in tagged and (match := re.search(r"not:(\S+)", unbound)):
        return f"'{match[1].replace('_', ' ')}' may forbid what is being done"
    return None


_BOUND = re.compile(
    r"not:(?!no )\S+ (?:verb|manner):\S+"  # never stop; but "no stop"
    r"|verb:\S+ (?:place:\S+ )+object:\S+"  # stop next to the cone
    r"|verb:\S+ (?::there )?when:\S+ (?:\w*:\S+ ){1,4}?(?:object:\S+|:there)"  # once you are there
    r"|object:\S+(?: \.)?(?: and:\S+)+ verb:\S+(?: :there| :here)?(?= \.|$)"  # … and stop
)
"""Patterns of halting verbs that do not halt now, over words tagged as ``class:word``."""
_FORBIDDEN = re.compile(r"not:\S+ go:\S+")


def _tag(words: list[str], is_object: Callable[[str], bool]) -> Iterator[str]:
    """Tag the longest known expressions of a part with their class, as ``verb:hang_on``."""
    table, max_words = _alarms()
    classes = [tag for tag in table if tag != "denial"]
    start = 0
    while start < len(words):
        for size in range(min(max_words, len(words) - start), 0, -1):
            expression = tuple(words[start : start + size])
            is_known = is_object(" ".join(expression))
            tag = "object" if is_known else next((k for k in classes if expression in table[k]), "")
            if tag or size == 1:
                yield f"{tag}:{'_'.join(expression)}"
                start += size
                break


def halts_alone(words: str) -> bool:
    """Check whether an expression alone halts: "hold on"; but not "park", also a place."""
    return act_of(words) is Act.HALT and words != "park"


def _parts(text: str, limit: int = MAX_HALTING_CHARACTERS) -> list[list[str]]:
    """Split an utterance at punctuation into lists of words; empty if too long, or no string."""
    if not isinstance(text, str) or len(text) > limit:
        return []
    plain = APOSTROPHES.sub("", normalize(text)).replace("-", " ").replace("_", " ")
    return [part.split() for part in _BREAK.split(plain) if part.strip()]


def _acts_in(words: list[str]) -> frozenset[Act] | None:
    """Segment a part into wordings of the table: all acts of all readings; None if it has none."""
    wordings, max_words = _wordings()
    words = [_correct(word) for word in words]
    acts: dict[int, frozenset[Act]] = {0: frozenset()}  # by the number of words read
    for end in range(1, len(words) + 1):
        for start in range(max(0, end - max_words), end):
            act = wordings.get(tuple(words[start:end]))
            if act is not None and start in acts:
                acts[end] = acts.get(end, frozenset()) | acts[start] | act
    return acts.get(len(words))


def _correct(word: str) -> str:
    """Correct a misspelled halting word: letters swapped or repeated, or a vowel missing."""
    # Halting wrongly costs least, so "stoop" is read as "stop" too.
    known, typos = _misspellings()
    return word if word in known else typos.get(word) or typos.get(_REPEATS.sub(r"\1", word), word)


@cache
def _misspellings() -> tuple[frozenset[str], dict[str, str]]:
    """Collect the words of all wordings, and misspellings of halting words → their correction."""
    wordings, _ = _wordings()
    known = frozenset(word for words in wordings for word in words)
    typos: dict[str, str] = {}
    halts = [words[0] for words, act in wordings.items() if act == {Act.HALT} and len(words) == 1]
    for word in (word for word in halts if len(word) >= _MIN_LETTERS):
        typos[_REPEATS.sub(r"\1", word)] = word
        for i in range(1, len(word)):
            if word[i] in "aeiou":
                typos[word[:i] + word[i + 1 :]] = word
        for i in range(len(word) - 1):
            typos[word[:i] + word[i + 1] + word[i] + word[i + 2 :]] = word
    return known, typos


@cache
def _alarms() -> tuple[dict[str, set[tuple[str, ...]]], int]:
    """Load the alarm expressions by class, and the length of the longest in words."""
    rows = _table()["alarm"].items()
    table = {name: {tuple(entry.split()) for entry in row} for name, row in rows}
    # Inflect verbs: with s, ed and ing, with the last letter doubled or dropped before them.
    for words in (table["verb"], table["manner"], table["warning"]):
        for (word,) in [entry for entry in words if len(entry) == 1]:
            stems = (word, word + word[-1], word.removesuffix("e"))
            words |= {(stem + end,) for stem in stems for end in ("s", "ed", "ing")}
    return table, max(len(words) for entry in table.values() for words in entry)


@cache
def _table() -> dict[str, Any]:
    return parse_toml(read_shipped("language", "halting.toml"))


@cache
def _wordings() -> tuple[dict[tuple[str, ...], frozenset[Act]], int]:
    """Load the wordings with their act, none for polite words, and the maximum length."""
    table = _table()
    acts = {tuple(wording.split()): frozenset[Act]() for wording in table["around"]}
    for act in Act:
        acts |= {tuple(wording.split()): frozenset({act}) for wording in table[act]}
    return acts, max(map(len, acts))
