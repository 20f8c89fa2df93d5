"""Any noun: names of things that the lexicon does not know (section 3.1).

A sentence brings its own types. What its grammar makes a noun gets the sense ``type:NAME``, as the
nouns of the lexicon have it, and so is carried by agreement ("the type that the words name"). Names
of several words, of which one would be read as something else ("the stop sign"), are one token.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cache

from jaxlangnav.inputs.documents import parse_toml, read_shipped
from jaxlangnav.language.lexicon import REASONS, SINGULARS, TYPE_CLASS, WORDS, load_lexicon, plural
from jaxlangnav.language.phrase import Phrase, Word
from jaxlangnav.language.refusal import NOUN, Token


@dataclass(frozen=True)
class Nouns:
    """The contents of ``nouns.toml``."""

    synonyms: tuple[frozenset[str], ...]
    compounds: frozenset[tuple[str, ...]]
    rooms: frozenset[str]  # what one can drive into
    also: frozenset[str]  # words of other classes that may be nouns
    broader: Mapping[str, str]  # narrower → broader
    attributes: Mapping[str, str]  # adjective → value

    def alike(self, noun: str) -> frozenset[str]:
        """List the names of the same thing, the noun's own among them."""
        groups = (names for names in reversed(self.synonyms) if noun in names)
        return next(groups, frozenset({noun}))


@cache
def load_nouns() -> Nouns:
    """Read the package's nouns; the same object at every call."""
    document = parse_toml(read_shipped("language", "nouns.toml"))
    names = {name for group in document["synonyms"] for name in group} | set(document["compounds"])
    foreign = {" ".join(words) for words in load_lexicon().entries["foreign"]}
    return Nouns(
        synonyms=tuple(frozenset(group) for group in document["synonyms"]),
        compounds=frozenset(tuple(name.split()) for name in names | foreign if " " in name),
        rooms=frozenset(document["rooms"]),
        also=frozenset(document["also_nouns"]),
        broader={one: kind for kind, narrow in document["broader"].items() for one in narrow},
        attributes=document["attributes"],
    )


def singular(noun: str) -> str:
    """Undo a plural; the noun itself where it is none."""
    before, space, last = noun.rpartition(" ")
    if last in SINGULARS:
        return before + space + SINGULARS[last]
    for ending, instead in (("ies", "y"), ("es", ""), ("s", "")):
        stem = noun.removesuffix(ending) + instead
        if noun.endswith(ending) and len(stem) > 2 and plural(stem) == noun:
            return stem
    return noun


@cache
def words_in_classes(*classes: str) -> frozenset[str]:
    """Collect the words that begin an expression of one of the classes."""
    entries = load_lexicon().entries
    return frozenset(key[0] for name in classes for key in entries.get(name, {}))


@cache
def _single_verbs() -> frozenset[str]:
    """Collect the verbs of one word, and other words that no noun phrase can begin with."""
    lexicon = load_lexicon()
    names = [name for name in lexicon.entries if name.startswith("v_")]
    verbs = {key[0] for name in names for key in lexicon.entries[name] if len(key) == 1}
    verbal = {REASONS[name] for name in WORDS["verbal"]}
    refused = {word for word, reason in lexicon.refused.items() if reason in verbal}
    return frozenset(
        (verbs | refused) - words_in_classes(*WORDS["before_nouns"]) - set(lexicon.tags)
    )


def join_nouns(tokens: list[Token], labels: Collection[str] = ()) -> list[Token]:
    """Make one token of each name of several words, and nouns of the detector's labels.

    The labels are in small letters; a joined token has the position of its first word.
    """
    names = load_nouns().compounds | {tuple(label.split()) for label in labels}
    names |= {(noun,) for noun in load_nouns().also}
    # What the lexicon has as a type is read by it.
    names -= load_lexicon().entries[TYPE_CLASS].keys()
    longest = max(map(len, names), default=1)
    joined: list[Token] = []
    index = 0
    while index < len(tokens):
        first, size = tokens[index], _size_of_name(tokens, index, names, longest)
        text = " ".join(token.text for token in tokens[index : index + size])
        joined.append(replace(first, text=text, terminal=NOUN) if size else first)
        index += max(size, 1)
    return joined


def _size_of_name(
    tokens: list[Token], index: int, names: Collection[tuple[str, ...]], longest: int
) -> int:
    """Count the words of the name that begins at a token; 0 where none does."""
    words = tuple(token.text for token in tokens[index : index + longest])
    for size in range(len(words), 0, -1):
        name, one = words[:size], singular(" ".join(words[:size]))
        # "The tree that stands by …" is no plural of "stand".
        is_plural = tuple(one.split()) in names and one not in load_nouns().also
        if "" in name or not (name in names or is_plural):
            continue
        if size > 1 or tokens[index].terminal.startswith("?") or is_noun_place(tokens, index):
            return size
        if words[0] in load_nouns().also and _is_head(tokens, index):
            return size
    following = tokens[index + 1 : index + 2]
    is_verbal = words[0] in _single_verbs() and _is_after_determiner(tokens, index)
    return 2 if is_verbal and following and following[0].terminal.startswith("?") else 0


def _is_after_determiner(tokens: list[Token], index: int) -> bool:
    """Tell whether only a determiner, or one and adjectives, stands before a token."""
    qualifying = words_in_classes("adj", "sup_adj", "ordinal")
    before = (one.text for one in reversed(tokens[:index]) if one.text not in qualifying)
    return next(before, None) in words_in_classes("det")


def _is_head(tokens: list[Token], index: int) -> bool:
    """Tell whether a word that is no side is the noun of its phrase: "close to the _"."""
    after = [token.text for token in tokens[index + 1 : index + 3]]
    is_last = not after or after[0] not in words_in_classes(*WORDS["before_nouns"]) | {"of"}
    is_before_place = len(after) > 1 and after[1] in words_in_classes("det")  # "near the"
    is_unknown = bool(after) and tokens[index + 1].terminal.startswith("?")
    return (is_last or is_before_place) and not is_unknown and _is_after_determiner(tokens, index)


def is_noun_place(tokens: list[Token], index: int) -> bool:
    """Tell whether a word can be nothing but the noun of its phrase: "the _ behind the cone".

    Returns:
        True after a determiner, and before what is no part of a noun phrase; but not where a side
        may be said: "on the _", "to the _ of the cone".
    """
    before = tokens[index - 2].text if index >= 2 else ""
    has_noun = any(one.text in words_in_classes("det") for one in tokens[: max(index - 2, 0)])
    if before in ("on", "at", "in") or (before == "to" and has_noun):
        return False
    is_followed = any(
        one.terminal.startswith("?")
        or one.text in words_in_classes(*WORDS["before_nouns"]) | {"of"}
        for one in tokens[index + 1 : index + 2]
    )
    return not is_followed and _is_after_determiner(tokens, index)


def name_nouns(phrase: Phrase) -> Phrase:
    """Give nouns below a phrase that the lexicon does not know the senses of types of their own.

    A noun that modifies one, known or not, is part of its name: "coke machine", "water fountain".
    """
    children = tuple(map(name_nouns, phrase.children))
    words = phrase.words
    last = max((i for i, word in enumerate(words) if word.tag in ("NN", "NNS")), default=None)
    if phrase.label != "NP" or last is None or words[last].senses:
        return replace(phrase, children=children)
    first = last
    while first and words[first - 1].tag == "NN" and not words[first - 1].senses:
        first -= 1
    head = words[last]
    lemma = singular(head.lemma) if head.tag == "NN" else head.lemma
    before = [word.text for word in words[first:last]]
    name = " ".join([*before, lemma])
    noun = Word(
        text=" ".join([*before, head.text]),
        tag="NNS" if singular(head.text) != head.text else "NN",
        lemma=name,
        senses=(f"type:{name}",),
        position=words[first].position,
    )
    return replace(phrase, words=(*words[:first], noun, *words[last + 1 :]), children=children)


def attributes_of(phrase: Phrase) -> tuple[list[tuple[Word, str]], list[Word]]:
    """Find what the adjectives of a noun phrase say of how the thing looks.

    Returns:
        Words with the value that each says, and adjectives that say none.
    """
    known = load_nouns().attributes
    words = [w for w in phrase.words if w.tag in ("JJ", "NN") and not w.senses]
    told = [(word, known[word.text]) for word in words if word.text in known]
    idle = [w for w in words if w.tag == "JJ" and w.text not in known]
    return told, [w for w in idle if w.text not in WORDS["shading"] or not told]


def compared(word: str) -> str | None:
    """Find the adjective that a superlative or comparative is of: "tall" of "tallest"."""
    known = load_nouns().attributes.keys() | WORDS["compared"]
    stems = [word.removesuffix(ending) for ending in ("est", "er") if word.endswith(ending)]
    forms = (form for one in stems for form in (one, one[:-1], one + "e", one[:-1] + "y"))
    return next((form for form in forms if form in known), None)
