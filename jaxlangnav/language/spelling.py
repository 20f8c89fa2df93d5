"""Spelling correction at Damerau-Levenshtein distance one, for words of five letters or more.

A word that is itself English is left alone: "beach" is not "bench". ``data/not_errors.txt`` lists
the English words within one edit of a word of the lexicon.
"""

from functools import cache
from string import ascii_lowercase

from jaxlangnav.inputs.documents import read_shipped
from jaxlangnav.language.lexicon import WORDS, load_lexicon

MIN_LETTERS, _MAX_LETTERS = 5, 20


def edits(word: str) -> set[str]:
    """List all strings at Damerau-Levenshtein distance at most one over a-z."""
    splits = [(word[:cut], word[cut:]) for cut in range(len(word) + 1)]
    edited = {a + b[1] + b[0] + b[2:] for a, b in splits if len(b) > 1}
    edited |= {a + letter + b[1:] for a, b in splits if b for letter in ("", *ascii_lowercase)}
    edited |= {a + letter + b for a, b in splits for letter in ascii_lowercase}
    return edited


@cache
def repairable() -> frozenset[str]:
    """Collect the words of the lexicon that are candidates for corrections."""
    lexicon = load_lexicon()
    names = lexicon.entries.keys() - WORDS["small_talk"]
    words = {word for name in names for key in lexicon.entries[name] for word in key}
    return frozenset(words | set(lexicon.refused) | WORDS["courtesies"])


@cache
def not_errors() -> frozenset[str]:
    """Load the English words that look like misspellings but are not."""
    lines = read_shipped("language", "not_errors.txt").splitlines()
    return frozenset(line.strip() for line in lines if line and not line.startswith("#"))


def _meanings(word: str) -> frozenset[tuple[str, tuple[str, ...]]]:
    """Collect the readings of a single word: pairs of class and senses."""
    readings = ((name, table.get((word,))) for name, table in load_lexicon().entries.items())
    return frozenset((name, entry[0].senses) for name, entry in readings if entry is not None)


@cache
def repair(word: str, *, is_noun: bool = False) -> str | None:
    """Correct a misspelled word to the only word of the lexicon that it can be.

    None if the word, in lower case, is short, English, or has no candidate or several of different
    meaning. ``is_noun``: it is the noun of a phrase, so that "the easel" is not corrected to
    "ease".
    """
    lexicon = load_lexicon()
    if word in lexicon.typos:
        return lexicon.typos[word]
    is_plain = word.isascii() and word.isalpha() and word not in not_errors()
    if not (is_plain and MIN_LETTERS <= len(word) <= _MAX_LETTERS):
        return None
    candidates = sorted(c for c in edits(word) & repairable() if len(c) >= MIN_LETTERS - 1)
    if is_noun:
        names = {key for name in WORDS["nominal"] for key in lexicon.entries[name]}
        candidates = [c for c in candidates if any(c in key for key in names)]
    # "Carefuly" is "carefully" and not "careful", which only occurs in longer expressions.
    candidates = [c for c in candidates if _meanings(c) or c in lexicon.refused] or candidates
    if len(set(map(_meanings, candidates))) > 1:
        candidates = [c for c in candidates if sorted(c) == sorted(word)]
        return candidates[0] if len(candidates) == 1 else None
    return candidates[0] if candidates else None
