"""The lexicon: classes, Penn tags and senses of words, from ``data/lexicon.toml`` (section 3.1).

A new object type or synonym is one line, there or in a user file named by the environment variable
``JAXLANGNAV_LEXICON``. A name in it that can never be tokenized, or one that gives "the" or
"behind" a second meaning, would silently change how every sentence is parsed: both are refused.
Derived forms (plurals, -ing forms, terminals of the grammar) are generated here.
"""

import os
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

from jaxlangnav.inputs.documents import error_prefix, parse_toml, read_shipped, read_text
from jaxlangnav.inputs.sanitize import as_text, name_fault, sanitize, shorten
from jaxlangnav.language.halting import halts_alone
from jaxlangnav.language.phrase import Word
from jaxlangnav.language.tokens import is_word, normalize

USER_LEXICON = "JAXLANGNAV_LEXICON"
"""Environment variable that names a user lexicon file, merged into the package's."""
_MAX_FILE_BYTES = 256 * 1024  # size limit of a user lexicon in bytes
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


class Lexicon(NamedTuple):
    """Expressions by class, and refused words with reasons."""

    type_names: tuple[str, ...]  # object types, by type index
    entries: dict[str, dict[tuple[str, ...], LexicalEntry]]  # class → words → entry
    refused: dict[str, str]  # word → why
    refused_expressions: dict[tuple[str, ...], str]  # words → why
    tags: dict[str, str]  # word → Penn tag in expressions
    typos: dict[str, str]  # short misspelled word → correction
    vocabulary: frozenset[str]  # all words of the classes, and refused words


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
    is_short = sum(letter in "aeiou" for letter in verb) == 1 and verb[-2:-1] in "aeiou"
    return verb + verb[-1] * (is_short and verb[-1] in "bdgmnpt") + "ing"


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
        ValueError: a file is missing, is no TOML, or what it adds is refused.
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
        merge_user_lexicon(document, parse_toml(user_text))
    if unknown := set(document["refused"]) - set(REASONS):
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
    known = {word for table in entries.values() for words in table for word in words}
    return Lexicon(
        type_names=tuple(document["types"]),
        entries=entries,
        refused=refused,
        refused_expressions=expressions,
        tags=document["tags"],
        typos=document.get("slips", {}),
        vocabulary=frozenset(known | refused.keys() | {"'s"}),
    )


# ---------------------------------------------------------------- user lexicons

MAX_EXPRESSIONS = 1000
"""Maximum number of expressions of a user lexicon."""
MAX_EXPRESSION_WORDS = 8
"""Maximum number of words of an expression."""
MAX_LETTERS = 30
"""Maximum number of letters of a word."""
_RESERVED = frozenset({"comma", "fullstop", "robot"})
"""Names with a special meaning in the grammar and the labels."""


def merge_user_lexicon(document: dict[str, Any], user_lexicon: dict[str, Any]) -> None:
    """Merge the entries of a user lexicon into the package's lexicon, in place.

    Raises:
        ValueError: a table is none, a class or sense does not exist, a word could not be read or
            has another meaning already; one line.
    """
    if unknown := set(user_lexicon) - {"types", "class"}:
        listed = shorten(", ".join(sorted(map(as_text, unknown))))
        raise ValueError(f"only [types] and [class.X] may be added to, not {listed}")
    types, classes = user_lexicon.get("types", {}), user_lexicon.get("class", {})
    tables = [types, classes, *(classes.values() if isinstance(classes, dict) else [])]
    if not all(isinstance(table, dict) for table in tables):
        raise ValueError("[types] and [class.X] must be tables of lists of words")
    lists = [*types.values(), *(words for table in classes.values() for words in table.values())]
    count = len(types) + sum(len(words) for words in lists if isinstance(words, list))
    if count > MAX_EXPRESSIONS:
        raise ValueError(f"has {count} expressions: at most {MAX_EXPRESSIONS} may be added")
    senses_index = _SenseIndex(document)
    for kind, words in types.items():
        where = f"[types] {shorten(sanitize(kind))}"
        name = _expression(kind, where)
        for expression in [name, *_expressions(words, where)]:
            senses_index.check_name(expression, name, where)
            document["types"].setdefault(name, []).append(expression)
    for name, table in classes.items():
        if name not in document["class"]:
            raise ValueError(f"[class.{shorten(name)}]: no such class")
        for senses, words in table.items():
            where = f"[class.{name}] {shorten(sanitize(senses))}"
            for expression in _expressions(words, where):
                senses_index.check_sense(expression, name, senses, where)
                document["class"][name].setdefault(senses, []).append(expression)


def _expressions(value: Any, where: str) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(text, str) for text in value):
        raise ValueError(f"{where} must be a list of words")
    return [_expression(text, where) for text in value]


def _expression(text: str, where: str) -> str:
    """Validate an expression and normalize it as the tokenizer does."""
    if not text.split():
        raise ValueError(f"{where} must be a list of words, none of them empty")
    if fault := name_fault(text, max_length=MAX_EXPRESSION_WORDS * MAX_LETTERS):
        raise ValueError(f"{where}: {as_text(text)} {fault}")
    words = normalize(text).split()
    if len(words) > MAX_EXPRESSION_WORDS:
        raise ValueError(f"{where}: {as_text(text)} has more than {MAX_EXPRESSION_WORDS} words")
    for word in words:
        bare = word.removeprefix("*")
        if len(bare) > MAX_LETTERS:
            raise ValueError(f"{where}: {as_text(word)} has more than {MAX_LETTERS} letters")
        if not is_word(bare):
            fault = "could not be read as a word: use letters, with hyphens between them"
            raise ValueError(f"{where}: {as_text(word)} {fault}")
    return " ".join(words)


def is_reserved(name: str) -> bool:
    """Check whether a detector's label, such as "the", conflicts with a word of the grammar.

    Detectors may use any label for a class. So fewer are refused than names of a lexicon: possible
    names of classes ("object", "exit", "parking meter") are allowed.
    """
    return halts_alone(name) or _package_index().is_word_of_grammar(name)


@cache
def _package_index() -> "_SenseIndex":
    return _SenseIndex(parse_toml(read_shipped("language", "lexicon.toml")))


class _SenseIndex:
    """Index of the meanings of the package's words, to detect conflicts."""

    def __init__(self, document: dict[str, Any]) -> None:
        self._senses: dict[str, set[tuple[str, str]]] = {}  # expression → class, senses
        for name, table in document["class"].items():
            for senses in table.keys() - {"tag", "ing"}:
                for text in table[senses]:
                    self._senses.setdefault(text.replace("*", ""), set()).add((name, senses))
        self._all_senses = {senses for uses in self._senses.values() for _, senses in uses}
        self._refused = {w: reason for reason, words in document["refused"].items() for w in words}
        self._tags = set(document["tags"])
        # Literal words in the rules of the grammar.
        rules = read_shipped("language", "grammar.txt")
        self._literals = _RESERVED.union(re.findall(r'"([^"\s]+)"', rules))
        self._owners = {
            form: kind
            for kind, names in document["types"].items()
            for name in (kind, *names)
            for form in (name, plural(name))
        }

    def check_name(self, expression: str, kind: str, where: str) -> None:
        """Refuse a name of a type that names another type already, or is a word of the grammar."""
        if "*" in expression:
            raise ValueError(f"{where}: '{expression}' could not be read as a word: leave out *")
        for form in (expression, plural(expression)):
            if (owner := self._owners.get(form, kind)) != kind:
                raise ValueError(f"{where}: '{form}' is a name of {owner} already")
        _check_halting(expression, where)
        words = expression.split()
        for word in (words[0], words[-1]):
            if self._is_of_grammar(word, len(words) == 1):
                fault = f"'{word}' has a meaning of its own in every sentence and cannot be"
                what = "a name" if len(words) == 1 else "an end of a name"
                raise ValueError(f"{where}: {fault} {what}: choose another")
        self._owners |= {expression: kind, plural(expression): kind}

    def check_sense(self, expression: str, name: str, senses: str, where: str) -> None:
        """Refuse unknown senses, and words that have other senses already."""
        if senses not in self._all_senses:
            raise ValueError(f"{where}: no such sense; the lexicon of the package has them all")
        if expression.count("*") > 1:
            raise ValueError(f"{where}: '{expression}' has more than one word marked with *")
        bare = expression.replace("*", "")
        _check_halting(bare, where)
        uses = self._senses.get(bare, set())
        is_other = any(used != senses for _, used in uses) or bare in self._owners
        is_closed = " " not in bare and self._is_closed(bare)
        is_refused = self._refused.get(bare, "path") not in WORDS["redefinable"]
        if (name, senses) not in uses and (is_other or is_closed or is_refused):
            raise ValueError(f"{where}: '{bare}' has another meaning already: choose another")

    def is_word_of_grammar(self, name: str) -> bool:
        """Check whether a name is a word of the grammar; "thing" and "well" may be labels."""
        uses = {use for use, _ in self._senses.get(name, ())} - WORDS["open"] - WORDS["talk"]
        return self._is_closed(name) or any(not use.startswith("v_") for use in uses - {"one"})

    def _is_of_grammar(self, word: str, is_alone: bool) -> bool:
        """Check whether a word cannot be a name, or cannot begin or end one."""
        if self._is_closed(word) or self._refused.get(word, "path") not in WORDS["redefinable"]:
            return True
        uses = {name for name, _ in self._senses.get(word, ())}
        is_known = any(name not in WORDS["open"] and not name.startswith("v_") for name in uses)
        is_refused = self._refused.get(word, "such an action") != "such an action"
        return is_alone and (is_known or is_refused or word in self._tags)

    def _is_closed(self, word: str) -> bool:
        """Check whether a word is of a closed class: articles, links, literals of the rules."""
        uses = {name for name, _ in self._senses.get(word, ())}
        return bool(uses & WORDS["closed"]) or word in self._literals


def _check_halting(expression: str, where: str) -> None:
    """Refuse an expression that halts the robot."""
    if halts_alone(expression):
        raise ValueError(f"{where}: '{expression}' halts the robot: choose another")
