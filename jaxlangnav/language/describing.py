"""What tells how a thing looks or what it does, in words that nothing is compared with (ours).

"The bench that was painted last week", "the car with its boot open", "the man wearing a red hat":
such a part of a refused sentence is left out and reported, as an adjective is that no detector
reports. It is left out only where it can say nothing of where the thing is: no relation, no thing
that the detector tells apart, no negation, and no verb that relates two things ("facing").
"""

import re
from collections.abc import Collection, Sequence
from functools import cache

from jaxlangnav.language.chatter import ARTICLES, chatter_words
from jaxlangnav.language.lexicon import REASONS, TYPE_CLASS, load_lexicon
from jaxlangnav.language.nouns import singular
from jaxlangnav.language.tokens import MARKS, SpokenToken

_JOINTS = frozenset({*MARKS, "and", "then", "but", "so", "please", "now", "thanks"})
_RELATED = frozenset({REASONS[name] for name in ("negation", "condition", "two sides", "between")})
_NO_NAMES = frozenset({"the", "a", "an", "to", "of", "one"})
"""Words that name no thing by themselves: "the one that is red" is not "the one"."""
_TIMES = frozenset({"week", "night", "year", "month", "time", "summer", "winter"})
_MOST = 8
"""Words of a description."""
_HAD = (
    "whose|wearing|carrying|holding|made of|made out of|covered (?:in|with)|full of|filled with"
    "|painted"
)
_WITH = "with|that has|which has|who has|that's got|having"
_BEING = "(?:that|which|who)(?: is| are| was| were|'s| 's)?"
_DEGREES = "all|just|currently|still|been|really|very|so"
_OPENINGS = re.compile(
    r"(?<= )(?:"
    rf"{_BEING} (?:{_HAD})|{_HAD}"
    rf"|(?:{_WITH}) (?:its|his|her|their)"
    rf"|(?:{_WITH})(?: (?:the|a|an|some|two|all the)(?= [a-z]+ [a-z])"
    r"|(?= (?!the |a |an |some |two )[a-z]+ [a-z]))"
    rf"|{_BEING}(?: (?:{_DEGREES}))*(?= [a-z]+)"
    r")(?= )"
)


@cache
def _named() -> frozenset[str]:
    """Collect the last words of the names of types."""
    return frozenset(words[-1] for words in load_lexicon().entries[TYPE_CLASS])


def _says_where(words: Sequence[str], labels: Collection[str]) -> bool:
    """Tell whether words could say where a thing is, or name another."""
    refused, placing = load_lexicon().refused, chatter_words()["placing"]
    pairs = zip(words, [*words[1:], ""], strict=True)
    words = [word for word, after in pairs if word != "last" or after not in _TIMES]
    known = _named() | {label.split()[-1] for label in labels}
    return any(
        word in placing or refused.get(word) in _RELATED or word in known or singular(word) in known
        for word in words
    )


def leave_out_descriptions(
    tokens: Sequence[SpokenToken], labels: Collection[str]
) -> tuple[list[SpokenToken], list[str]]:
    """Leave out of a refused sentence how a thing looks and what it does.

    Args:
        tokens: words and marks.
        labels: names of things that the detector tells apart.

    Returns:
        What is left to be read, and what has been left out.
    """
    left, dropped = list(tokens), []
    begin = 0
    while (match := _OPENINGS.search(text := " ".join(t.text for t in left), begin)) is not None:
        first = len(text[: match.start()].split())
        size = len(match[0].split())
        last = next(
            (i for i in range(first + size, len(left)) if left[i].text in _JOINTS), len(left)
        )
        words = [token.text for token in left[first:last]]
        inner = words[size:]
        begin = match.end()
        if (
            not inner
            or len(words) > _MOST
            or not _is_described(left, first, inner, match[0], labels)
        ):
            continue
        dropped.append(" ".join(words))
        left[first:last] = []
        begin = match.start()
    return left, dropped


def _is_described(
    tokens: Sequence[SpokenToken],
    first: int,
    inner: Sequence[str],
    opening: str,
    labels: Collection[str],
) -> bool:
    """Tell whether a part only describes the thing that is named before it."""
    before = [token.text for token in tokens[max(first - 4, 0) : first]]
    is_named = before[-1] not in _NO_NAMES and bool(ARTICLES.intersection(before))
    if not is_named or _says_where(inner, labels):
        return False
    if opening.startswith(("that", "which", "who")) and not opening.endswith(("has", "got")):
        # What it does to another thing may say where it is: "that guards the gate".
        return not ARTICLES.intersection(inner) or bool(re.search(_HAD, opening))
    return len(inner) > 1 or not opening.startswith(("with", "having")) or _is_its(opening)


def _is_its(opening: str) -> bool:
    """Tell whether a description is of a part of the thing: "with its boot open"."""
    return opening.split()[-1] in ("its", "his", "her", "their")
