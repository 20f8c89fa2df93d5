"""Wordings that are read as other wordings, before the grammar sees the sentence (section 3.1).

"Keep going until you reach the cone" asks for what "go to the cone" asks for. So that one meaning
has one tree, and nothing has to be trained anew, such wordings are put into the words of the
controlled language first. The rules stand in ``data/rewrites.toml``; what they change is reported.
"""

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from itertools import zip_longest

from jaxlangnav.language.tokens import MARKS, SpokenToken

_MOST_TIMES = 6
"""How often one rule applies to one sentence; a rule that feeds itself stops there."""
_SET = re.compile(r"<([A-Z]+)>")
_SPLIT_CONTRACTION = re.compile(r"\b([^\W\d_]+) ('(?:s|d|m|ll|re|ve|t)\b)")
_SPLIT_NEGATION = re.compile(r"\b(do|does|did|ca|wo|is|are|was|could|would|should|must) (n't\b)")


@dataclass(frozen=True)
class Rule:
    """One way to say something, and how it is read."""

    said: re.Pattern[str]
    read: tuple[str, ...]  # words, and "\\1" for what a group has matched


@dataclass(frozen=True)
class Rewrites:
    """The contents of ``rewrites.toml``."""

    slips: dict[str, str]
    rules: tuple[Rule, ...]


def read_rewrites(text: str) -> Rewrites:
    """Read rules from a text in TOML; the head of ``rewrites.toml`` describes the format."""
    document, sets = tomllib.loads(text), {}

    def whole(pattern: str) -> str:
        return _SET.sub(lambda match: f"(?:{sets[match[1]]})", pattern)

    for name, pattern in document["sets"].items():
        sets[name] = whole(pattern)
    rules = tuple(
        Rule(
            # Whole words: a match begins and ends between two of them.
            re.compile(rf"(?:^|(?<= )|(?= ))(?:{whole(one['said'])})(?:(?= |$)|(?<= ))"),
            tuple(one["read"].split()),
        )
        for one in document["rules"]
    )
    return Rewrites(slips=document.get("slips", {}), rules=rules)


@cache
def load_rewrites() -> Rewrites:
    """Read the rules of the package; the same object at every call."""
    file = resources.files("jaxlangnav.language").joinpath("data/rewrites.toml")
    return read_rewrites(file.read_text("utf-8"))


def join_contractions(text: str) -> str:
    """Put contractions together that a tokenizer has parted: "let 's", "do n't".

    Args:
        text: in small letters, with plain apostrophes.

    Returns:
        The text.
    """
    return _SPLIT_NEGATION.sub(r"\1\2", _SPLIT_CONTRACTION.sub(r"\1\2", text))


def rewrite(tokens: Sequence[SpokenToken]) -> tuple[list[SpokenToken], list[tuple[str, str]]]:
    """Put a sentence into wordings that the grammar reads.

    Args:
        tokens: words and marks, typing errors repaired.

    Returns:
        Words and marks, each at the position of a word that it stands for; and what has been read
        as what, in the order of the rules.
    """
    left, changes = apply_rules(load_rewrites().rules, tokens)
    return _without_idle_marks(left), changes


def apply_rules(
    rules: Sequence[Rule], tokens: Sequence[SpokenToken]
) -> tuple[list[SpokenToken], list[tuple[str, str]]]:
    """Apply rules to a sentence, one after the other.

    Args:
        rules: in the order in which they apply.
        tokens: words and marks.

    Returns:
        As ``rewrite``.
    """
    left, changes = list(tokens), []
    for rule in rules:
        for _ in range(_MOST_TIMES):
            text = " ".join(token.text for token in left)
            match = rule.said.search(text)
            if match is None:
                break
            first, last = _indices(text, *match.span())
            put = _filled(rule, match, text, left, first, last)
            was, now = ([token.text for token in part] for part in (left[first:last], put))
            if was == now:
                break
            changes.append((" ".join(was), " ".join(now)))
            left[first:last] = put
    return left, changes


def _without_idle_marks(tokens: list[SpokenToken]) -> list[SpokenToken]:
    """Leave out marks at both ends, and all but the last of a run of them."""
    kept = [
        token
        for token, later in zip_longest(tokens, tokens[1:])
        if token.text not in MARKS or (later is not None and later.text not in MARKS)
    ]
    return kept[1:] if kept and kept[0].text in MARKS else kept


def _indices(text: str, begin: int, end: int) -> tuple[int, int]:
    """Find which words a span of the text holds: first, and one after the last."""
    before = len(text[:begin].split())
    return before, before + len(text[begin:end].split())


def _filled(
    rule: Rule, match: re.Match[str], text: str, tokens: list[SpokenToken], first: int, last: int
) -> list[SpokenToken]:
    """Build what a rule puts in the place of what it matched."""
    put: list[SpokenToken] = []
    for word in rule.read:
        if word.startswith("\\"):
            number = int(word[1:])
            if match[number]:
                low, high = _indices(text, *match.span(number))
                put += tokens[low:high]
            continue
        # New words stand where the words were that they are read for, in order.
        position = tokens[first].position if first < len(tokens) else tokens[-1].position
        if put:
            position = min(put[-1].position + 1, tokens[last - 1].position)
        put.append(SpokenToken(text=word, position=position))
    return put
