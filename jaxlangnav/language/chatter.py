"""What people say beside a command: small talk, reasons, thanks (section 3.1).

"Go to the car, my friend is waiting. I left my keys there." Such parts are left out where nothing
in them can tell what to do or which thing is meant: no known thing, no relation, no order, nobody
addressed. Whatever is left out is reported, and what is not surely small talk stays and is read,
or refused, with the rest. The words that decide stand in ``data/chatter.toml``.
"""

import tomllib
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cache
from importlib import resources

from jaxlangnav.language.lexicon import REASONS, TYPE_CLASS, load_lexicon
from jaxlangnav.language.tokens import MARKS, SpokenToken

_Part = list[SpokenToken]
_UNSAID = frozenset(
    {REASONS[name] for name in ("negation", "condition", "such an action", "amends", "a turn")}
)
"""What a remark holds nothing of: it could change or add to what is to be done."""

ARTICLES = frozenset({"the", "a", "an", "that", "this"})
"""Words that begin the name of a thing."""
_ADDRESS = 3
"""Words of a part that only calls somebody."""
_VERBS = ("v_to", "v_at", "v_obj", "v_for", "v_turn", "avoid", "g_to", "g_at", "g_obj")


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


def leave_out_remarks(
    tokens: Sequence[SpokenToken], names: Collection[str] = ()
) -> tuple[list[SpokenToken], list[str]]:
    """Leave out of a refused sentence remarks on what nothing else in it speaks of.

    "The inspection is at noon. Go to the hydrant." A remark says that something is so; it can
    select nothing where no other part has one of its words or points back.

    Args:
        tokens: words and marks.
        names: of things that the detector tells apart.

    Returns:
        What is left to be read, all of it where nothing would be; and what has been left out.
    """
    parts = _parts(tokens)
    kept: list[SpokenToken] = []
    dropped: list[str] = []
    for index, (part, mark) in enumerate(parts):
        later = {token.text for other, _ in parts[index + 1 :] for token in other}
        others = {token.text for other, _ in parts if other is not part for token in other}
        is_idle = (
            _is_remark(part, others)
            or _is_aside(part, others, names)
            or _is_address(part, parts[index + 1 : index + 2], names)
        )
        if is_idle and not later & chatter_words()["referring"]:
            dropped.append(_text(part))
            continue
        kept += part if mark is None else [*part, mark]
    while kept and kept[-1].text in MARKS:
        kept.pop()
    return (kept, dropped) if kept else (list(tokens), [])


def _is_remark(part: _Part, others: Collection[str]) -> bool:
    """Tell whether a part says that something is so of which the others do not speak."""
    lists = chatter_words()
    first = next((i for i, one in enumerate(part) if one.text not in lists["leading"]), len(part))
    words = [token.text for token in part[first:]]
    if len(words) < 2 or _tells(words):
        return False
    is_doing = words[1] == "'s" and words[-1].endswith("ing")  # "driver's waiting"
    is_about_you = words[0] == "you're" and lists["wishing"].isdisjoint(words[1:])
    is_state = words[0] in lists["stating"] and not lists["wishing"].union(ARTICLES) & set(words)
    is_ours = words[0] in lists["ourselves"] or is_about_you or is_state  # what we do is no order
    if words[0] not in lists["remarking"] and not (is_ours or is_doing):
        return False
    refused = load_lexicon().refused
    unsaid = _UNSAID - {REASONS["such an action"]} if is_ours else _UNSAID
    pointing = lists["pointing"] - ({"you"} if is_about_you else set())
    if any(refused.get(word) in unsaid for word in words) or pointing & set(words):
        return False
    is_told = is_ours or words[0] in lists["exclaiming"] or lists["being"].intersection(words[1:5])
    return bool(is_told) and not (set(words) - lists["empty"]) & set(others)


def _is_aside(part: _Part, others: Collection[str], names: Collection[str]) -> bool:
    """Tell whether a part says what people do or need: "I'll be out soon", "they close at five".

    What they do is no order, so that it may hold a verb that would begin one; but nothing may
    stand in it that says where, or that names a thing the detector tells apart.
    """
    lists = chatter_words()
    first = next((i for i, one in enumerate(part) if one.text not in lists["leading"]), len(part))
    words = [token.text for token in part[first:]]
    telling = [w for i, w in enumerate(words) if i != 1 or w != "close" or "to" in words]
    if len(words) < 3 or _tells(telling) or (set(words) - lists["empty"]).intersection(others):
        return False
    need = next((i for i, word in enumerate(words[1:4], 1) if word in lists["needing"]), 0)
    named = {name.split()[-1] for name in names}
    refused = load_lexicon().refused
    unsaid = _UNSAID - {REASONS["such an action"]}
    if any(
        word in lists["aside_no"] or word in named or refused.get(word) in unsaid
        for word in words[need:]
    ):
        return False
    if need:
        return ARTICLES.isdisjoint(words[need + 1 :])
    if words[0] in lists["intending"]:
        return True
    if words[0] not in ("i", "we"):
        return False
    wished = next((w for w in lists["intentions"] if words[1:3][: len(w.split())] == w.split()), "")
    doing = words[1 + len(wished.split()) :]
    return bool(wished and doing) and not _is_verb(doing[0])


def _is_address(
    part: _Part, later: Sequence[tuple[_Part, SpokenToken | None]], names: Collection[str]
) -> bool:
    """Tell whether a part only calls somebody to what follows: "team", "unit four", "new plan"."""
    words, lexicon = [token.text for token in part], load_lexicon()
    senses = {w for name in ("adv", "det", "conn") for key in lexicon.entries[name] for w in key}
    named = {name.split()[-1] for name in names} | senses
    return (
        0 < len(words) <= _ADDRESS
        and all(word[0].isalpha() for word in words)
        and bool(later and later[0][0])
        and _is_order(later[0][0][0].text)
        and not _tells(words)
        and not named.intersection(words)
        and not any(lexicon.refused.get(word) in _UNSAID or _is_verb(word) for word in words)
    )


def _is_order(word: str) -> bool:
    """Tell whether a word begins what somebody is to do: "go", "check"."""
    return _is_verb(word) or load_lexicon().refused.get(word) == REASONS["such an action"]


def _is_verb(word: str) -> bool:
    """Tell whether a command may begin with a word."""
    entries = load_lexicon().entries
    return any((word,) in entries[name] for name in _VERBS)


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
