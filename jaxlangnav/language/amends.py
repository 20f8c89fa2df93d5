"""What is taken back: "to the cone, no wait, the hydrant" (section 3.1).

Who mends what he says begins anew with a word of the kind with which the mistake began: a verb, a
preposition, an article, an adjective (Hindle 1983). So what stands between that word and the one
that takes it back is left out. Where two things could have been meant, nothing is, and the sentence
is refused.
"""

from collections.abc import Callable, Sequence

from jaxlangnav.language.clauses import DETERMINERS, gist_words, phrase_at, relation_at
from jaxlangnav.language.nouns import command_verbs, words_in_classes
from jaxlangnav.language.tokens import MARKS, SpokenToken

_LONGEST_ECHO = 6
_PREPOSITIONS = frozenset({"to", "at", "toward", "towards", "by"})
_CLOSED = _PREPOSITIONS | DETERMINERS
_CLOSED |= frozenset({"and", "then", "of", "in", "on", "is", "from", "with"})


def take_back(
    tokens: Sequence[SpokenToken],
) -> tuple[list[SpokenToken], list[tuple[str, str]]]:
    """Leave out of a sentence what it takes back itself.

    Args:
        tokens: words and marks.

    Returns:
        The words and marks that hold, and what has been read as what; nothing where what is taken
        back is not clear.
    """
    left, changes = list(tokens), []
    begin = 1
    while (cue := _find_cue([t.text for t in left], begin)) is not None:
        first, last = cue
        restart = _restart([t.text for t in left], first, last)
        if restart is None:
            begin = last
            continue
        changes.append((" ".join(t.text for t in left[restart:last]), ""))
        left[restart:last] = []
        begin = max(restart, 1)
    return left, changes


def say_once(
    tokens: list[SpokenToken],
) -> tuple[list[SpokenToken], list[tuple[str, str]]]:
    """Say once the name that is said twice with a pause between: "the mailbox, the mailbox".

    Args:
        tokens: words and marks.

    Returns:
        The words and marks without the first of the two, and what has been read as what.
    """
    changes: list[tuple[str, str]] = []
    for size in range(_LONGEST_ECHO, 0, -1):
        index = 0
        while index + 2 * size <= len(tokens):
            words = [token.text for token in tokens[index : index + size]]
            gap = index + size
            while gap < len(tokens) and tokens[gap].text in MARKS:
                gap += 1
            again = [token.text for token in tokens[gap : gap + size]]
            is_name = words[0] in DETERMINERS and size > 1
            if words != again or words[0] in MARKS or not is_name:
                index += 1
                continue
            changes.append((" ".join([*words, *again]), " ".join(words)))
            tokens = tokens[:index] + tokens[gap:]
    return tokens, changes


def _find_cue(words: list[str], begin: int) -> tuple[int, int] | None:
    """Find the next words that take something back, with the marks around them."""
    for index in range(begin, len(words)):
        last = index
        while (size := phrase_at("amends", words, last)) > 0:
            last += size
            while last < len(words) and words[last] in MARKS:
                last += 1
        if last == index or last >= len(words):
            continue
        is_marked = words[index - 1] in MARKS
        is_sure = is_marked or words[index] not in ("no", "well", "not")
        if is_sure and words[index - 1] not in gist_words().words["joints"]:
            return index - is_marked, last
    return None


def _restart(words: list[str], first: int, last: int) -> int | None:
    """Find where the mistake begins: at a word of the kind of that which follows the cue."""
    begin = max((i + 1 for i in range(first) if words[i] in ("then", ".")), default=0)
    if begin >= first:
        begin = 0
    after, before = words[last], range(first - 1, begin - 1, -1)
    verbs = gist_words().verbs
    if after in command_verbs() | verbs["motion"] | verbs["rest"]:
        return begin
    size = relation_at(words, last)
    if size or after in _PREPOSITIONS:
        return _last(before, lambda i: words[i] in _PREPOSITIONS or relation_at(words, i) > 0)
    if after in DETERMINERS:
        return _same_name(words, begin, first, last)
    telling = words_in_classes("adj", "ordinal", "sup_adj", "side_adj")
    return _last(before[:2], lambda i: words[i] in telling) if after in telling else None


def _same_name(words: list[str], begin: int, first: int, last: int) -> int | None:
    """Find the only name before the cue, or the one of the same noun."""
    names = [i for i in range(begin, first) if words[i] in DETERMINERS]
    if len(names) < 2:
        return names[0] if names else None
    heads = [_head(words, i, first) for i in names]
    head = _head(words, last, len(words))
    alike = [i for i, one in zip(names, heads, strict=True) if one == head]
    return alike[0] if len(alike) == 1 and alike[0] == names[-1] else None


def _head(words: list[str], begin: int, end: int) -> str:
    """Find the noun of the name that begins at a determiner."""
    index = begin + 1
    while index < end and words[index] not in _CLOSED and words[index] not in MARKS:
        if index > begin + 1 and relation_at(words, index):
            break
        index += 1
    return words[index - 1]


def _last(indices: range, is_one: Callable[[int], bool]) -> int | None:
    return next((index for index in indices if is_one(index)), None)
