"""The gist of a refused sentence: what is to be done, without what is said around it (section 3.1).

People ask politely, say why, tell what else goes on, and have more verbs for going somewhere than
any list of phrases. Where neither the grammar nor plainer words read a sentence, it is parted into
clauses, and of each the words of a class are left out or put into the words of the grammar: what a
request is made of, what says nothing wherever it stands, the verb, reasons behind the goal, and
clauses of which no other one speaks. One principle holds for all of them: words may go only where
they can neither choose a thing nor turn the meaning round, and whatever goes is reported.
"""

from collections.abc import Collection, Sequence

from jaxlangnav.language.amends import say_once
from jaxlangnav.language.asides import tail_of, without_talk
from jaxlangnav.language.clauses import (
    DETERMINERS,
    Clause,
    Things,
    clauses_of,
    gist_words,
    phrase_at,
    says_something,
)
from jaxlangnav.language.orders import plain_verb, size_of_request, standing_spans, with_bases
from jaxlangnav.language.tokens import MARKS, SpokenToken


def find_gist(
    tokens: Sequence[SpokenToken], labels: Collection[str] = ()
) -> tuple[list[SpokenToken], list[str], list[tuple[str, str]]]:
    """Find what a refused sentence asks for.

    Args:
        tokens: words and marks, typing errors repaired.
        labels: names of things that the detector tells apart.

    Returns:
        The words and marks that are to be read instead, what is left out, and what has been read
        as what; the latter two empty where there is nothing to leave out.
    """
    things = Things(frozenset(labels))
    told, left_out = _without_idle(tokens, things)
    told, changes = say_once(told)
    clauses = clauses_of(told, things)
    if any(_excepts(clause, things) for clause in clauses):
        return list(tokens), [], []
    is_spoken_of = False
    for clause in clauses:
        _shorten(clause, things, left_out)
        found = plain_verb(clause.words, things, is_spoken_of=is_spoken_of)
        is_spoken_of = is_spoken_of or any(map(things.has, clause.words))
        if found is not None:
            _put(clause, *found, changes)
    kept, talk = without_talk([clause for clause in clauses if clause.said], things)
    joints = gist_words().words["joints"] | set(MARKS)
    left = [token for clause in kept for token in (*clause.joint, *clause.said)]
    while left and left[0].text in joints:
        left = left[1:]
    return left, [*left_out, *talk], changes


def _excepts(clause: Clause, things: Things) -> bool:
    """Tell whether a clause only names what is not meant: "anywhere but the car"."""
    is_but = any(token.text == "but" for token in clause.joint)
    return is_but and clause.words[0] in DETERMINERS and not says_something(clause.words, things)


def _without_idle(
    tokens: Sequence[SpokenToken], things: Things
) -> tuple[list[SpokenToken], list[str]]:
    """Leave out words and phrases that say nothing of what is to be done."""
    words = [token.text for token in tokens]
    left, left_out, index = [], [], 0
    while index < len(words):
        size = phrase_at("idle", words, index) or int(_is_idle(words[index], things))
        if size:
            left_out.append(" ".join(words[index : index + size]))
        else:
            left.append(tokens[index])
        index += max(size, 1)
    return left, left_out


def _is_idle(word: str, things: Things) -> bool:
    """Tell whether a word says nothing of what is to be done, wherever it stands."""
    words = gist_words().words
    is_adverb = word.endswith("ly") and len(word) > 4 and word not in words["telling_ly"]
    return (word in words["idle"] or is_adverb) and not things.has(word)


def _shorten(clause: Clause, things: Things, left_out: list[str]) -> None:
    """Leave out of a clause what asks for its order, how things stand, and reasons."""

    def leave(first: int, last: int) -> None:
        left_out.append(" ".join(clause.words[first:last]))
        clause.said[first:last] = []

    size = size_of_request(clause.words, things)
    if size:
        plain = with_bases(clause.words)[size]
        leave(0, size)
        clause.put(0, 1, plain)
    for first, last in standing_spans(clause.words, things):
        leave(first, last)
    while (begin := tail_of(clause.words, things)) is not None:
        leave(begin, len(clause.said))


def _put(clause: Clause, first: int, last: int, plain: str, changes: list[tuple[str, str]]) -> None:
    """Put a verb in the place of another one."""
    was = " ".join(clause.words[first:last])
    if was != plain:
        changes.append((was, plain))
        clause.put(first, last, plain)
