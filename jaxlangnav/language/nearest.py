"""The nearest sentence that can be read, to be offered with a refusal (section 3.1).

What stands in the way is left out, with the phrase that it begins, or the clause that holds it, or
all that follows; or "near" stands in its place. Each is tried; the first that the parser reads is
offered, never taken.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from jaxlangnav.language.lexicon import TYPE_CLASS, load_lexicon
from jaxlangnav.language.tokens import MARKS, SpokenToken

LONGEST = 24
"""Words of a sentence that is tried: longer ones take too long for a refusal."""
_SHORTEST = 2
"""Words that are too few for a sentence that is left of another one's clauses."""
_OTHERWISE = {"my": "the", "our": "the"}
_ARTICLES = frozenset({"the", "a", "an", "that", "this", "your"})
_JOINTS = frozenset({*MARKS, "and", "then", "but", "so", "or"})
_LOOSE = frozenset({"to", "the", "a", "an", "at", "on", "in", "is", "that", "which", "of", "from"})
_LOOSE |= frozenset({"for", "by", "with", "just", "only", "very", "right", "up", "down", "over"})
_LOOSE |= frozenset({"back", "near", "next", "closest", "nearest", "farthest", "furthest"})
"""Words that end no sentence."""


def offer(
    tokens: Sequence[SpokenToken],
    position: int,
    *,
    is_contrary: bool,
    can_read: Callable[[str], bool],
) -> str | None:
    """Find a sentence near to one that is refused.

    Args:
        tokens: words and marks of the sentence, as they were said.
        position: of the word that stands in the way.
        is_contrary: it turns round what is said, as "not" and "if" do: only what stands before
            it, or apart from it, may be offered.
        can_read: whether a sentence can be read; asked four times at most.

    Returns:
        The sentence; None where there is none.
    """
    index = next((i for i, t in enumerate(tokens) if t.position == position), None)
    if index is None:
        return None
    tried: set[str] = set()
    for left in _candidates(list(tokens), index, is_contrary):
        text = _written(left)
        if not text or text in tried or "it" in (token.text for token in left):
            continue
        tried.add(text)
        if len(left) <= LONGEST and can_read(text):
            return text
    return None


def _candidates(
    tokens: list[SpokenToken], index: int, is_contrary: bool
) -> Iterator[list[SpokenToken]]:
    """List what could be read, the nearest first."""
    before, after = tokens[:index], tokens[index:]
    if not is_contrary:
        named = next((i for i, token in enumerate(after) if _is_name(token)), None)
        end = next((i for i, token in enumerate(after) if token.text in _JOINTS), len(after))
        if named is not None and named < end:
            yield _trimmed(before + after[named + 1 :])
        other = _OTHERWISE.get(after[0].text, "near")
        if after[1:] and (after[1].text in _ARTICLES) == (other == "near"):
            yield [*before, replace(after[0], text=other), *after[1:]]
    yield _trimmed(before)
    first = max((i + 1 for i, t in enumerate(before) if t.text in _JOINTS), default=0)
    last = next((i for i, t in enumerate(after) if t.text in _JOINTS), len(after))
    apart = _trimmed(tokens[:first] + after[last + 1 :])
    yield apart if len(apart) > _SHORTEST else []


def _trimmed(tokens: list[SpokenToken]) -> list[SpokenToken]:
    """Leave out joints at both ends, and words that end no sentence."""
    first, last = 0, len(tokens)
    while first < last and tokens[first].text in _JOINTS:
        first += 1
    while last > first and tokens[last - 1].text in _JOINTS | _LOOSE:
        last -= 1
    return tokens[first:last]


def _is_name(token: SpokenToken) -> bool:
    return (token.text,) in load_lexicon().entries[TYPE_CLASS]


def _written(tokens: Sequence[SpokenToken]) -> str:
    """Write words and marks as a sentence."""
    text = " ".join(token.text for token in tokens)
    return text.replace(" ,", ",").replace(" .", ".").replace(" 's", "'s")
