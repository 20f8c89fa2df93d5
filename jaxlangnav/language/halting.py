"""Utterances that act by themselves, before any parser or model: halt, resume, cancel.

A robot that is told to stop must stop, whatever else it understands. So the few utterances that
mean nothing but that are known as whole wordings (``data/halting.toml``): politeness, vocatives,
punctuation and repetition are taken off, and what is left is looked up. "Stop behind the cone" is
no such wording and stays a command.
"""

import enum
import re
import tomllib
import unicodedata
from functools import cache
from importlib import resources

MAX_HALTING_CHARACTERS = 400
"""Longer utterances are never mere halting words."""
_BREAK = re.compile(r"[^\w\s]+")


class Act(enum.StrEnum):
    """What an utterance does by itself."""

    HALT = "halt"  # stand still, keep the task
    RESUME = "resume"  # go on with the task after a halt
    CANCEL = "cancel"  # stand still and drop the task


def act_of(text: str) -> Act | None:
    """Tell whether an utterance is nothing but words to halt, resume or cancel.

    Args:
        text: what the person said.

    Returns:
        The act; None where the utterance says anything else. Where parts of it ask for different
        acts ("stop! never mind, go on"), halting wins over cancelling, and both over going on.
        None too for what is no text, which the parser refuses.
    """
    if not isinstance(text, str):
        return None
    found = [_act_of_part(part) for part in _parts(text)]
    if None in found:
        return None
    acts = [act for part in found for act in part or ()]
    return min(acts, key=_URGENCY.index, default=None)


def begins_with_halt(text: str) -> bool:
    """Tell whether an utterance begins with a whole sentence that means halt ("Stop! The car…").

    Args:
        text: what the person said.

    Returns:
        True if the first part, up to punctuation, is a word to halt.
    """
    parts = _parts(text[:MAX_HALTING_CHARACTERS]) if isinstance(text, str) else []
    return bool(parts) and Act.HALT in (_act_of_part(parts[0]) or ())


_URGENCY = (Act.HALT, Act.CANCEL, Act.RESUME)


def _parts(text: str) -> list[list[str]]:
    """Split an utterance at punctuation into words without apostrophes; none if it is too long."""
    if len(text) > MAX_HALTING_CHARACTERS:
        return []
    plain = unicodedata.normalize("NFKC", text).lower()
    plain = "".join(letter for letter in plain if unicodedata.category(letter) != "Cf")
    plain = re.sub(r"['\u2018\u2019`]", "", plain).replace("-", " ").replace("_", " ")
    return [part.split() for part in _BREAK.split(plain) if part.strip()]


def _act_of_part(words: list[str]) -> frozenset[Act] | None:
    """Read a part as a row of wordings, with what is said around them in between.

    Returns:
        The acts of the reading that has the most urgent one, none where all of it is politeness;
        None where there is no such reading.
    """
    wordings, around, longest = _wordings()
    best: list[frozenset[Act] | None] = [frozenset()] + [None] * len(words)
    for end in range(1, len(words) + 1):
        for start in range(max(0, end - longest), end):
            piece, before = tuple(words[start:end]), best[start]
            if before is None or (piece not in wordings and piece not in around):
                continue
            acts = before | ({wordings[piece]} if piece in wordings else set())
            best[end] = min((one for one in (best[end], acts) if one is not None), key=_urgency)
    return best[-1]


def _urgency(acts: frozenset[Act]) -> tuple[int, ...]:
    """Rank a reading: that of the most urgent act first, mere politeness last."""
    return tuple(sorted(_URGENCY.index(act) for act in acts)) or (len(_URGENCY),)


@cache
def _wordings() -> tuple[dict[tuple[str, ...], Act], frozenset[tuple[str, ...]], int]:
    """Read the wordings, what is said around them, and the length of the longest in words."""
    text = resources.files("jaxlangnav.language").joinpath("data/halting.toml").read_text("utf-8")
    table = tomllib.loads(text)
    wordings = {tuple(wording.split()): act for act in Act for wording in table[act]}
    around = frozenset(tuple(wording.split()) for wording in table["around"])
    return wordings, around, max(len(words) for words in (*wordings, *around))
