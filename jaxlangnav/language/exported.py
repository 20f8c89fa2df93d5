"""The controlled language as a grammar for other programs: Lark's form and GBNF (section 3.1).

Whoever rewrites sentences into the controlled language, such as a language model whose output is
constrained token by token, is held to this grammar. It is made of the rules and the words that the
parser has, less its guesses about words that it does not know: nouns come in by name instead. Each
word has a space before it, the first one too, as the tokens of most models do.

What the grammar makes can be refused all the same, for the parser also checks what refers to what:
a rewriting is parsed before it counts.
"""

import json
from collections.abc import Iterable
from typing import Literal

from jaxlangnav.language.grammar import Grammar, load_grammar
from jaxlangnav.language.nouns import load_nouns
from jaxlangnav.language.tokens import MARKS, is_word, plainly
from jaxlangnav.language.tree import UNKNOWN

Notation = Literal["lark", "gbnf"]
Rules = dict[str, list[tuple[str, ...]]]
"""Ways to make each symbol; a part in double quotes is a word."""
START = "start"
_LEFT_OUT = frozenset({"one", "VP_after", "of_all"})
"""What people say and a rewriting needs not: "the one", "after going to", "of all the"."""
_UNKNOWN_NOUN, _ADJECTIVE, _ADJECTIVES, _GROUP = "unknown_noun", "adj", "adjs", "noun_group"


def export_grammar(form: Notation, nouns: Iterable[str] = ()) -> str:
    """Write the grammar of the controlled language.

    Args:
        form: ``"lark"``, which lark and llguidance read, or ``"gbnf"``, which llama.cpp reads.
        nouns: names of things beside the lexicon's, such as a detector's labels.

    Returns:
        The grammar; a sentence of it has a space before each word.

    Raises:
        ValueError: a noun is none; one line.
    """
    rules = exported_rules(load_grammar(), nouns)
    names = {left: _name(left, form) for left in rules}
    makes, part, head = {"lark": (": ", "\n  | ", "//"), "gbnf": (" ::= ", " | ", "#")}[form]
    note = f"{head} The controlled language of jaxlangnav. Every word has a space before it."
    lines = [note]
    for left, rights in rules.items():
        ways = [" ".join(names.get(one) or _literal(one) for one in right) for right in rights]
        lines.append(names[left] + makes + part.join(ways))
    return "\n".join(lines) + "\n"


def exported_rules(grammar: Grammar, nouns: Iterable[str] = ()) -> Rules:
    """List the rules that can be filled with words, and are reached from the start, which is first.

    Raises:
        ValueError: a noun is none; one line.
    """
    ways: Rules = {}
    for one in grammar.productions:
        is_guess = one.entry is None and one.left in (_UNKNOWN_NOUN, _ADJECTIVE)
        is_guess |= any(part.startswith(f'"{UNKNOWN}') for part in one.right)
        is_compound = one.left == _GROUP and len(one.right) > 1
        if not (is_guess or is_compound or one.left in _LEFT_OUT):
            ways.setdefault(one.left, []).append(one.right)
    # To the parser these are words that it does not know: one before a noun is read.
    attributes = sorted(one for one in load_nouns().attributes if one.isalpha())
    ways.setdefault(_ADJECTIVES, []).extend((f'"{one}"',) for one in attributes)
    ways[_UNKNOWN_NOUN] = [tuple(f'"{word}"' for word in _words(noun)) for noun in nouns]
    ways = {left: list(dict.fromkeys(rights)) for left, rights in ways.items()}
    return _reached(_fillable(ways))


def spaced(text: str) -> str:
    """Write a sentence as the exported grammar has it: small, with a space before each word."""
    return " " + " ".join(plainly(text).split())


def _words(noun: str) -> list[str]:
    words = plainly(noun).split()
    if not words or not all(map(is_word, words)):
        raise ValueError(f"'{noun[:30]}' is no noun: give words of letters, as in 'fire hydrant'")
    return words


def _fillable(ways: Rules) -> Rules:
    """Leave out what cannot be filled with words."""
    while True:
        kept = {
            left: [r for r in rights if all(part[0] == '"' or ways.get(part) for part in r)]
            for left, rights in ways.items()
        }
        if kept == ways:
            return {left: rights for left, rights in ways.items() if rights}
        ways = kept


def _reached(ways: Rules) -> Rules:
    found, waiting = {}, [START]
    while waiting:
        left = waiting.pop(0)
        if left not in found:
            found[left] = ways[left]
            waiting += [part for right in ways[left] for part in right if part[0] != '"']
    return found


def _name(left: str, form: Notation) -> str:
    """Name a symbol as the form wants it: lark's are small, GBNF has no underscore."""
    small = left.lower() + ("_phrase" if left[:1].isupper() else "")
    gbnf = "root" if left == START else small.replace("_", "-")
    return small if form == "lark" else gbnf


def _literal(part: str) -> str:
    """Write a word with the space before it, or a mark without."""
    word = part.strip('"')
    return json.dumps(word if word in ("'s", *MARKS) else f" {word}")
