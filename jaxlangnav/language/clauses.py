"""The clauses of a sentence, and what their words may be: for the gist of it (section 3.1).

``data/gist.toml`` holds the words by class; here is asked of a word, or of words at a place in a
clause, which of these they are. Nothing is left out or changed here.
"""

import tomllib
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from importlib import resources

from jaxlangnav.language.lexicon import REASONS, TYPE_CLASS, load_lexicon
from jaxlangnav.language.nouns import singular
from jaxlangnav.language.tokens import COMMA_MARK, MARKS, SpokenToken

DETERMINERS = frozenset({"the", "a", "an", "that", "this", "any", "some", "my", "our", "your"})
VERBS = ("v_to", "v_at", "v_obj", "v_for", "v_turn", "avoid")
"""Classes of the lexicon of which an order begins with a word."""
_ACTIONS = frozenset({REASONS[one] for one in ("such an action", "path", "containment")})
"""Reasons for which words are refused that may begin an order: "pass the", "enter"."""
_LONGEST_VERB, _LONGEST_RELATION = 5, 6
_CALLS = frozenset({"ok", "okay", "well", "now", "so", "yes", "yeah", "right", "alright", "robot"})
"""Words before an order that only call to it."""
_AHEAD = 9
"""Words after a verb within which its place has begun."""


@dataclass(frozen=True)
class GistWords:
    """The contents of ``gist.toml``, each list by its name."""

    words: dict[str, frozenset[str]]
    verbs: dict[str, frozenset[str]]
    phrases: dict[str, tuple[tuple[str, ...], ...]]  # the longest first

    @cached_property
    def all_verbs(self) -> frozenset[str]:
        """Every verb of some list."""
        return frozenset().union(*self.verbs.values())


@cache
def gist_words() -> GistWords:
    """Read the lists of words; the same object at every call."""
    text = resources.files("jaxlangnav.language").joinpath("data/gist.toml").read_text("utf-8")
    document = tomllib.loads(text)
    phrases = {
        name: tuple(sorted((tuple(one.split()) for one in listed), key=len, reverse=True))
        for name, listed in document["phrases"].items()
    }
    return GistWords(
        words={name: frozenset(listed) for name, listed in document["words"].items()},
        verbs={name: frozenset(listed) for name, listed in document["verbs"].items()},
        phrases=phrases,
    )


def phrase_at(name: str, words: Sequence[str], index: int) -> int:
    """Count the words of the longest phrase of a list that stands at a place; 0 for none."""
    phrases = gist_words().phrases[name]
    return next((len(p) for p in phrases if tuple(words[index : index + len(p)]) == p), 0)


def relation_at(words: Sequence[str], index: int) -> int:
    """Count the words of a relation that begins at a place: "behind", "in front of"; 0 for none."""
    entries = load_lexicon().entries
    for size in range(min(_LONGEST_RELATION, len(words) - index), 0, -1):
        key = tuple(words[index : index + size])
        if key in entries["rel"] or key in entries["rel_robot"]:
            return size
    return 0


@dataclass(frozen=True)
class Things:
    """What a detector tells apart, as far as words may name it."""

    labels: frozenset[str]

    @cached_property
    def names(self) -> frozenset[tuple[str, ...]]:
        """Names, word by word."""
        known = load_lexicon().entries[TYPE_CLASS].keys()
        return frozenset({tuple(label.split()) for label in self.labels} | known)

    @cached_property
    def _heads(self) -> frozenset[str]:
        return frozenset(name[-1] for name in self.names)

    def has(self, word: str) -> bool:
        """Tell whether a word may be the noun of a thing."""
        return word in self._heads or singular(word) in self._heads

    def name_at(self, words: Sequence[str], index: int) -> int:
        """Count the words of the name that begins at a place; 0 where none does."""
        for size in range(min(4, len(words) - index), 0, -1):
            name = tuple(words[index : index + size])
            if name in self.names or tuple(singular(" ".join(name)).split()) in self.names:
                return size
        return 0

    def bear(self, words: Collection[str]) -> bool:
        """Tell whether words could choose a thing or turn the meaning round."""
        refused, turning = load_lexicon().refused, gist_words().words["turning"]
        return any(
            self.has(word) or word in turning or refused.get(word) == REASONS["negation"]
            for word in words
        )


def verb_at(words: Sequence[str], index: int) -> int:
    """Count the words of a verb of going, being, finding or avoiding at a place; 0 for none."""
    entries = load_lexicon().entries
    for size in range(min(_LONGEST_VERB, len(words) - index), 0, -1):
        if any(tuple(words[index : index + size]) in entries[name] for name in VERBS):
            return size
    lists = gist_words().verbs
    is_listed = index < len(words) and any(words[index] in lists[n] for n in lists if n != "light")
    return int(is_listed)


@cache
def leading() -> frozenset[str]:
    """Collect the single words that may stand before the verb of an order: "quickly", "now"."""
    entries = load_lexicon().entries
    single = {key[0] for name in ("adv", "conn") for key in entries[name] if len(key) == 1}
    return frozenset(single | {"first", "next", "also", "and", "to", "robot"}) - {"careful"}


def is_order(words: Sequence[str], things: Things) -> bool:
    """Tell whether words are an order with its place, as "now quickly go to the barn"."""
    first = next((i for i, word in enumerate(words) if word not in leading()), len(words))
    return first < len(words) and order_at(words, first, things) > 0


def order_at(words: Sequence[str], index: int, things: Things) -> int:
    """Count the words of the verb of an order, with a place behind it, that begins at a word."""
    size = verb_at(words, index)
    after = words[index + size : index + size + _AHEAD]
    return size if size and any(begins_place(after, i, things) for i in range(len(after))) else 0


def begins_place(words: Sequence[str], index: int, things: Things) -> bool:
    """Tell whether a goal may begin at a word: "to", "behind", "the", a name."""
    word = words[index]
    return (
        word in gist_words().words["placed"]
        or word in DETERMINERS
        or relation_at(words, index) > 0
        or things.has(word)
    )


@dataclass
class Clause:
    """A part of a sentence, with what joins it to the one before."""

    joint: list[SpokenToken]
    said: list[SpokenToken] = field(default_factory=list)

    @property
    def words(self) -> list[str]:
        """Its words."""
        return [token.text for token in self.said]

    def put(self, first: int, last: int, text: str) -> None:
        """Put other words in the place of some, at their positions."""
        was = self.said[first:last]
        at = was or self.said[max(first - 1, 0) :][:1]
        self.said[first:last] = [
            replace(at[min(i, len(at) - 1)], text=word) for i, word in enumerate(text.split())
        ]


def clauses_of(tokens: Sequence[SpokenToken], things: Things) -> list[Clause]:
    """Part a sentence at its marks, at words that begin a clause, and where one runs into another.

    Args:
        tokens: words and marks.
        things: what the detector tells apart.

    Returns:
        The clauses, in order; together they hold every word.
    """
    clauses = [Clause([])]
    for index, token in enumerate(tokens):
        following = tokens[index + 1].text if index + 1 < len(tokens) else ""
        if not _is_joint(token.text, following):
            clauses[-1].said.append(token)
        elif clauses[-1].said:
            clauses.append(Clause([token]))
        else:
            clauses[-1].joint.append(token)
    parted = [one for clause in clauses for one in _parted(clause, things)]
    return [clause for clause in parted if clause.said]


def _is_joint(word: str, following: str) -> bool:
    """Tell whether a word begins a clause: a mark, "and", and "while" before who does something."""
    words = gist_words().words
    if word in words["clauses"]:
        return following in words["subjects"] or following in ("my", "our")
    return word in MARKS or word in words["joints"]


def _parted(clause: Clause, things: Things) -> list[Clause]:
    """Part clauses without a mark between them: "my feet hurt go to the bench"."""
    words = clause.words
    for index in range(2, len(words) - 1):
        before = words[index - 1]
        is_begun = (
            words[index] in gist_words().words["starting"]
            and order_at(words, index, things) > 0
            and before not in gist_words().words["governing"]
            and says_something(words[:index], things)
        )
        is_aside = (
            words[index] in gist_words().words["speakers"]
            and things.has(before)
            and is_order(words, things)
        )
        if is_begun or is_aside:
            mark = replace(clause.said[index], text=COMMA_MARK)
            rest = Clause([mark], clause.said[index:])
            return [Clause(clause.joint, clause.said[:index]), *_parted(rest, things)]
    return [clause]


def says_something(words: Sequence[str], things: Things) -> bool:
    """Tell whether words say that something is so, or ask it, and begin no order."""
    lists = gist_words()
    if not words or begins_order(words):
        return False
    if words[0] in lists.words["subjects"] and words[0] not in DETERMINERS:
        return len(words) > 1
    is_named = any(map(things.has, words))
    if words[0] in lists.words["opening"] and words[0] not in DETERMINERS and not is_named:
        return True
    return any(_is_finite(word, things) for word in words[1:7])


def _is_finite(word: str, things: Things) -> bool:
    """Tell whether a word may be the verb of a clause: "is", "hurts", "complained"."""
    is_past = word.endswith("ed") and len(word) > 4
    is_third = word.endswith("s") and singular(word) in gist_words().all_verbs
    return (word in gist_words().words["finite"] or is_past or is_third) and not things.has(word)


def begins_order(words: Sequence[str]) -> bool:
    """Tell whether words begin as an order does, of whatever kind: with a bare verb."""
    lists, refused = gist_words(), load_lexicon().refused
    begin = next((i for i, word in enumerate(words) if word not in _CALLS), 0)
    first, following = words[begin], words[begin + 1] if len(words) > begin + 1 else ""
    is_asked = first in lists.words["modals"] and "you" in words[begin + 1 : begin + 3]
    if is_asked or first in ("let's", "lets", "let", "please"):
        return True
    if first in lists.words["subjects"] or following in lists.words["auxiliary"]:
        return False
    is_action = refused.get(first) in _ACTIONS and first not in lists.words["opening"]
    return verb_at(words, begin) > 0 or is_action or first in ("don't", "dont", "never")
