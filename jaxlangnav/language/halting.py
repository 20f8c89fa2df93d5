"""Utterances that act by themselves, before any parser or model: halt, resume, cancel.

A robot that is told to stop must stop, whatever else it understands. So the few utterances that
mean nothing but that are known as whole wordings (``data/halting.toml``): politeness, vocatives,
punctuation and repetition are taken off, and what is left is looked up. "Stop behind the cone" is
no such wording and stays a command. Words to halt are known mistyped too, as people in haste type.
"""

import enum
import re
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

from jaxlangnav.inputs.documents import parse_toml, read_shipped
from jaxlangnav.language.tokens import plainly, words_of

MAX_HALTING_CHARACTERS = 400
"""Longer utterances are never mere halting words."""
_MAX_ALARM_CHARACTERS = 10_000
"""Longer utterances are no sentences (``language.parser``)."""
_KINDS = ("verb", "manner", "warning", "not", "denial", "place", "when", "and", "go")
_BREAK = re.compile(r"[^\w\s]+")
_APOSTROPHES = re.compile(r"['\u2018\u2019`]")
_RUN = re.compile(r"(.)\1+")
_VOWELS = "aeiou"
_LEAST_MISTYPED = 4
"""Letters of the shortest word to halt that is known mistyped."""


class Act(enum.StrEnum):
    """What an utterance does by itself."""

    HALT = "halt"  # stand still, keep the task
    RESUME = "resume"  # go on with the task after a halt
    CANCEL = "cancel"  # stand still and drop the task


def act_of(text: str) -> Act | None:
    """Tell whether an utterance is nothing but words to halt, resume or cancel.

    Returns:
        The act; None where the utterance says anything else, or is no text. Where parts of it ask
        for different acts ("stop! never mind, go on"), halting wins over cancelling, and both over
        going on.
    """
    if not isinstance(text, str):
        return None
    found = [_urgencies(part) for part in _parts(text)]
    told = [urgency for part in found for urgency in part or ()]
    return None if None in found or not told else _URGENCY[min(told)]


def opening_of(text: str) -> tuple[Act, str] | None:
    """Tell what an utterance begins with that acts by itself: "Stop! The car…", "cancel and …".

    Returns:
        To halt or to cancel, and what follows, as it was said; None where it begins with neither,
        or nothing follows. What follows is parted off by punctuation, by "and" or "then", or is a
        command: "never mind the cone" begins with nothing of the kind.
    """
    if not isinstance(text, str) or len(text) > MAX_HALTING_CHARACTERS:
        return None
    found = words_of(text)
    words = [word for word, _, _ in found]
    for size in range(len(words) - 1, 0, -1):
        start = found[size][1]
        between = text[found[size - 1][2] : start].replace("-", "")
        is_parted = words[size - 1] in _PARTING or words[size] in _table()["onward"]
        told = _urgencies(words[:size]) if is_parted or _BREAK.search(between) else None
        if told and _URGENCY[told[0]] != Act.RESUME:
            return _URGENCY[told[0]], text[start:]
    return None


def alarm_in(text: str, is_object: Callable[[str], bool]) -> str | None:
    """Tell why an utterance that is not understood has to halt a robot under way.

    It holds a word that halts, warns or tells of harm; or it begins as a denial or a correction
    does; or it forbids something, and names nothing known that could be kept away from. A verb that
    halts does not count where it is denied ("never stop"), or a command binds it to a known object
    ("go to the cone and stop").

    Args:
        text: what was said, and refused.
        is_object: whether one to three words name an object that is known.

    Returns:
        Why, to be told: "'careful' may ask to halt"; None where nothing in it is alarming.
    """
    parts = [[_repaired(word) for word in part] for part in _parts(text, _MAX_ALARM_CHARACTERS)]
    line = " . ".join(" ".join(_marked(part, is_object)) for part in parts)
    free = _BOUND.sub("", line)
    if -1 < _FORBIDDEN.sub("", line).find("go:") < line.rfind(" object:"):  # a command
        free = re.sub(r"manner:\S+", "", free)
    if found := re.search(r"(?:verb|warning|manner):(\S+)", free):
        return f"'{found[1].replace('_', ' ')}' may ask to halt"
    table, longest = _alarms()
    opening = (tuple(parts[0][:size]) for size in range(longest, 0, -1)) if parts else ()
    if found := next((words for words in opening if words in table["denial"]), None):
        return f"'{' '.join(found)}' may begin a correction"
    if "object:" not in line and (found := re.search(r"not:(\S+)", free)):
        return f"'{found[1].replace('_', ' ')}' may forbid what is being done"
    return None


_BOUND = re.compile(
    r"not:(?!no )\S+ (?:verb|manner):\S+"  # never stop; but "no stop"
    r"|verb:\S+ (?:place:\S+ )+object:\S+"  # stop next to the cone
    r"|verb:\S+ (?::there )?when:\S+ (?:\w*:\S+ ){1,4}?(?:object:\S+|:there)"  # once you are there
    r"|object:\S+(?: \.)?(?: and:\S+)+ verb:\S+(?: :there| :here)?(?= \.|$)"  # … and stop
)
"""Verbs that halt, but not now: each word of a line stands behind what it is and a colon."""


_FORBIDDEN = re.compile(r"not:\S+ go:\S+")


def _marked(words: list[str], is_object: Callable[[str], bool]) -> Iterator[str]:
    """Write the longest expressions of a part behind what they are, as ``verb:hang_on``."""
    table, longest = _alarms()
    kinds = [kind for kind in table if kind != "denial"]
    start = 0
    while start < len(words):
        for size in range(min(longest, len(words) - start), 0, -1):
            piece = tuple(words[start : start + size])
            is_thing = is_object(" ".join(piece))
            kind = "object" if is_thing else next((k for k in kinds if piece in table[k]), "")
            if kind or size == 1:
                yield f"{kind}:{'_'.join(piece)}"
                start += size
                break


def halts_alone(words: str) -> bool:
    """Tell whether an expression halts by itself: "hold on"; but not "park", a place too."""
    return act_of(words) is Act.HALT and words != "park"


_URGENCY = (Act.HALT, Act.CANCEL, Act.RESUME)
_PARTING = frozenset({"and", "then"})


def _parts(text: str, most: int = MAX_HALTING_CHARACTERS) -> list[list[str]]:
    """Split an utterance at punctuation into words without apostrophes; none if it is too long."""
    if len(text) > most:
        return []
    plain = _APOSTROPHES.sub("", plainly(text)).replace("-", " ").replace("_", " ")
    return [part.split() for part in _BREAK.split(plain) if part.strip()]


def _urgencies(words: list[str]) -> tuple[int, ...] | None:
    """Read a part as a row of wordings: its most urgent reading, by places in ``_URGENCY``."""
    wordings, longest = _wordings()
    words = [_repaired(word) for word in words]
    best: dict[int, tuple[int, ...]] = {0: ()}
    for end in range(1, len(words) + 1):
        for start in range(max(0, end - longest), end):
            told = wordings.get(tuple(words[start:end]))
            if told is not None and start in best:
                way = tuple(sorted({*best[start], *told}))
                # Mere politeness comes last.
                best[end] = min(best.get(end, way), way, key=lambda one: one or (len(_URGENCY),))
    return best.get(len(words))


def _repaired(word: str) -> str:
    """Undo a slip in a word to halt: two letters exchanged, one held down, a vowel left out."""
    # The least is lost by standing still, so that "stoop" too is taken for "stop".
    known, slips = _mistyped()
    return word if word in known else slips.get(word) or slips.get(_RUN.sub(r"\1", word), word)


@cache
def _mistyped() -> tuple[frozenset[str], dict[str, str]]:
    """Collect the words of all wordings, and those to halt by how they may be mistyped."""
    wordings, _ = _wordings()
    known = frozenset(word for words in wordings for word in words)
    slips: dict[str, str] = {}
    halt = (_URGENCY.index(Act.HALT),)
    halts = [words[0] for words, told in wordings.items() if told == halt and len(words) == 1]
    for word in (one for one in halts if len(one) >= _LEAST_MISTYPED):
        slips[_RUN.sub(r"\1", word)] = word
        for place in range(1, len(word)):
            if word[place] in _VOWELS:
                slips[word[:place] + word[place + 1 :]] = word
        for place in range(len(word) - 1):
            slips[word[:place] + word[place + 1] + word[place] + word[place + 2 :]] = word
    return known, slips


@cache
def _alarms() -> tuple[dict[str, set[tuple[str, ...]]], int]:
    """Read the words by which what is not understood halts, and the number of the longest."""
    table = {kind: {tuple(one.split()) for one in _table()["alarm"][kind]} for kind in _KINDS}
    # In all forms of verbs: with s, ed and ing, the last letter doubled or left out before them.
    for words in (table["verb"], table["manner"], table["warning"]):
        for (word,) in [one for one in words if len(one) == 1]:
            stems = (word, word + word[-1], word.removesuffix("e"))
            words |= {(stem + end,) for stem in stems for end in ("s", "ed", "ing")}
    return table, max(len(words) for one in table.values() for words in one)


@cache
def _table() -> dict[str, Any]:
    return parse_toml(read_shipped("language", "halting.toml"))


@cache
def _wordings() -> tuple[dict[tuple[str, ...], tuple[int, ...]], int]:
    """Read the wordings with their urgency, none of what is said around them; and the longest."""
    table = _table()
    found: dict[tuple[str, ...], tuple[int, ...]] = {tuple(w.split()): () for w in table["around"]}
    for act in Act:
        found |= {tuple(wording.split()): (_URGENCY.index(act),) for wording in table[act]}
    return found, max(map(len, found))
