"""Export of the controlled language's grammar in Lark and GBNF notation (section 3.1).

It constrains programs that rewrite sentences into the controlled language, such as a language model
with constrained decoding. It has the rules and words of the parser, except those for unknown words;
additional nouns are given by name. Each word is preceded by a space, also the first one, as are the
tokens of most models.

A sentence of the grammar may still be refused, as the parser also resolves references: rewritings
are parsed before use.
"""

import json
from collections.abc import Iterable
from typing import Literal, get_args

from jaxlangnav.language.grammar import Grammar, load_grammar
from jaxlangnav.language.lexicon import is_reserved
from jaxlangnav.language.nouns import load_nouns
from jaxlangnav.language.tokens import MARKS, is_word, normalize
from jaxlangnav.language.tree import UNKNOWN

Notation = Literal["lark", "gbnf"]
Rules = dict[str, list[tuple[str, ...]]]
"""Alternatives of each nonterminal; a part in double quotes is a word."""
START = "start"
_OMITTED = frozenset({"one", "VP_after", "of_all"})
"""Constructions that a rewriting does not need: "the one", "after going to", "of all the"."""
_UNKNOWN_NOUN, _ADJECTIVE, _ADJECTIVES, _GROUP = "unknown_noun", "adj", "adjs", "noun_group"


def export_grammar(form: Notation, nouns: Iterable[str] = ()) -> str:
    """Write the grammar of the controlled language.

    Args:
        form: ``"lark"``, which lark and llguidance read, or ``"gbnf"``, which llama.cpp reads.
        nouns: object names besides the lexicon's, such as a detector's labels.

    Returns:
        The grammar; a sentence of it has a space before each word.

    Raises:
        ValueError: a noun is none, or the notation is unknown; one line.
    """
    if form not in get_args(Notation):
        raise ValueError(f"'{form}' is no notation: choose one of {', '.join(get_args(Notation))}")
    rules = exported_rules(load_grammar(), nouns)
    names = {left: _name(left, form) for left in rules}
    arrow, bar, comment = {"lark": (": ", "\n  | ", "//"), "gbnf": (" ::= ", " | ", "#")}[form]
    lines = [f"{comment} The controlled language of jaxlangnav. Every word has a space before it."]
    for left, rights in rules.items():
        bodies = [" ".join(names.get(s) or _literal(s) for s in right) for right in rights]
        lines.append(names[left] + arrow + bar.join(bodies))
    return "\n".join(lines) + "\n"


def exported_rules(grammar: Grammar, nouns: Iterable[str] = ()) -> Rules:
    """List the productive rules that are reachable from the start symbol, which is first.

    Raises:
        ValueError: a noun is none; one line.
    """
    rules: Rules = {}
    for production in grammar.productions:
        is_guess = production.entry is None and production.left in (_UNKNOWN_NOUN, _ADJECTIVE)
        is_guess |= any(part.startswith(f'"{UNKNOWN}') for part in production.right)
        is_compound = production.left == _GROUP and len(production.right) > 1
        if not (is_guess or is_compound or production.left in _OMITTED):
            rules.setdefault(production.left, []).append(production.right)
    # Attribute adjectives are unknown words to the parser: at most one is allowed before a noun.
    attributes = sorted(word for word in load_nouns().attributes if word.isalpha())
    rules.setdefault(_ADJECTIVES, []).extend((f'"{word}"',) for word in attributes)
    rules[_UNKNOWN_NOUN] = [tuple(f'"{word}"' for word in _words(noun)) for noun in nouns]
    rules = {left: list(dict.fromkeys(rights)) for left, rights in rules.items()}
    return _reachable(_productive(rules))


def _words(noun: str) -> list[str]:
    words = normalize(noun).split()
    if not words or not all(map(is_word, words)) or is_reserved(" ".join(words)):
        raise ValueError(f"'{noun[:30]}' is no noun: give words of letters, as in 'fire hydrant'")
    return words


def _productive(rules: Rules) -> Rules:
    """Remove rules with nonterminals that derive no sentence of words."""
    while True:
        pruned = {
            left: [r for r in rights if all(part[0] == '"' or rules.get(part) for part in r)]
            for left, rights in rules.items()
        }
        if pruned == rules:
            return {left: rights for left, rights in rules.items() if rights}
        rules = pruned


def _reachable(rules: Rules) -> Rules:
    """Select the rules of the nonterminals that are reachable from the start, breadth first."""
    reached = [START]
    for left in reached:  # which grows
        parts = (part for right in rules[left] for part in right if part[0] != '"')
        reached += [part for part in dict.fromkeys(parts) if part not in reached]
    return {left: rules[left] for left in reached}


def _name(left: str, form: Notation) -> str:
    """Name a nonterminal in a notation: lower case in Lark, without underscores in GBNF."""
    lower = left.lower() + ("_phrase" if left[:1].isupper() else "")
    gbnf = "root" if left == START else lower.replace("_", "-")
    return lower if form == "lark" else gbnf


def _literal(part: str) -> str:
    """Format a word with a space before it, or a mark without."""
    word = part.strip('"')
    return json.dumps(word if word in ("'s", *MARKS) else f" {word}")
