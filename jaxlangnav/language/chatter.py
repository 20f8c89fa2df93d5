"""What people say beside a command: small talk, reasons, thanks (section 3.1).

"Go to the car, my friend is waiting. I left my keys there." Such parts are left out where nothing
in them can tell what to do or which thing is meant: no known thing, no relation, no order, nobody
addressed. Whatever is left out is reported, and what is not surely small talk stays and is read,
or refused, with the rest. The words that decide stand in ``data/chatter.toml``.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from importlib import resources

from jaxlangnav.language.lexicon import TYPE_CLASS, load_lexicon
from jaxlangnav.language.tokens import MARKS, SpokenToken

_Part = list[SpokenToken]


@cache
def chatter_words() -> dict[str, frozenset[str]]:
    """Read the lists of words, by their names in ``chatter.toml``."""
    text = resources.files("jaxlangnav.language").joinpath("data/chatter.toml").read_text("utf-8")
    return {name: frozenset(words) for name, words in tomllib.loads(text).items()}


def _names_thing(words: Sequence[str]) -> bool:
    """Tell whether a known thing is named: "fire hydrant", and not "fire"."""
    names = load_lexicon().entries[TYPE_CLASS]
    longest = max(len(name) for name in names)
    return any(
        tuple(words[index : index + size]) in names
        for index in range(len(words))
        for size in range(1, longest + 1)
    )


def leave_out(tokens: Sequence[SpokenToken]) -> tuple[list[SpokenToken], list[str]]:
    """Leave small talk and reasons out of a sentence.

    Args:
        tokens: words and marks.

    Returns:
        What is left to be read, all of it where nothing would be; and what has been left out.
    """
    parts = _parts(_parted_at_so(tokens))
    kept: list[SpokenToken] = []
    dropped: list[str] = []
    for index, (part, mark) in enumerate(parts):
        later = {token.text for other, _ in parts[index + 1 :] for token in other}
        rest, reason = _without_reason(part)
        if _is_small_talk(part) and not later & chatter_words()["referring"]:
            dropped.append(_text(part))
            if kept and kept[-1].text == "," and mark is not None:
                kept[-1] = mark
            continue
        if reason:
            dropped.append(_text(reason))
        kept += rest
        if mark is not None:
            kept.append(mark)
    while kept and kept[-1].text in MARKS:
        kept.pop()
    return (kept, dropped) if kept else (list(tokens), [])


def _parted_at_so(tokens: Sequence[SpokenToken]) -> list[SpokenToken]:
    """Put a mark in the place of "so" after small talk: "my friend is waiting so go to the car"."""
    parted = list(tokens)
    for index, token in enumerate(tokens):
        begin = max((i + 1 for i in range(index) if parted[i].text in MARKS), default=0)
        if token.text == "so" and _is_small_talk(parted[begin:index]):
            parted[index] = replace(token, text=MARKS[0])
    return parted


def _text(part: _Part) -> str:
    return " ".join(token.text for token in part)


def _parts(tokens: Sequence[SpokenToken]) -> list[tuple[_Part, SpokenToken | None]]:
    """Split a sentence at its marks; each part with the mark behind it."""
    parts: list[tuple[_Part, SpokenToken | None]] = []
    part: _Part = []
    for token in tokens:
        if token.text in MARKS:
            parts.append((part, token))
            part = []
        else:
            part.append(token)
    return [*parts, (part, None)] if part else parts


def _tells(words: Sequence[str]) -> bool:
    """Tell whether words could say what to do or which thing is meant."""
    if _names_thing(words) or chatter_words()["telling"].intersection(words):
        return True
    # "I left my keys": a verb there, and a side nearly everywhere else.
    return any(
        word in ("left", "right")
        and (index == 0 or words[index - 1] not in chatter_words()["people"])
        for index, word in enumerate(words)
    )


def _is_of_grammar(words: Sequence[str]) -> bool:
    """Tell whether the grammar itself reads words after a command: "please", "thank you"."""
    return tuple(words) in load_lexicon().entries["closer"]


def _is_small_talk(part: _Part) -> bool:
    """Tell whether a part of a sentence is about something else."""
    words, lists = [token.text for token in part], chatter_words()
    if not words or _tells(words) or _is_of_grammar(words):
        return False
    if lists["praise"].issuperset(words) and lists["praising"].intersection(words):
        return True
    if _text(part) in lists["greetings"]:
        return True
    for opening in sorted(lists["weather_openings"], key=len, reverse=True):
        rest = words[len(opening.split()) :]
        if words[: len(opening.split())] == opening.split() and rest:
            return lists["weather"].issuperset(rest) or (
                rest[0] == "where" and not lists["wishing"].intersection(rest)
            )
    return words[0] in lists["openings"] and not lists["wishing"].intersection(words)


def _without_reason(part: _Part) -> tuple[_Part, _Part]:
    """_Part a command from the reason that follows it: "because it's shady", "so I can rest"."""
    words, lists = [token.text for token in part], chatter_words()
    for index in range(2, len(words) - 1):
        is_because = words[index] in lists["because"]
        is_so = words[index] == "so" and words[index + 1] in (*lists["people"], "that")
        reason = words[index + 1 :]
        if (is_because or is_so) and not _tells(reason) and "you" not in reason:
            return part[:index], part[index:]
    return part, []
