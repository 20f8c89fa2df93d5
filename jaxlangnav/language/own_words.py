"""Somebody's own lines of a lexicon: checked in full, then joined to those of the package.

A name that could never be read, or one that gives "the" or "behind" a second meaning, would change
how every sentence is understood without a word: both are refused, in one line.
"""

import re
from functools import cache
from typing import Any

from jaxlangnav.inputs.documents import parse_toml, read_shipped
from jaxlangnav.inputs.sanitize import as_text, name_fault, sanitize, shorten
from jaxlangnav.language.halting import halts_alone
from jaxlangnav.language.lexicon import WORDS, plural
from jaxlangnav.language.tokens import is_word, plainly

MOST_EXPRESSIONS = 1000
"""Expressions that may be added."""
MOST_WORDS = 8
"""Words of one expression."""
LONGEST_WORD = 30
"""Letters of one word."""
_MARKS = frozenset({"comma", "fullstop", "robot"})
"""What stands for something else within the grammar and the labels."""


def extend(document: dict[str, Any], own: dict[str, Any]) -> None:
    """Join somebody's own lines to the package's lexicon, which is changed in place.

    Raises:
        ValueError: a table is none, a class or sense does not exist, a word could not be read or
            has another meaning already; one line.
    """
    unknown = set(own) - {"types", "class"}
    if unknown:
        listed = shorten(", ".join(sorted(map(as_text, unknown))))
        raise ValueError(f"only [types] and [class.X] may be added to, not {listed}")
    types, classes = own.get("types", {}), own.get("class", {})
    tables = [types, classes, *(classes.values() if isinstance(classes, dict) else [])]
    if not all(isinstance(table, dict) for table in tables):
        raise ValueError("[types] and [class.X] must be tables of lists of words")
    lists = [*types.values(), *(words for table in classes.values() for words in table.values())]
    number = len(types) + sum(len(words) for words in lists if isinstance(words, list))
    if number > MOST_EXPRESSIONS:
        raise ValueError(f"has {number} expressions: at most {MOST_EXPRESSIONS} may be added")
    known = _Known(document)
    for kind, words in types.items():
        where = f"[types] {shorten(sanitize(kind))}"
        name = _expression(kind, where)
        for expression in [name, *_expressions(words, where)]:
            known.check_name(expression, name, where)
            listed = document["types"].setdefault(name, [])
            if expression not in listed:
                listed.append(expression)
    for name, table in classes.items():
        if name not in document["class"]:
            raise ValueError(f"[class.{shorten(name)}]: no such class")
        for senses, words in table.items():
            where = f"[class.{name}] {shorten(sanitize(senses))}"
            for expression in _expressions(words, where):
                known.check_sense(expression, name, senses, where)
                document["class"][name].setdefault(senses, []).append(expression)


def _expressions(value: Any, where: str) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(one, str) for one in value):
        raise ValueError(f"{where} must be a list of words")
    return [_expression(text, where) for text in value]


def _expression(text: str, where: str) -> str:
    """Read one expression, written as the parser will see it."""
    if not text.split():
        raise ValueError(f"{where} must be a list of words, none of them empty")
    if fault := name_fault(text, longest=MOST_WORDS * LONGEST_WORD):
        raise ValueError(f"{where}: {as_text(text)} {fault}")
    words = plainly(text).split()
    if len(words) > MOST_WORDS:
        raise ValueError(f"{where}: {as_text(text)} has more than {MOST_WORDS} words")
    for word in words:
        bare = word.removeprefix("*")
        if len(bare) > LONGEST_WORD:
            raise ValueError(f"{where}: {as_text(word)} has more than {LONGEST_WORD} letters")
        if not is_word(bare):
            fault = "could not be read as a word: use letters, with hyphens between them"
            raise ValueError(f"{where}: {as_text(word)} {fault}")
    return " ".join(words)


def is_of_grammar(name: str) -> bool:
    """Tell whether a detector's label, such as "the", would make other sentences unreadable.

    Labels are what a detector tells apart, whatever it calls them. So fewer are refused than names
    in a lexicon: what classes of things may be called ("object", "exit", "parking meter") is not.
    """
    return halts_alone(name) or _of_package().is_word_of_grammar(name)


@cache
def _of_package() -> "_Known":
    return _Known(parse_toml(read_shipped("language", "lexicon.toml")))


class _Known:
    """What the words of the package mean already."""

    def __init__(self, document: dict[str, Any]) -> None:
        """Index the tables of the lexicon of the package."""
        self._senses: dict[str, set[tuple[str, str]]] = {}  # expression → class, senses
        for name, table in document["class"].items():
            for senses in table.keys() - {"tag", "ing"}:
                for text in table[senses]:
                    self._senses.setdefault(text.replace("*", ""), set()).add((name, senses))
        self._all_senses = {senses for uses in self._senses.values() for _, senses in uses}
        self._refused = {w: why for why, words in document["refused"].items() for w in words}
        self._tags = set(document["tags"])
        # Words that stand in the rules of the grammar themselves.
        rules = read_shipped("language", "grammar.txt")
        self._literals = _MARKS.union(re.findall(r'"([^"\s]+)"', rules))
        self._owners = {
            form: kind
            for kind, names in document["types"].items()
            for name in (kind, *names)
            for form in (name, plural(name))
        }

    def check_name(self, expression: str, kind: str, where: str) -> None:
        """Refuse a name of a type that belongs to another type, or to the grammar."""
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
        """Refuse senses that do not exist, or words of a class that have others already."""
        if senses not in self._all_senses:
            raise ValueError(f"{where}: no such sense; the lexicon of the package has them all")
        if expression.count("*") > 1:
            raise ValueError(f"{where}: '{expression}' has more than one word marked with *")
        bare = expression.replace("*", "")
        _check_halting(bare, where)
        uses = self._senses.get(bare, set())
        is_other = any(meant != senses for _, meant in uses) or bare in self._owners
        is_closed = " " not in bare and self._is_closed(bare)
        is_refused = self._refused.get(bare, "path") not in WORDS["meant"]
        if (name, senses) not in uses and (is_other or is_closed or is_refused):
            raise ValueError(f"{where}: '{bare}' has another meaning already: choose another")

    def is_word_of_grammar(self, name: str) -> bool:
        """Tell whether a name is a word of the grammar; "thing" names any class, a well is one."""
        uses = (
            {one for one, _ in self._senses.get(name, ())} - WORDS["open"] - WORDS["talk"] - {"one"}
        )
        return self._is_closed(name) or any(not one.startswith("v_") for one in uses)

    def _is_of_grammar(self, word: str, is_alone: bool) -> bool:
        """Tell whether a word may not be a name, or may not be at the end of one."""
        if self._is_closed(word) or self._refused.get(word, "path") not in WORDS["meant"]:
            return True
        uses = {name for name, _ in self._senses.get(word, ())}
        is_known = any(name not in WORDS["open"] and not name.startswith("v_") for name in uses)
        is_refused = self._refused.get(word, "such an action") != "such an action"
        return is_alone and (is_known or is_refused or word in self._tags)

    def _is_closed(self, word: str) -> bool:
        """Tell whether a word belongs to the grammar: articles, links, the rules' own words."""
        uses = {name for name, _ in self._senses.get(word, ())}
        return bool(uses & WORDS["closed"]) or word in self._literals


def _check_halting(expression: str, where: str) -> None:
    """Refuse to give words that halt the robot another meaning."""
    if halts_alone(expression):
        raise ValueError(f"{where}: '{expression}' halts the robot: choose another")
