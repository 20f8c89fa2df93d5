"""A probabilistic context-free grammar over classes of words, parsed by lark's Earley parser.

The rules are in ``data/grammar.txt``, the words in ``data/lexicon.toml``. Lark builds the shared
packed parse forest; the most probable tree and the total probability of all trees are computed
from it by dynamic programming, so time stays polynomial however ambiguous the input.
"""

import itertools
import math
import threading
from collections.abc import Iterator
from functools import cache
from typing import Any

from lark import Lark, Token
from lark.exceptions import UnexpectedEOF, UnexpectedToken
from lark.lexer import Lexer

from jaxlangnav.inputs.documents import read_shipped
from jaxlangnav.language.lexicon import LexicalEntry, Lexicon, load_lexicon
from jaxlangnav.language.tokens import MARKS
from jaxlangnav.language.tree import (
    PUNCTUATION,
    UNKNOWN_WORD_CLASSES,
    Derivation,
    Production,
    read_forest,
)

P_OPTIONAL = 0.2
W_EXPRESSION = 0.005  # weight of a word of fixed expressions as a noun, relative to an unknown word


class NoParseError(Exception):
    """Failed parse; ``index`` is the first token that continues no tree, or the length."""

    def __init__(self, index: int) -> None:
        """Store the index of the failure."""
        super().__init__(f"no parse at token {index}")
        self.index = index


class _TokenLexer(Lexer):
    """Lark lexer that passes on terminals from the caller."""

    def __init__(self, lexer_conf: Any) -> None:
        del lexer_conf

    def lex(self, lexer_state: Any, parser_state: Any = None) -> Iterator[Token]:
        """Yield one lark token per terminal; ``start_pos`` is its index."""
        for index, terminal in enumerate(lexer_state):
            yield Token(terminal, terminal, start_pos=index)


def _expand_options(right: list[str]) -> Iterator[tuple[tuple[str, ...], float]]:
    """Expand the optional symbols of a right side into all alternatives, with probabilities."""
    choices = [
        [(part[:-1], P_OPTIONAL), ("", 1 - P_OPTIONAL)] if part[-1] == "?" else [(part, 1.0)]
        for part in right
    ]
    for choice in itertools.product(*choices):
        symbols = tuple(symbol for symbol, _ in choice if symbol)
        yield symbols, math.prod(weight for _, weight in choice)


def read_rules(text: str) -> list[tuple[str, tuple[str, ...], float]]:
    """Parse the rules of a grammar file, ``left -> right [weight]``, with options expanded.

    Raises:
        ValueError: a line is not a rule; the message has the line number.
    """
    rules = []
    for line_number, line in enumerate(text.splitlines(), start=1):
        parts = line.split("#")[0].split()
        if not parts:
            continue
        weight = parts[-1]
        if len(parts) < 4 or parts[1] != "->" or not (weight[0] == "[" and weight[-1] == "]"):
            raise ValueError(f"grammar line {line_number}: expected 'left -> right [weight]'")
        for right, prob in _expand_options(parts[2:-1]):
            rules.append((parts[0], right, float(weight[1:-1]) * prob))
    return rules


def _lexical_rules(
    lexicon: Lexicon,
) -> list[tuple[str, tuple[str, ...], float, LexicalEntry | None]]:
    """Build the rules of the lexicon's expressions and of unknown words."""
    rules: list[tuple[str, tuple[str, ...], float, LexicalEntry | None]] = []
    for name, entries in lexicon.entries.items():
        rules += [(name, tuple(f'"{w}"' for w in key), 1.0, e) for key, e in entries.items()]
    for name, (_, weights) in UNKNOWN_WORD_CLASSES.items():
        size = max(1, len(lexicon.entries.get(name, {})))
        rules += [(name, (f'"{unk}"',), size * w, None) for unk, w in weights.items()]
    # Words known only from fixed expressions ("plant yourself") are nouns alone.
    closed = set(lexicon.tags) | set(lexicon.refused)
    for key, entry in itertools.chain(*(table.items() for table in lexicon.entries.values())):
        senses = itertools.chain(*(word.senses for word in entry))
        if len(key) == 1 or any(sense.startswith("relation") for sense in senses):
            closed.update(key)
    free = sorted(word for word in lexicon.vocabulary - closed if word.isalpha())
    rules += [("unknown_noun", (f'"{word}"',), W_EXPRESSION, None) for word in free]
    marks = zip(PUNCTUATION, MARKS, strict=True)
    rules += [(name, (f'"{mark}"',), 1.0, None) for name, mark in marks]
    return rules


class Grammar:
    """The compiled grammar: parses token sequences to their most probable derivation."""

    def __init__(self, rules_text: str, lexicon: Lexicon) -> None:
        """Compile the rules of a grammar file and the words of a lexicon.

        Raises:
            ValueError: a rule names a symbol that is neither a left side nor a class.
        """
        rules = [(*rule, None) for rule in read_rules(rules_text)] + _lexical_rules(lexicon)
        total: dict[str, float] = {}
        for left, _, weight, _ in rules:
            total[left] = total.get(left, 0.0) + weight
        self.productions = [
            Production(left, right, math.log(weight / total[left]), entry)
            for left, right, weight, entry in rules
        ]
        used = {symbol for production in self.productions for symbol in production.right}
        words = {symbol for symbol in used if symbol[0] == '"'}
        if missing := used - words - total.keys():
            raise ValueError(f"grammar: no rule or class for {sorted(missing)}")
        self._symbols = {left: f"n{index}" for index, left in enumerate(sorted(total))}
        self._symbols |= {word: f"T{index}" for index, word in enumerate(sorted(words))}
        self._by_rule: dict[tuple[str, ...], Production] = {}
        for production in self.productions:
            symbols = (production.left, *production.right)
            self._by_rule.setdefault(tuple(self._symbols[s] for s in symbols), production)
        by_left: dict[str, list[str]] = {}
        for left, *right in self._by_rule:
            by_left.setdefault(left, []).append(" ".join(right))
        lines = [f"{left}: " + "\n  | ".join(rights) for left, rights in by_left.items()]
        terminals = " ".join(name for name in self._symbols.values() if name[0] == "T")
        self._lark: Any = Lark(
            "\n".join([*lines, f"%declare {terminals}\n"]), start=self._symbols["start"],
            parser="earley", lexer=_TokenLexer, ambiguity="forest", keep_all_tokens=True,
            maybe_placeholders=False,
        )  # fmt: skip
        self._lock = threading.Lock()
        # Symbols that must be derivable before a rule is predicted: (only the first, all).
        required = [[str(symbol.name) for symbol in rule.expansion] for rule in self._lark.rules]
        self._required = ([set(it[:1]) for it in required], [set(it) for it in required])
        self._dependents: tuple[dict[str, list[int]], ...] = ({}, {})
        for dependents, rules in zip(self._dependents, self._required, strict=True):
            for index, symbols in enumerate(rules):
                for symbol in symbols:
                    dependents.setdefault(symbol, []).append(index)

    def _predict_only(self, terminals: frozenset[str], is_whole: bool) -> None:
        """Restrict Earley's predictions to rules that the sentence's terminals can derive."""
        # Lark predicts the whole closure of a nonterminal at once, with every expression of the
        # lexicon; without underivable ones, and one rule at a time, parsing is ten times faster.
        # ``is_whole``: all symbols of a rule must be derivable from the terminals; otherwise only
        # the first, which does not change where a parse fails.
        dependents, num_missing = self._dependents[is_whole], [*map(len, self._required[is_whole])]
        derivable, agenda, allowed = set(terminals), list(terminals), []
        while agenda:  # each derivable symbol decrements the missing counts of its rules
            for index in dependents.get(agenda.pop(), ()):
                num_missing[index] -= 1
                if not num_missing[index]:
                    allowed.append(index)
                    name = str(self._lark.rules[index].origin.name)
                    if name not in derivable:
                        derivable.add(name)
                        agenda.append(name)
        predictions = self._lark.parser.parser.predictions
        for rules in predictions.values():
            rules.clear()
        for index in sorted(allowed):
            predictions[self._lark.rules[index].origin].append(self._lark.rules[index])

    def parse(self, tokens: list[str], *, is_end_found: bool = True) -> tuple[Derivation, float]:
        """Find the most probable derivation, and its posterior probability.

        Args:
            tokens: words in lower case, or terminals of unknown words and punctuation.
            is_end_found: locate the failure by another parse; otherwise the error has the last
                token.

        Raises:
            NoParseError: there is none.
        """
        is_known = [f'"{token}"' in self._symbols for token in tokens]
        if not all(is_known):
            raise NoParseError(is_known.index(False))
        terminals = [self._symbols[f'"{token}"'] for token in tokens]
        with self._lock:  # the predictions are specific to one sentence
            try:
                self._predict_only(frozenset(terminals), is_whole=True)
                root = self._lark.parse(terminals)
            except (UnexpectedEOF, UnexpectedToken):
                end = self._end_of_parse(terminals) if is_end_found else len(tokens) - 1
                raise NoParseError(end) from None
        return read_forest(root, self._by_rule)

    def _end_of_parse(self, terminals: list[str]) -> int:
        """Find the first token that continues no tree, for a sentence without a parse."""
        self._predict_only(frozenset(terminals), is_whole=False)
        try:
            self._lark.parse(terminals)
        except UnexpectedToken as error:
            return error.token.start_pos
        except UnexpectedEOF:
            pass
        return len(terminals)


@cache
def load_grammar() -> Grammar:
    """Build the grammar of the package, cached."""
    return Grammar(read_shipped("language", "grammar.txt"), load_lexicon())
