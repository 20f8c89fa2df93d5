"""Open vocabulary: noun phrases whose noun is not in the lexicon (section 3.1).

Every sentence defines its own types. A noun of the parse gets the sense ``type:NAME``, as nouns of
the lexicon have, and is grounded by agreement features ("the type that the words name"). Multi-word
names, of which a word would be parsed as something else ("the stop sign"), are one token.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import cache
from typing import NamedTuple

from jaxlangnav.inputs.documents import parse_toml, read_shipped
from jaxlangnav.language.lexicon import REASONS, SINGULARS, TYPE_CLASS, WORDS, load_lexicon, plural
from jaxlangnav.language.phrase import Phrase, Word
from jaxlangnav.language.refusal import NOUN, Token


class Nouns(NamedTuple):
    """The contents of ``nouns.toml``."""

    synonyms: tuple[frozenset[str], ...]
    compounds: frozenset[tuple[str, ...]]
    rooms: frozenset[str]  # places that a robot can drive into
    ambiguous: frozenset[str]  # words of other classes that can also be nouns
    hypernyms: Mapping[str, str]  # hyponym → hypernym
    attributes: Mapping[str, str]  # adjective → attribute value

    def synonyms_of(self, noun: str) -> frozenset[str]:
        """List the synonyms of a noun, including itself."""
        groups = (names for names in reversed(self.synonyms) if noun in names)
        return next(groups, frozenset({noun}))


@cache
def load_nouns() -> Nouns:
    """Load the package's nouns, cached."""
    document = parse_toml(read_shipped("language", "nouns.toml"))
    names = {name for group in document["synonyms"] for name in group} | set(document["compounds"])
    foreign = {" ".join(words) for words in load_lexicon().entries["foreign"]}
    return Nouns(
        synonyms=tuple(frozenset(group) for group in document["synonyms"]),
        compounds=frozenset(tuple(name.split()) for name in names | foreign if " " in name),
        rooms=frozenset(document["rooms"]),
        ambiguous=frozenset(document["also_nouns"]),
        hypernyms={noun: kind for kind, nouns in document["broader"].items() for noun in nouns},
        attributes=document["attributes"],
    )


def singular(noun: str) -> str:
    """Convert a plural noun to its singular; other nouns are unchanged."""
    prefix, space, last = noun.rpartition(" ")
    if last in SINGULARS:
        return prefix + space + SINGULARS[last]
    for ending, replacement in (("ies", "y"), ("es", ""), ("s", "")):
        stem = noun.removesuffix(ending) + replacement
        if noun.endswith(ending) and len(stem) > 2 and plural(stem) == noun:
            return stem
    return noun


@cache
def words_in_classes(*classes: str) -> frozenset[str]:
    """Collect the first words of all expressions of the given classes."""
    return frozenset(key[0] for name in classes for key in load_lexicon().entries.get(name, {}))


@cache
def _single_verbs() -> frozenset[str]:
    """Collect one-word verbs, and other words that cannot begin a noun phrase."""
    lexicon = load_lexicon()
    names = [name for name in lexicon.entries if name.startswith("v_")]
    verbs = {key[0] for name in names for key in lexicon.entries[name] if len(key) == 1}
    verbal = {REASONS[name] for name in WORDS["verbal"]}
    refused = {word for word, reason in lexicon.refused.items() if reason in verbal}
    return frozenset(
        (verbs | refused) - words_in_classes(*WORDS["before_nouns"]) - set(lexicon.tags)
    )


def join_nouns(tokens: list[Token], labels: Collection[str] = ()) -> list[Token]:
    """Merge each multi-word name into one noun token, and make the detector's labels nouns.

    The labels are lower-case; a merged token has the position of its first word.
    """
    names = load_nouns().compounds | {tuple(label.split()) for label in labels}
    names |= {(noun,) for noun in load_nouns().ambiguous}
    # Types of the lexicon are not changed.
    names -= load_lexicon().entries[TYPE_CLASS].keys()
    max_words = max(map(len, names), default=1) + 1  # "pick up truck"
    names = {"".join(name) for name in names}
    joined: list[Token] = []
    index = 0
    while index < len(tokens):
        first, size = tokens[index], _name_length(tokens, index, names, max_words)
        text = " ".join(token.text for token in tokens[index : index + size])
        joined.append(replace(first, text=text, terminal=NOUN) if size else first)
        index += max(size, 1)
    return joined


def _name_length(tokens: list[Token], index: int, names: Collection[str], max_words: int) -> int:
    """Count the words of the name that begins at a token, 0 if none; ``names`` have no spaces."""
    words = tuple(token.text for token in tokens[index : index + max_words])
    for size in range(len(words), 0, -1):
        name, stem = words[:size], singular(" ".join(words[:size]))
        # "The tree that stands by …" is no plural of "stand".
        is_plural = stem.replace(" ", "") in names and stem not in load_nouns().ambiguous
        if "" in name or not ("".join(name) in names or is_plural):
            continue
        if size > 1 or tokens[index].terminal.startswith("?") or must_be_noun(tokens, index):
            return size
        if words[0] in load_nouns().ambiguous and _is_head(tokens, index):
            return size
    following = tokens[index + 1 : index + 2]
    is_verbal = words[0] in _single_verbs() and _is_after_determiner(tokens, index)
    return 2 if is_verbal and following and following[0].terminal.startswith("?") else 0


def _is_after_determiner(tokens: list[Token], index: int) -> bool:
    """Check whether a token is preceded by a determiner, or by one and adjectives."""
    adjectives = words_in_classes("adj", "sup_adj", "ordinal")
    preceding = (t.text for t in reversed(tokens[:index]) if t.text not in adjectives)
    return next(preceding, None) in words_in_classes("det")


def _is_head(tokens: list[Token], index: int) -> bool:
    """Check whether a word, not "left" or "right", is the noun of its phrase: "close to the _"."""
    following = [token.text for token in tokens[index + 1 : index + 3]]
    is_last = not following or following[0] not in words_in_classes(*WORDS["before_nouns"]) | {"of"}
    is_before_place = len(following) > 1 and following[1] in words_in_classes("det")  # "near the"
    is_unknown = bool(following) and tokens[index + 1].terminal.startswith("?")
    return (is_last or is_before_place) and not is_unknown and _is_after_determiner(tokens, index)


def must_be_noun(tokens: list[Token], index: int) -> bool:
    """Check whether a word must be the noun of its phrase: "the _ behind the cone".

    Returns:
        True after a determiner and at the end of the noun phrase, except where "left" or "right" is
        possible: "on the _", "to the _ of the cone".
    """
    before = tokens[index - 2].text if index >= 2 else ""
    has_noun = any(t.text in words_in_classes("det") for t in tokens[: max(index - 2, 0)])
    if before in ("on", "at", "in") or (before == "to" and has_noun):
        return False
    is_followed = any(
        t.terminal.startswith("?") or t.text in words_in_classes(*WORDS["before_nouns"]) | {"of"}
        for t in tokens[index + 1 : index + 2]
    )
    return not is_followed and _is_after_determiner(tokens, index)


def name_nouns(phrase: Phrase) -> Phrase:
    """Assign each unknown noun below a phrase the sense of a new object type.

    A noun that modifies it, known or not, is part of its name: "coke machine", "water fountain".
    """
    children = tuple(map(name_nouns, phrase.children))
    words = phrase.words
    last = max((i for i, word in enumerate(words) if word.tag in ("NN", "NNS")), default=None)
    if phrase.label != "NP" or last is None or words[last].senses:
        return replace(phrase, children=children)
    start = last
    while start and words[start - 1].tag == "NN" and not words[start - 1].senses:
        start -= 1
    head = words[last]
    modifiers = [word.text for word in words[start:last]]
    name = " ".join([*modifiers, singular(head.lemma)])
    noun = Word(
        text=" ".join([*modifiers, head.text]),
        tag="NNS" if singular(head.text) != head.text else "NN",
        lemma=name,
        senses=(f"type:{name}",),
        position=words[start].position,
    )
    return replace(phrase, words=(*words[:start], noun, *words[last + 1 :]), children=children)


def attributes_of(phrase: Phrase) -> tuple[list[tuple[Word, str]], list[Word]]:
    """Extract the attribute values of a noun phrase from its adjectives.

    Returns:
        Words with their attribute value, and modifiers without one: "tall", "construction".
    """
    known = load_nouns().attributes
    words = [w for w in phrase.words if w.tag in ("JJ", "NN") and not w.senses]
    attributes = [(word, known[word.text]) for word in words if word.text in known]
    unused = [word for word in words if word.text not in known]
    return attributes, [w for w in unused if w.text not in WORDS["shading"] or not attributes]


def base_adjective(word: str) -> str | None:
    """Find the base adjective of a superlative or comparative: "tall" of "tallest"."""
    known = load_nouns().attributes.keys() | WORDS["compared"]
    stems = [word.removesuffix(ending) for ending in ("est", "er") if word.endswith(ending)]
    forms = (form for s in stems for form in (s, s[:-1], s + "e", s[:-1] + "y"))
    return next((form for form in forms if form in known), None)
