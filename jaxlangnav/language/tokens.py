"""Tokenization of a text into words, numbers and punctuation marks, normalized (section 3.1)."""

import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass

MAX_CHARACTERS = 10_000
"""Length limit of an instruction."""
TOKEN = re.compile(
    r"[^\W\d_]+(?:['-][^\W\d_]+)*|\d+(?:st|nd|rd|th)\b|(?:(?<!\S)[-–])?\d+(?:\.\d+)?[^\W\d_]*"
    r"|[.!?;]+|[,:]|\S"
)
"""One token: a word (with hyphens and apostrophes inside), a number, a run of marks, a sign."""

MARKS = (COMMA_MARK, FULLSTOP_MARK) = (",", ".")
"""Tokens of a pause and of the end of a sentence."""
_WORD = re.compile(r"[^\W_]+(?:['\u2018\u2019`][^\W_]+)*")
APOSTROPHES = re.compile(r"['\u2018\u2019`]")
_SPLIT_CONTRACTION = re.compile(r"\b([^\W\d_]+) ('(?:s|d|m|ll|re|ve|t)\b)")
_SPLIT_NEGATION = re.compile(r"\b(do|does|did|ca|wo|is|are|was|could|would|should|must) (n't\b)")


@dataclass(frozen=True, kw_only=True)
class RawToken:
    """A word or mark of a sentence, before lookup in the lexicon."""

    text: str  # lower case, spelling corrected; or one of ``MARKS``
    position: int  # 1-based word index; marks have that of the word before


def normalize(text: str) -> str:
    """Normalize a text: NFKC, lower case, plain apostrophes, no invisible format characters.

    NFKC expands some signs, so the result may be longer. "45º" has degrees, not an ordinal.
    """
    text = unicodedata.normalize("NFKC", text.replace("\u00ba", "\u00b0")).lower()
    text = "".join(letter for letter in text if unicodedata.category(letter) != "Cf")
    return text.replace("\u2019", "'").replace("\u2018", "'")


def words_of(text: str) -> list[tuple[str, int, int]]:
    """Find the words of a text, normalized, without apostrophes: (word, start, end) of each."""
    matches = _WORD.finditer(text)
    return [(APOSTROPHES.sub("", normalize(m[0])), m.start(), m.end()) for m in matches]


def join_contractions(text: str) -> str:
    """Join contractions that a tokenizer has split: "let 's", "do n't"."""
    return _SPLIT_NEGATION.sub(r"\1\2", _SPLIT_CONTRACTION.sub(r"\1\2", text))


def is_word(text: str) -> bool:
    """Check whether a normalized text is a single word token."""
    return text[:1].isalnum() and TOKEN.fullmatch(text) is not None and not text.endswith("'s")


def strip_marks(tokens: Iterable[RawToken]) -> list[RawToken]:
    """Remove marks at both ends, and all but the last of consecutive marks."""
    stripped: list[RawToken] = []
    for token in tokens:
        if token.text in MARKS and stripped and stripped[-1].text in MARKS:
            stripped.pop()
        if stripped or token.text not in MARKS:
            stripped.append(token)
    return stripped[:-1] if stripped and stripped[-1].text in MARKS else stripped
