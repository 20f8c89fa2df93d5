"""The lexicon: classes, Penn tags and senses of words, from ``data/lexicon.toml`` (section 3.1).

A new object type or synonym is one line, there or in a user file named by the environment variable
``JAXLANGNAV_LEXICON``. Derived forms (plurals, -ing forms, terminals of the grammar) are generated
here.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

from jaxlangnav.inputs.documents import error_prefix, parse_toml, read_shipped, read_text
from jaxlangnav.language.phrase import Word

USER_LEXICON = "JAXLANGNAV_LEXICON"
"""Environment variable that names a user lexicon file, merged into the package's."""
_MAX_FILE_BYTES = 256 * 1024
"""Size limit of a user lexicon in bytes."""
TYPE_CLASS = "type"
_WORDS = parse_toml(read_shipped("language", "words.toml"))
WORDS = {name: frozenset(w) for name, w in _WORDS.items() if isinstance(w, list)}
"""Named sets of words, used by rules."""
LITERAL_TAGS: dict[str, str] = _WORDS["literals"]
REASONS: dict[str, str] = _WORDS["reasons"]
"""Explanations for refused words, by the name of the reason."""
_PLURALS: dict[str, str] = _WORDS["plurals"]
SINGULARS = {plural: singular for singular, plural in _PLURALS.items()}
"""Irregular plural → singular noun."""


LexicalEntry = tuple[Word, ...]
"""An expression of one or more words; only its head word has senses."""


@dataclass(frozen=True, kw_only=True)
class Lexicon:
    """Expressions by class, and refused words with reasons."""

    type_names: tuple[str, ...]  # object types, by type index
    entries: dict[str, dict[tuple[str, ...], LexicalEntry]]  # class → words → entry
    refused: dict[str, str]  # word → why
    refused_expressions: dict[tuple[str, ...], str] = field(default_factory=dict)  # words → why
    tags: dict[str, str] = field(default_factory=dict)  # word → Penn tag in expressions
    typos: dict[str, str] = field(default_factory=dict)  # short misspelled word → correction

    @cached_property
    def vocabulary(self) -> frozenset[str]:
        """All words of the classes and of the list of refused words."""
        known = {word for entries in self.entries.values() for key in entries for word in key}
        return frozenset(known | set(self.refused) | {"'s"})


def plural(noun: str) -> str:
    """Form the plural of a noun: boxes, benches, cones, book shelves."""
    prefix, space, last_word = noun.rpartition(" ")
    if last_word in _PLURALS:
        return prefix + space + _PLURALS[last_word]
    if noun.endswith(("s", "x", "ch", "sh")):
        return noun + "es"
    if noun.endswith("y") and noun[-2:-1] not in "aeiou":
        return noun[:-1] + "ies"
    return noun + "s"


def ing_form(verb: str) -> str:
    """Form the -ing form of a regular verb: moving, stopping, seeing."""
    if verb.endswith("e") and not verb.endswith(("ee", "ye", "oe")) and verb != "be":
        return verb[:-1] + "ing"
    doubles = len(verb) == 3 or verb in {"stop", "spot", "shun", "swing", "step"}
    closed = verb[-1] in "bdgmnpt" and verb[-2:-1] in "aeiou" and verb[-3:-2] not in "aeiou"
    return verb + verb[-1] + "ing" if doubles and closed and verb != "get up" else verb + "ing"


def _entry(text: str, tag: str, senses: tuple[str, ...], tags: dict[str, str]) -> LexicalEntry:
    """Build the entry of an expression; ``*`` marks its head word, by default the last."""
    parts = text.split()
    head = next((i for i, word in enumerate(parts) if word[0] == "*"), len(parts) - 1)
    words = [word.lstrip("*") for word in parts]
    tag_of = tags if words[1:] else {}
    return tuple(
        Word(text=word, tag=tag_of.get(word, tag), lemma=word, senses=senses if i == head else ())
        for i, word in enumerate(words)
    )


def _derived(entry: LexicalEntry, index: int, form: str, tag: str) -> LexicalEntry:
    """Copy an entry with one word inflected; its lemma is unchanged."""
    return (*entry[:index], replace(entry[index], text=form, tag=tag), *entry[index + 1 :])


def _entries(document: dict[str, Any]) -> Iterator[tuple[str, LexicalEntry]]:
    """Yield type names with plurals, and expressions of classes, with -ing forms if declared."""
    for type_name, names in document["types"].items():
        for name in dict.fromkeys([type_name, *names]):
            entry = _entry(name, "NN", (f"type:{type_name}",), {})
            yield TYPE_CLASS, entry
            yield TYPE_CLASS, _derived(entry, len(entry) - 1, plural(entry[-1].text), "NNS")
    tags = document["tags"]
    for name, table in document["class"].items():
        for senses, texts in table.items():
            parsed = () if senses == "plain" else tuple(senses.split())
            for text in texts if senses not in ("tag", "ing") else ():
                entry = _entry(text, table["tag"], parsed, tags)
                yield name, entry
                # "I am looking" has no -ing form: its first word is no verb.
                if "ing" in table and tags.get(entry[0].text, "VB") == "VB":
                    yield table["ing"], _derived(entry, 0, ing_form(entry[0].text), "VBG")


def find_type(name: str) -> str | None:
    """Look up the object type of a lower-case name: a house is a building; or None."""
    entry = load_lexicon().entries[TYPE_CLASS].get(tuple(name.split()))
    return None if entry is None else entry[-1].senses[0].removeprefix("type:")


@cache
def load_lexicon() -> Lexicon:
    """Load the lexicon of the package, merged with the user file of ``USER_LEXICON``, cached.

    Raises:
        ValueError: a file is missing, is no TOML, or what it adds is refused (``own_words``).
    """
    text = read_shipped("language", "lexicon.toml")
    user_file = os.environ.get(USER_LEXICON)
    if not user_file:
        return read_lexicon(text)
    with error_prefix(USER_LEXICON):
        user_text = read_text(user_file, max_bytes=_MAX_FILE_BYTES)
    with error_prefix(user_file):
        return read_lexicon(text, user_text)


def read_lexicon(text: str, user_text: str | None = None) -> Lexicon:
    """Parse a lexicon from TOML; its format is described in ``lexicon.toml``.

    Args:
        text: contents of the file.
        user_text: contents of a user file to merge.

    Raises:
        ValueError: a table is missing, a reason for refusal is unknown, or what is added is
            refused.
    """
    document = parse_toml(text)
    for table in ("types", "class", "tags", "refused"):
        if table not in document:
            raise ValueError(f"lexicon: table [{table}] is missing")
    if user_text is not None:
        from jaxlangnav.language.own_words import merge_user_lexicon  # imports this module

        merge_user_lexicon(document, parse_toml(user_text))
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
        typos=document.get("slips", {}),
    )
