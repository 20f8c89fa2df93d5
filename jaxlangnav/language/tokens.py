"""How a text falls into tokens: words, numbers and marks, written plainly (section 3.1)."""

import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass

TOKEN = re.compile(
    r"[^\W\d_]+(?:['-][^\W\d_]+)*|\d+(?:st|nd|rd|th)\b|\d+(?:\.\d+)?[^\W\d_]*|[.!?;]+|[,:]|\S"
)
"""One token: a word (with hyphens and apostrophes inside), a number, a run of marks, a sign."""

MARKS = (COMMA_MARK, FULLSTOP_MARK) = (",", ".")
"""How a pause and an end of a sentence are written among the words."""
_WORD = re.compile(r"[^\W_]+(?:['\u2018\u2019`][^\W_]+)*")
_APOSTROPHES = re.compile(r"['\u2018\u2019`]")
_SPLIT_CONTRACTION = re.compile(r"\b([^\W\d_]+) ('(?:s|d|m|ll|re|ve|t)\b)")
_SPLIT_NEGATION = re.compile(r"\b(do|does|did|ca|wo|is|are|was|could|would|should|must) (n't\b)")


@dataclass(frozen=True, kw_only=True)
class SpokenToken:
    """One word or mark of a sentence, before it is known what it can be."""

    text: str  # small letters, typing errors repaired; or one of ``MARKS``
    position: int  # 1-based, of words; marks have the position of the word before


def plainly(text: str) -> str:
    """Write letters plainly: small, without ligatures, full width or marks that nobody sees.

    Some signs stand for whole words, so the result may be longer.
    """
    text = unicodedata.normalize("NFKC", text).lower()
    text = "".join(letter for letter in text if unicodedata.category(letter) != "Cf")
    return text.replace("\u2019", "'").replace("\u2018", "'")


def words_of(text: str) -> list[tuple[str, int, int]]:
    """Find the words of a text, plain and without apostrophes, and where each begins and ends."""
    found = _WORD.finditer(text)
    return [(_APOSTROPHES.sub("", plainly(one[0])), one.start(), one.end()) for one in found]


def join_contractions(text: str) -> str:
    """Put contractions together that a tokenizer has parted: "let 's", "do n't"."""
    return _SPLIT_NEGATION.sub(r"\1\2", _SPLIT_CONTRACTION.sub(r"\1\2", text))


def is_word(text: str) -> bool:
    """Tell whether a text, written plainly, is read as one word."""
    return text[:1].isalnum() and TOKEN.fullmatch(text) is not None and not text.endswith("'s")


def without_idle_marks(tokens: Iterable[SpokenToken]) -> list[SpokenToken]:
    """Leave out marks at both ends, and all but the last of a run of them."""
    found: list[SpokenToken] = []
    for token in tokens:
        if token.text in MARKS and found and found[-1].text in MARKS:
            found.pop()
        if found or token.text not in MARKS:
            found.append(token)
    return found[:-1] if found and found[-1].text in MARKS else found
