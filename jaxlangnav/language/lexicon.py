"""The words: classes, Penn tags and senses, read from ``data/lexicon.toml`` (section 3.1).

A new object type or synonym is one line, there or in a file of one's own that the environment
variable ``JAXLANGNAV_LEXICON`` names. Everything derived (plurals, -ing forms, the terminals of the
grammar) is derived here.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

from jaxlangnav.inputs.documents import naming, parse_toml, read_shipped, read_text
from jaxlangnav.language.phrase import Word

OWN_LEXICON = "JAXLANGNAV_LEXICON"
"""Environment variable that names a lexicon file of one's own, joined to the package's."""
_LARGEST_FILE = 256 * 1024
"""Bytes of such a file."""
TYPE_CLASS = "type"
_WORDS = parse_toml(read_shipped("language", "words.toml"))
WORDS = {name: frozenset(one) for name, one in _WORDS.items() if isinstance(one, list)}
"""Sets of words that rules ask for by name."""
LITERAL_TAGS: dict[str, str] = _WORDS["literals"]
REASONS: dict[str, str] = _WORDS["reasons"]
"""Why words are refused, by the name of the reason."""
_PLURALS: dict[str, str] = _WORDS["plurals"]
SINGULARS = {many: one for one, many in _PLURALS.items()}
"""Nouns by their irregular plurals."""


LexicalEntry = tuple[Word, ...]
"""An expression of one or more words in one class; only its head has senses."""


@dataclass(frozen=True, kw_only=True)
class Lexicon:
    """All expressions by class, and what is refused."""

    type_names: tuple[str, ...]  # object types; position is the type index
    entries: dict[str, dict[tuple[str, ...], LexicalEntry]]  # class → words → entry
    refused: dict[str, str]  # word → why
    refused_expressions: dict[tuple[str, ...], str] = field(default_factory=dict)  # words → why
    tags: dict[str, str] = field(default_factory=dict)  # word → Penn tag in expressions
    slips: dict[str, str] = field(default_factory=dict)  # short word, mistyped → what is meant

    @cached_property
    def vocabulary(self) -> frozenset[str]:
        """Every word that some class, or the list of refused words, knows."""
        known = {word for entries in self.entries.values() for key in entries for word in key}
        return frozenset(known | set(self.refused) | {"'s"})


def plural(noun: str) -> str:
    """Make a plural: boxes, benches, cones, book shelves."""
    before, space, last = noun.rpartition(" ")
    if last in _PLURALS:
        return before + space + _PLURALS[last]
    if noun.endswith(("s", "x", "ch", "sh")):
        return noun + "es"
    if noun.endswith("y") and noun[-2:-1] not in "aeiou":
        return noun[:-1] + "ies"
    return noun + "s"


def ing_form(verb: str) -> str:
    """Make a regular -ing form: moving, stopping, seeing."""
    if verb.endswith("e") and not verb.endswith(("ee", "ye", "oe")) and verb != "be":
        return verb[:-1] + "ing"
    doubles = len(verb) == 3 or verb in {"stop", "spot", "shun", "swing", "step"}
    closed = verb[-1] in "bdgmnpt" and verb[-2:-1] in "aeiou" and verb[-3:-2] not in "aeiou"
    return verb + verb[-1] + "ing" if doubles and closed and verb != "get up" else verb + "ing"


def _entry(text: str, tag: str, senses: tuple[str, ...], tags: dict[str, str]) -> LexicalEntry:
    """Read one expression; ``*`` marks the word that carries the senses, by default the last."""
    marked = text.split()
    head = next((i for i, word in enumerate(marked) if word[0] == "*"), len(marked) - 1)
    words = [word.lstrip("*") for word in marked]
    own = tags if words[1:] else {}
    return tuple(
        Word(text=word, tag=own.get(word, tag), lemma=word, senses=senses if i == head else ())
        for i, word in enumerate(words)
    )


def _derived(entry: LexicalEntry, index: int, form: str, tag: str) -> LexicalEntry:
    """Copy an entry with one word put in another form; its lemma stays."""
    return (*entry[:index], replace(entry[index], text=form, tag=tag), *entry[index + 1 :])


def _entries(document: dict[str, Any]) -> Iterator[tuple[str, LexicalEntry]]:
    """List names of types with plurals, and expressions of classes, with -ing forms if asked."""
    for type_name, names in document["types"].items():
        for name in dict.fromkeys([type_name, *names]):
            entry = _entry(name, "NN", (f"type:{type_name}",), {})
            yield TYPE_CLASS, entry
            yield TYPE_CLASS, _derived(entry, len(entry) - 1, plural(entry[-1].text), "NNS")
    tags = document["tags"]
    for name, table in document["class"].items():
        for senses, texts in table.items():
            told = () if senses == "plain" else tuple(senses.split())
            for text in texts if senses not in ("tag", "ing") else ():
                entry = _entry(text, table["tag"], told, tags)
                yield name, entry
                # "I am looking" has no -ing form of its own: its first word is no verb.
                if "ing" in table and tags.get(entry[0].text, "VB") == "VB":
                    yield table["ing"], _derived(entry, 0, ing_form(entry[0].text), "VBG")


def type_called(name: str) -> str | None:
    """Find the lexicon's type of a name, in small letters: a house is a building; or None."""
    entry = load_lexicon().entries[TYPE_CLASS].get(tuple(name.split()))
    return None if entry is None else entry[-1].senses[0].removeprefix("type:")


@cache
def load_lexicon() -> Lexicon:
    """Read the lexicon of the package, and a file of one's own that ``OWN_LEXICON`` names.

    Raises:
        ValueError: a file is missing, is no TOML, or what it adds is refused (``own_words``).
    """
    text = read_shipped("language", "lexicon.toml")
    own = os.environ.get(OWN_LEXICON)
    if not own:
        return read_lexicon(text)
    with naming(OWN_LEXICON):
        added = read_text(own, at_most=_LARGEST_FILE)
    with naming(own):
        return read_lexicon(text, added)


def read_lexicon(text: str, own: str | None = None) -> Lexicon:
    """Read a lexicon from TOML; the format is described at the head of ``lexicon.toml``.

    Args:
        text: contents of the file.
        own: contents of a file whose lines are joined to it.

    Raises:
        ValueError: a table is missing, a reason for refusal is unknown, or what is added is
            refused.
    """
    document = parse_toml(text)
    for table in ("types", "class", "tags", "refused"):
        if table not in document:
            raise ValueError(f"lexicon: table [{table}] is missing")
    if own is not None:
        from jaxlangnav.language.own_words import extend  # which needs the plurals of this module

        extend(document, parse_toml(own))
    unknown = set(document["refused"]) - set(REASONS)
    if unknown:
        raise ValueError(f"lexicon: [refused] has unknown reasons {sorted(unknown)}")
    entries: dict[str, dict[tuple[str, ...], LexicalEntry]] = {}
    for name, entry in _entries(document):
        entries.setdefault(name, {}).setdefault(tuple(word.text for word in entry), entry)
    refused: dict[str, str] = {}
    expressions: dict[tuple[str, ...], str] = {}
    for reason, listed in document["refused"].items():
        for text in listed:
            if " " in text:
                expressions[tuple(text.split())] = REASONS[reason]
            else:
                refused.setdefault(text, REASONS[reason])
    return Lexicon(
        type_names=tuple(document["types"]),
        entries=entries,
        refused=refused,
        refused_expressions=expressions,
        tags=document["tags"],
        slips=document.get("slips", {}),
    )
