"""Clauses and reasons that bear on nothing that is to be done (section 3.1).

What people say besides an order may go where it can neither choose a thing nor turn the meaning
round: no other clause speaks of what it speaks of, it gives no order of its own, takes none back,
and nothing later means something that only it has named.
"""

from collections.abc import Sequence
from itertools import pairwise

from jaxlangnav.language.clauses import (
    DETERMINERS,
    VERBS,
    Clause,
    Things,
    begins_order,
    begins_place,
    gist_words,
    is_order,
    leading,
    phrase_at,
    relation_at,
    says_something,
    verb_at,
)
from jaxlangnav.language.lexicon import REASONS, load_lexicon
from jaxlangnav.language.measured import take_out
from jaxlangnav.language.nouns import load_nouns, singular, words_in_classes
from jaxlangnav.language.phrase import LanguageError

_WISHES = frozenset({"want", "need", "like", "wish", "looking", "prefer", "wanted", "hope"})
_SEEKING = frozenset({"look", "search", "head", "make", "hunt", "aim", "go"})
_POINTING = frozenset({"it", "its", "he", "she", "they", "that", "this", "there"})
"""What a clause begins with that says where a thing is which was named before."""
_CONDITIONS = frozenset({"if", "when", "whenever", "whether"})
_FINDING = frozenset({"see", "know", "go", "there", "find", "come", "get", "need", "think", "i"})
"""What no polite condition holds: "if you can see it" is one."""
_DENIALS = frozenset({"no", "nope", "nah", "not", "never"})
_PERSONS = frozenset({"me", "us", "him", "her", "them", "it", "you"})
_SOUGHT = frozenset({"for", "find", "get", "see", "locate", "spot", "bring", "take", "grab"})
"""Words before "it" that ask for what was spoken of, wherever one goes before."""
_SHORT = 2
"""Words of a part that only calls somebody or exclaims."""


def tail_of(words: Sequence[str], things: Things) -> int | None:
    """Find where a reason begins behind a goal that is complete: why, for whom, until when.

    Args:
        words: of a clause that is an order.
        things: what the detector tells apart.

    Returns:
        The first word of what can be left out; None for none.
    """
    named = next((i for i, word in enumerate(words) if things.has(word)), None)
    if named is None or not is_order(words, things):
        return None
    for index in range(len(words) - 2, named, -1):
        if words[index] in gist_words().words["reasons"] and _is_tail(words, index, things):
            return index
    return None


def _is_tail(words: Sequence[str], index: int, things: Things) -> bool:
    """Tell whether words behind a goal say only why, for whom or until when."""
    opening, inner, lists = words[index], words[index + 1 :], gist_words()
    if not inner or things.bear(inner) or relation_at(words, index):
        return False
    begins = inner[0] in lists.words["subjects"] | {"my", "our", "the", "a"}
    if opening == "to":
        is_order = any((inner[0],) in load_lexicon().entries[name] for name in VERBS)
        is_side = inner[0] in ("you", "left", "right", "where")
        is_near = words[index - 1] in gist_words().words["placing"] or inner[0] in _PERSONS
        return not (is_order or is_side or is_near or begins_place(inner, 0, things))
    if opening == "with":
        return inner[0] in lists.words["company"]
    if opening == "for":
        return words[index - 1] not in _SEEKING
    if opening in ("until", "till"):
        return words[0] in lists.verbs["rest"] and begins and "you" not in inner
    if opening in lists.words["clauses"] | {"so"}:
        return begins and inner[0] not in ("that", "you") and "you" not in inner[:2]
    return True


def without_talk(clauses: Sequence[Clause], things: Things) -> tuple[list[Clause], list[str]]:
    """Leave out the clauses of which no other one speaks.

    Args:
        clauses: of a sentence, requests left out and verbs put plainly.
        things: what the detector tells apart.

    Returns:
        The clauses that are left, and the words of the others; all are left where no order is.
    """
    orders = [_is_task(clause, things) for clause in clauses]
    first = next((i for i, is_order in enumerate(orders) if is_order), None)
    if first is None:
        return list(clauses), []
    kept: list[Clause] = []
    dropped: list[str] = []
    for index in range(len(clauses) - 1, -1, -1):  # what points back may be talk itself
        clause = clauses[index]
        others = [*clauses[:index], *kept]
        has_other = any(orders[i] for i in range(len(clauses)) if i != index)
        is_aside = is_talk(clause, others, things, is_before=index < first)
        if has_other and is_aside and not _points_back(kept, things):
            dropped.insert(0, " ".join(clause.words))
        else:
            kept.insert(0, clause)
    return kept, dropped


def _is_task(clause: Clause, things: Things) -> bool:
    """Tell whether a clause asks for something, or names a thing and says nothing of it."""
    words = clause.words
    if is_order(words, things) or _is_measured(clause):
        return True
    is_named = any(map(things.has, words))
    return is_named and gist_words().words["finite"].isdisjoint(words)


def _is_measured(clause: Clause) -> bool:
    """Tell whether a clause is a turn or a distance, or speaks of one that cannot be measured."""
    try:
        return bool(take_out(clause.said)[1])
    except LanguageError:
        return True


def is_talk(clause: Clause, others: Sequence[Clause], things: Things, *, is_before: bool) -> bool:
    """Tell whether a clause says something that bears on no other one.

    Args:
        clause: what may be left out.
        others: the other clauses of the sentence.
        things: what the detector tells apart.
        is_before: no order has been given before it, so that it can take none back.
    """
    words = clause.words
    is_named = any(map(things.has, words))
    if _is_politeness(words, things) or (phrase_at("talk", words, 0) and not is_named):
        return True
    lists = gist_words().words
    if not lists["terms"].isdisjoint(words) or (
        not is_before and words[0] in ("not", "no", "once")
    ):
        return False
    if begins_order(words) or not _may_end(clause, others):
        return False
    if is_before and len(words) <= _SHORT and not is_named:
        return not is_order(words, things) and _exclaims(words)
    bare = [word for word in words if word not in leading()]
    is_frame = is_before and len(words) > max(len(bare), _SHORT) and not is_named
    is_frame = is_frame and bool(bare) and not begins_order(bare)
    if not (is_frame or says_something(words, things)) or _orders(words, things):
        return False
    if not is_before and not (lists["turning"] | lists["choosing"]).isdisjoint(words):
        return False
    if is_before and is_named and not lists["choosing"].isdisjoint(words):
        return False
    if is_named and not (_informs(words) and _is_shared(words, others, things)):
        return False
    return not (_picks(words) or _speaks_of(words, others, things))


def _may_end(clause: Clause, others: Sequence[Clause]) -> bool:
    """Tell whether what a clause sets an end to may end: who waits does, who goes does not."""
    joints = {token.text for token in clause.joint}
    waits = {"stop", *gist_words().verbs["rest"]}
    return joints.isdisjoint(("until", "till")) or any(o.words[0] in waits for o in others)


def _is_shared(words: Sequence[str], others: Sequence[Clause], things: Things) -> bool:
    """Tell whether all things that a clause names are named by others, too."""
    rest = {singular(word) for one in others for word in one.words}
    named = [singular(word) for word in words if things.has(word)]
    return all(load_nouns().alike(word) & rest for word in named)


def _informs(words: Sequence[str]) -> bool:
    """Tell whether a clause that names a thing says that something is so, and wishes nothing."""
    lists = gist_words().words
    is_begun = words[0] in lists["subjects"] or words[0] in DETERMINERS or words[1:2] == ["'s"]
    return is_begun and not lists["auxiliary"].isdisjoint(words[:6])


def _picks(words: Sequence[str]) -> bool:
    """Tell whether words say of one of several things which it is: "the red one", "that one"."""
    telling = words_in_classes("adj", "ordinal", "sup_adj", "side_adj") | {"the", "that", "this"}
    return any(
        word in ("one", "ones") and before in telling and before != "other"
        for before, word in pairwise(words)
    )


def _exclaims(words: Sequence[str]) -> bool:
    """Tell whether a few words ask for nothing that a robot could do: "roger", "whoa"."""
    refused, lists = load_lexicon().refused, gist_words().words
    if not (lists["ways"] | lists["placing"] | _DENIALS).isdisjoint(words):
        return False
    if not all(word[0].isalpha() for word in words):
        return False
    is_action = any(refused.get(word) == REASONS["such an action"] for word in words)
    manner = load_lexicon().entries["adv"].values()
    modes = {one.words[-1] for one in manner if any("mode" in s for w in one.senses for s in w)}
    return not is_action and modes.isdisjoint(words)


def _is_politeness(words: Sequence[str], things: Things) -> bool:
    """Tell whether a clause is made of what requests are made of, and denies nothing."""
    lists = gist_words().words
    if not lists["request"].issuperset(words) or any(map(things.has, words)):
        return False
    if is_order(words, things) or verb_at(words, 0) or list(words) in (["go"], ["right"]):
        return False
    if words[0] in ("don't", "dont"):  # "don't hurry" asks for something
        return False
    if not _CONDITIONS.isdisjoint(words):
        return not lists["courtesies"].isdisjoint(words) and _FINDING.isdisjoint(words)
    is_mild = not lists["mild"].isdisjoint(words) or phrase_at("asking", words, 0) > 0
    return lists["denials"].isdisjoint(words) or is_mild


def _orders(words: Sequence[str], things: Things) -> bool:
    """Tell whether a clause asks somebody for something after all."""
    ordering = gist_words().words["ordering"]
    for word, following in pairwise(words):
        if word in ("you", "robot") and following in ordering:
            return True
    is_wish = not _WISHES.isdisjoint(words)
    return is_wish and (any(map(things.has, words)) or "you" in words)


def _speaks_of(words: Sequence[str], others: Sequence[Clause], things: Things) -> bool:
    """Tell whether a clause could tell where a thing of another one is, or which."""
    lists = gist_words().words
    rest = {singular(word) for one in others for word in one.words}
    shared = {singular(word) for word in words} - lists["empty"]
    alike = {name for word in shared for name in load_nouns().alike(word)} & rest
    places = any(relation_at(words, i) for i in range(len(words)))
    is_placed = places or not lists["placing"].isdisjoint(words)
    is_denied = any(load_lexicon().refused.get(w) == REASONS["negation"] for w in words)
    if words[0].split("'")[0] in _POINTING and is_placed and any(map(things.has, words)):
        return True  # "it's by the mailbox"
    if is_placed and not (_PERSONS - {"me", "us", "you"}).isdisjoint(words[1:]):
        return True  # "the cone is near it"
    looks = set(load_nouns().attributes) | words_in_classes("adj")
    if any(map(things.has, alike)):
        return is_placed or is_denied or not looks.isdisjoint(words)
    return bool(alike) and is_placed


def _points_back(later: Sequence[Clause], things: Things) -> bool:
    """Tell whether a later clause means something that has not been named again before it."""
    is_named = False
    for clause in later:
        for before, word in pairwise(["", *clause.words]):
            is_named = is_named or things.has(word)
            is_sought = before in _SOUGHT and word in _PERSONS - {"me", "us", "you"}
            if is_sought or (word in gist_words().words["pointing"] and not is_named):
                return True
    return False
