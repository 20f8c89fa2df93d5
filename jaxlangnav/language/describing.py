"""What tells how a thing looks or what it does, in words that nothing is compared with (ours).

"The bench that was painted last week", "the car with its boot open", "the man wearing a red hat":
such a part of a refused sentence is left out and reported, as an adjective is that no detector
reports. It is left out only where it can say nothing of where the thing is: no relation, no thing
that the detector tells apart, no negation, and no verb that relates two things ("facing").
"""

import re
from collections.abc import Collection, Sequence
from functools import cache

from jaxlangnav.language.lexicon import REASONS, TYPE_CLASS, load_lexicon
from jaxlangnav.language.nouns import singular
from jaxlangnav.language.tokens import MARKS, Spoken

_JOINTS = frozenset({*MARKS, "and", "then", "but", "so", "please", "now", "thanks"})
_RELATED = frozenset({REASONS[name] for name in ("negation", "condition", "two sides", "between")})
_PLACED = frozenset(
    "behind front near beside besides next nearest closest nearer closer close farthest furthest far left "
    "right ahead alongside beyond between past by opposite across facing touching blocking overlooking "
    "leaving passing pointing looking containing holding-up guarding watching following where you your "
    "me us it there here second third first last other".split()
)
"""Words that could say where a thing is, or which one by its place."""
_NO_NAMES = frozenset({"the", "a", "an", "to", "of", "one"})
"""Words that name no thing by themselves: "the one that is red" is not "the one"."""
_TIMES = frozenset({"week", "night", "year", "month", "time", "summer", "winter"})
_MOST = 8
"""Words of a description."""
_WORD = "[a-z][a-z'-]*"
_HAD = "whose|wearing|carrying|holding|made of|made out of|covered (?:in|with)|full of|filled with|painted"
_OPENINGS = re.compile(
    r"(?<= )(?:"
    rf"(?:that|which|who)(?: is| are| was|'s| 's)? (?:{_HAD})"
    rf"|{_HAD}"
    r"|(?:with|that has|which has|who has|that's got|having) (?:its|his|her|their)"
    r"|(?:with|that has|which has|who has|that's got|having)"
    r"(?: (?:the|a|an|some|two|all the)(?= [a-z]+ [a-z])|(?= (?!the |a |an |some |two )[a-z]+ [a-z]))"
    r"|(?:that|which|who)(?: is| are| was| were|'s| 's)?(?: (?:all|just|currently|still|been|really|very|so))*"
    r"(?= [a-z]+)"
    r")(?= )"
)


@cache
def _named() -> frozenset[str]:
    """Collect the last words of the names of types."""
    return frozenset(words[-1] for words in load_lexicon().entries[TYPE_CLASS])


def _says_where(words: Sequence[str], labels: Collection[str]) -> bool:
    """Tell whether words could say where a thing is, or name another."""
    refused = load_lexicon().refused
    pairs = zip(words, [*words[1:], ""], strict=True)
    words = [word for word, after in pairs if word != "last" or after not in _TIMES]
    known = _named() | {label.split()[-1] for label in labels}
    return any(
        word in _PLACED or refused.get(word) in _RELATED or word in known or singular(word) in known
        for word in words
    )


def leave_out_descriptions(
    tokens: Sequence[Spoken], labels: Collection[str]
) -> tuple[list[Spoken], list[str]]:
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
    tokens: Sequence[Spoken],
    first: int,
    inner: Sequence[str],
    opening: str,
    labels: Collection[str],
) -> bool:
    """Tell whether a part only describes the thing that is named before it."""
    if _says_where(inner, labels) or tokens[first - 1].text in _NO_NAMES:
        return False
    before = [token.text for token in tokens[max(first - 4, 0) : first]]
    if not {"the", "a", "an", "that", "this"} & set(before):
        return False
    if opening.startswith(("that", "which", "who")) and not opening.endswith(("has", "got")):
        # What it does to another thing may say where it is: "that guards the gate".
        return not {"the", "a", "an"} & set(inner) or bool(re.search(_HAD, opening))
    return not opening.startswith(("with", "having")) or len(inner) > 1 or opening.split()[-1] in (
        "its", "his", "her", "their",
    )  # fmt: skip
