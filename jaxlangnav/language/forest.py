"""The most probable tree of a shared packed parse forest, and its share of all trees.

Lark's Earley parser leaves all derivations of a sentence in one forest. Viterbi finds the best,
inside sums weigh it against the rest; both are linear in the size of the forest.
"""

import math
from dataclasses import dataclass
from typing import Any

from lark.parsers.earley_forest import PackedNode, SymbolNode

from jaxlangnav.language.lexicon import LexicalEntry


@dataclass(frozen=True)
class Production:
    """One rule: what it makes, of what, how probable, and the words it names if it is lexical."""

    left: str
    right: tuple[str, ...]  # nonterminals, or terminals (quoted words, unknown marks)
    log_probability: float
    entry: LexicalEntry | None = None  # lexical: the expression


@dataclass(frozen=True)
class Derivation:
    """A node of the most probable tree; leaves are indices of tokens."""

    production: Production
    children: tuple["Derivation | int", ...]


@dataclass
class _Best:
    """Of one forest node: best score, sum over all, and the best way (children in order)."""

    log_best: float
    log_sum: float
    children: tuple["Derivation | int", ...]


class ForestReader:
    """Viterbi and inside sums over a shared packed parse forest, without recursion."""

    def __init__(
        self, by_rule: dict[tuple[str, tuple[str, ...]], list[Production]], tokens: list[str]
    ) -> None:
        """Keep the productions by lark rule, and the words of the sentence."""
        self.by_rule = by_rule
        self.tokens = tokens
        self.memo: dict[int, _Best] = {}

    def read(self, root: SymbolNode) -> tuple[Derivation, float]:
        """Return the best derivation of the root and its posterior probability."""
        stack: list[Any] = [root]
        while stack:
            node = stack[-1]
            parts = [c for p in node.children for c in p.children if isinstance(c, SymbolNode)]
            waiting = [child for child in parts if id(child) not in self.memo]
            if id(node) in self.memo or not waiting:
                stack.pop()
                self.memo.setdefault(id(node), self._combine(node))
            else:
                stack.extend(waiting)
        best = self.memo[id(root)]
        derivation = best.children[0]
        if isinstance(derivation, int):
            raise TypeError("the root of a forest is a derivation")
        return derivation, math.exp(best.log_best - best.log_sum)

    def _combine(self, node: SymbolNode) -> _Best:
        ways = [self._way(node, packed) for packed in node.children]
        best = max(ways, key=lambda way: way.log_best)
        top = max(way.log_sum for way in ways)
        log_sum = top + math.log(sum(math.exp(way.log_sum - top) for way in ways))
        return _Best(best.log_best, log_sum, best.children)

    def _way(self, node: SymbolNode, packed: PackedNode) -> _Best:
        """Score one way to make a node: its rule and its parts."""
        log_best = log_sum = 0.0
        children: tuple[Derivation | int, ...] = ()
        for part in packed.children:
            if not isinstance(part, SymbolNode):
                # The wheels of ROS 2 bring lark 0.12 in place of 1: a token is its own node there.
                children += (getattr(part, "token", part).start_pos,)
                continue
            value = self.memo[id(part)]
            log_best, log_sum = log_best + value.log_best, log_sum + value.log_sum
            children += value.children
        if node.is_intermediate:
            return _Best(log_best, log_sum, children)
        production = self._production(packed.rule, children)
        log_p = production.log_probability
        return _Best(log_best + log_p, log_sum + log_p, (Derivation(production, children),))

    def _production(self, rule: Any, children: tuple[Any, ...]) -> Production:
        """Find which of the productions that share a lark rule the tokens mean."""
        key = (rule.origin.name, tuple(symbol.name for symbol in rule.expansion))
        candidates = self.by_rule[key]
        if len(candidates) == 1:
            return candidates[0]
        words = tuple(f'"{self.tokens[child]}"' for child in children)
        return next(candidate for candidate in candidates if candidate.right == words)
