"""A probabilistic context-free grammar over classes of words, parsed by lark's Earley parser.

The rules stand in ``data/grammar.txt``, the words in ``data/lexicon.toml``. Lark builds the shared
packed parse forest; the most probable tree and the total probability of all trees are read off
the forest by dynamic programming, so time stays polynomial however ambiguous the input.
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
    UNKNOWN_CLASSES,
    Derivation,
    Production,
    read_forest,
)

P_OPTIONAL = 0.2
W_EXPRESSION = 0.005  # of a word of fixed expressions to be a noun, beside an unknown word


class NoParseError(Exception):
    """No tree; ``index`` is the first token that cannot continue any (the length at the end)."""

    def __init__(self, index: int) -> None:
        """Keep where the parse came to its end."""
        super().__init__(f"no parse at token {index}")
        self.index = index


class _TokenLexer(Lexer):
    """Hands lark tokens that are made already."""

    def __init__(self, lexer_conf: Any) -> None:
        del lexer_conf

    def lex(self, lexer_state: Any, parser_state: Any = None) -> Iterator[Token]:
        """Yield one lark token per terminal; ``start_pos`` is its index."""
        for index, terminal in enumerate(lexer_state):
            yield Token(terminal, terminal, start_pos=index)


def _expand_options(right: list[str]) -> Iterator[tuple[tuple[str, ...], float]]:
    """Write out a right side for each way to leave out its optional symbols."""
    given, left_out = P_OPTIONAL, 1 - P_OPTIONAL
    choices = [
        [(one[:-1], given), ("", left_out)] if one.endswith("?") else [(one, 1.0)] for one in right
    ]
    for choice in itertools.product(*choices):
        symbols = tuple(symbol for symbol, _ in choice if symbol)
        yield symbols, math.prod(weight for _, weight in choice)


def read_rules(text: str) -> list[tuple[str, tuple[str, ...], float]]:
    """Read the rules of a grammar file, ``left -> right [weight]``, options written out.

    Raises:
        ValueError: a line is not a rule; the line's number is named.
    """
    rules = []
    for number, line in enumerate(text.splitlines(), start=1):
        line = line.split("#")[0].strip()
        if not line:
            continue
        parts = line.split()
        weight = parts[-1]
        if len(parts) < 4 or parts[1] != "->" or not (weight[0] == "[" and weight[-1] == "]"):
            raise ValueError(f"grammar line {number}: expected 'left -> right [weight]'")
        for right, share in _expand_options(parts[2:-1]):
            rules.append((parts[0], right, float(weight[1:-1]) * share))
    return rules


def _lexical_rules(
    lexicon: Lexicon,
) -> list[tuple[str, tuple[str, ...], float, LexicalEntry | None]]:
    """Make a rule for every expression of the lexicon and for unknown words."""
    rules: list[tuple[str, tuple[str, ...], float, LexicalEntry | None]] = []
    for name, entries in lexicon.entries.items():
        rules += [(name, tuple(f'"{w}"' for w in key), 1.0, e) for key, e in entries.items()]
    for name, (_, marks) in UNKNOWN_CLASSES.items():
        known = max(1, len(lexicon.entries.get(name, {})))
        rules += [(name, (f'"{mark}"',), known * share, None) for mark, share in marks.items()]
    # Words known only from fixed expressions ("plant yourself") are nouns alone.
    closed = set(lexicon.tags) | set(lexicon.refused)
    for key, entry in itertools.chain(*(one.items() for one in lexicon.entries.values())):
        senses = itertools.chain(*(word.senses for word in entry))
        if len(key) == 1 or any(sense.startswith("relation") for sense in senses):
            closed.update(key)
    free = sorted(word for word in lexicon.vocabulary - closed if word.isalpha())
    rules += [("unknown_noun", (f'"{word}"',), W_EXPRESSION, None) for word in free]
    marks = zip(PUNCTUATION, MARKS, strict=True)
    rules += [(name, (f'"{mark}"',), 1.0, None) for name, mark in marks]
    return rules


class Grammar:
    """The grammar made ready: parses token sequences to their most probable derivation."""

    def __init__(self, rules_text: str, lexicon: Lexicon) -> None:
        """Join the rules of a grammar file and the words of a lexicon.

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
            self._by_rule.setdefault(tuple(self._symbols[one] for one in symbols), production)
        by_left: dict[str, list[str]] = {}
        for left, *right in self._by_rule:
            by_left.setdefault(left, []).append(" ".join(right))
        lines = [f"{left}: " + "\n  | ".join(rights) for left, rights in by_left.items()]
        terminals = " ".join(one for one in self._symbols.values() if one[0] == "T")
        lark = Lark(
            "\n".join([*lines, f"%declare {terminals}\n"]), start=self._symbols["start"],
            parser="earley", lexer=_TokenLexer, ambiguity="forest", keep_all_tokens=True,
            maybe_placeholders=False,
        )  # fmt: skip
        self._lark: Any = lark
        self._earley: Any = lark.parser.parser
        self._lock = threading.Lock()
        self._rules = lark.rules
        # Symbols that a rule needs before it is predicted: (the first of them, all of them).
        needed = [[str(symbol.name) for symbol in rule.expansion] for rule in lark.rules]
        self._needed = ([set(one[:1]) for one in needed], [set(one) for one in needed])
        self._users: tuple[dict[str, list[int]], ...] = ({}, {})
        for users, rules in zip(self._users, self._needed, strict=True):
            for index, symbols in enumerate(rules):
                for symbol in symbols:
                    users.setdefault(symbol, []).append(index)

    def _predict_only(self, terminals: frozenset[str], is_whole: bool) -> None:
        """Leave rules that the words of the sentence cannot fill out of Earley's predictions."""
        # Lark predicts the whole closure of a nonterminal at once, every expression of the lexicon
        # included; without them, and one rule at a time, a sentence takes a tenth of the time.
        # ``is_whole``: rules of which any symbol cannot be made of the terminals; otherwise those
        # of which the first cannot, which changes nothing about where a parse ends.
        users, num_missing = self._users[is_whole], [*map(len, self._needed[is_whole])]
        made, agenda, chosen = set(terminals), list(terminals), []
        while agenda:  # each symbol that can be made is taken from what its rules still miss
            for index in users.get(agenda.pop(), ()):
                num_missing[index] -= 1
                if not num_missing[index]:
                    chosen.append(index)
                    name = str(self._rules[index].origin.name)
                    if name not in made:
                        made.add(name)
                        agenda.append(name)
        for rules in self._earley.predictions.values():
            rules.clear()
        for index in sorted(chosen):
            self._earley.predictions[self._rules[index].origin].append(self._rules[index])

    def parse(self, tokens: list[str], *, is_end_found: bool = True) -> tuple[Derivation, float]:
        """Find the most probable derivation, and its share of the probability of all.

        Args:
            tokens: words in lower case, or the marks of unknown words and punctuation.
            is_end_found: find where no tree can go on, which takes another parse; otherwise the
                error names the last token.

        Raises:
            NoParseError: there is none.
        """
        known = [f'"{token}"' in self._symbols for token in tokens]
        if not all(known):
            raise NoParseError(known.index(False))
        terminals = [self._symbols[f'"{token}"'] for token in tokens]
        with self._lock:  # the predictions belong to one sentence
            try:
                self._predict_only(frozenset(terminals), is_whole=True)
                root = self._lark.parse(terminals)
            except (UnexpectedEOF, UnexpectedToken):
                end = self._end_of_parse(terminals) if is_end_found else len(tokens) - 1
                raise NoParseError(end) from None
        return read_forest(root, self._by_rule)

    def _end_of_parse(self, terminals: list[str]) -> int:
        """Find the first token that cannot continue any tree, of a sentence that has none."""
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
    """Build the grammar of the package; the same object at every call."""
    return Grammar(read_shipped("language", "grammar.txt"), load_lexicon())
