"""Repair of typing errors: one edit or transposition, in words of five letters and more.

A word that is itself English is left alone: "beach" is not "bench". ``data/not_errors.txt`` lists
the English words within one edit of a word of the lexicon.
"""

from functools import cache
from string import ascii_lowercase

from jaxlangnav.inputs.documents import read_shipped
from jaxlangnav.language.lexicon import WORDS, load_lexicon

MIN_LETTERS, _MAX_LETTERS = 5, 20


def edits(word: str) -> set[str]:
    """List all strings at Damerau-Levenshtein distance one over a-z, and the word itself."""
    parts = [(word[:cut], word[cut:]) for cut in range(len(word) + 1)]
    found = {a + b[1:] for a, b in parts if b}
    found |= {a + b[1] + b[0] + b[2:] for a, b in parts if len(b) > 1}
    found |= {a + letter + b[1:] for a, b in parts if b for letter in ascii_lowercase}
    found |= {a + letter + b for a, b in parts for letter in ascii_lowercase}
    return found


@cache
def repairable() -> frozenset[str]:
    """Collect the words of the lexicon that typing errors are repaired to."""
    lexicon = load_lexicon()
    classes = [
        entries for name, entries in lexicon.entries.items() if name not in WORDS["small_talk"]
    ]
    words = {word for entries in classes for key in entries for word in key}
    return frozenset(words | set(lexicon.refused) | WORDS["courtesies"])


@cache
def not_errors() -> frozenset[str]:
    """Read the English words that look like typing errors but are none."""
    lines = read_shipped("language", "not_errors.txt").splitlines()
    return frozenset(line.strip() for line in lines if line and not line.startswith("#"))


def _meanings(word: str) -> frozenset[tuple[str, tuple[str, ...]]]:
    """Collect what a word can mean alone: class and senses."""
    found = ((name, one.get((word,))) for name, one in load_lexicon().entries.items())
    return frozenset((name, entry[0].senses) for name, entry in found if entry is not None)


@cache
def _nominal() -> frozenset[str]:
    entries = load_lexicon().entries
    return frozenset(word for name in WORDS["nominal"] for key in entries[name] for word in key)


@cache
def repair(word: str, *, is_noun: bool = False) -> str | None:
    """Find the one word of the lexicon that a mistyped word must be.

    None where the word, in lower case, is short, English, hopeless, or could be any of several
    words of different meaning. ``is_noun``: it is the noun of a phrase, so that "the easel" has
    nothing to do with "ease".
    """
    lexicon = load_lexicon()
    if word in lexicon.slips:
        return lexicon.slips[word]
    is_plain = word.isascii() and word.isalpha() and word not in not_errors()
    if not (is_plain and MIN_LETTERS <= len(word) <= _MAX_LETTERS):
        return None
    allowed = repairable() & _nominal() if is_noun else repairable()
    candidates = sorted(c for c in edits(word) & allowed if len(c) >= MIN_LETTERS - 1)
    # "Carefuly" is "carefully" and not "careful", which only stands in longer expressions.
    candidates = [c for c in candidates if _meanings(c) or c in lexicon.refused] or candidates
    if len(set(map(_meanings, candidates))) > 1:
        candidates = [c for c in candidates if sorted(c) == sorted(word)]
        return candidates[0] if len(candidates) == 1 else None
    return candidates[0] if candidates else None
