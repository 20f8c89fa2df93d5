"""From a packed parse forest to the most probable tree, and from it to the phrases of grounding.

Lark's Earley parser leaves all derivations of a sentence in one forest. Viterbi finds the best,
inside sums weigh it against the rest; both are linear in the size of the forest.

Left sides in capitals become phrases; the others hand their words and phrases up. "The nearest
cone to the tree" is parted as "the cone nearest to the tree", so that one construction has one
tree: NP[] over NP[the cone] and PP[nearest to] over NP[the tree].
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from lark.parsers.earley_forest import PackedNode, SymbolNode

from jaxlangnav.language.lexicon import LITERAL_TAGS, LexicalEntry, plural
from jaxlangnav.language.phrase import Phrase, Word
from jaxlangnav.language.refusal import NOUN, Token


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


def read_forest(
    root: SymbolNode, by_rule: Mapping[tuple[str, ...], Production]
) -> tuple[Derivation, float]:
    """Find the best derivation of a packed parse forest and its posterior probability.

    Viterbi and inside sums, without recursion; productions go by the symbols of their lark rules.
    """
    memo: dict[int, _Best] = {}

    def score(node: SymbolNode, packed: PackedNode) -> _Best:
        """Score one way to make a node: its rule and its parts."""
        log_best = log_sum = 0.0
        children: tuple[Derivation | int, ...] = ()
        for part in packed.children:
            if not isinstance(part, SymbolNode):
                # The wheels of ROS 2 bring lark 0.12 in place of 1: a token is its own node there.
                children += (getattr(part, "token", part).start_pos,)
                continue
            value = memo[id(part)]
            log_best, log_sum = log_best + value.log_best, log_sum + value.log_sum
            children += value.children
        if node.is_intermediate:
            return _Best(log_best, log_sum, children)
        rule = packed.rule
        production = by_rule[rule.origin.name, *(symbol.name for symbol in rule.expansion)]
        log_p = production.log_probability
        return _Best(log_best + log_p, log_sum + log_p, (Derivation(production, children),))

    stack: list[Any] = [root]
    while stack:
        node = stack[-1]
        parts = [c for p in node.children for c in p.children if isinstance(c, SymbolNode)]
        waiting = [child for child in parts if id(child) not in memo]
        if id(node) not in memo and waiting:
            stack.extend(waiting)
            continue
        stack.pop()
        ways = [score(node, packed) for packed in node.children]
        best = max(ways, key=lambda way: way.log_best)
        top = max(way.log_sum for way in ways)
        log_sum = top + math.log(sum(math.exp(way.log_sum - top) for way in ways))
        memo.setdefault(id(node), _Best(best.log_best, log_sum, best.children))
    best = memo[id(root)]
    derivation: Any = best.children[0]
    return derivation, math.exp(best.log_best - best.log_sum)


# -------------------------------------------- from the most probable derivation to phrases


UNKNOWN, UNKNOWN_ADVERB, UNKNOWN_ING = "?", "?ly", "?ing"
UNKNOWN_CLASSES = {
    "unknown_noun": ("NN", {UNKNOWN: 1.0, UNKNOWN_ING: 0.1, NOUN: 0.01}),
    "adj": ("JJ", {UNKNOWN: 0.3, UNKNOWN_ING: 0.05}),
    "v_to": ("VB", {UNKNOWN: 0.05}),
    "v_obj": ("VB", {UNKNOWN: 0.05}),
    "g_to": ("VBG", {UNKNOWN_ING: 0.05}),
    "g_obj": ("VBG", {UNKNOWN_ING: 0.05}),
    "adv": ("RB", {UNKNOWN_ADVERB: 0.5}),
}
"""Classes that an unknown word may be of: its tag, and its weight beside their known words."""
PUNCTUATION = ("comma", "fullstop")
"""How the rules name ``MARKS``."""
PARTED = "NPX"


def build_phrases(
    root: Derivation, tokens: Sequence[Token]
) -> tuple[list[Phrase], list[tuple[str, int]]]:
    """Build the clauses of a derivation of ``start``, in order.

    Also the words, with their positions, whose part of speech was guessed.
    """
    unknown: list[tuple[str, int]] = []

    def word(node: Derivation, index: int, token: Token) -> Word:
        """Make the word of a token under a lexical or literal production."""
        text, position, entry = token.text, token.position, node.production.entry
        if entry is not None:
            return replace(entry[index], text=text, position=position)
        left = node.production.left
        if left in UNKNOWN_CLASSES:
            tag, _ = UNKNOWN_CLASSES[left]
            if node.production.right != (f'"{NOUN}"',):
                unknown.append((text, position))
            is_plural = tag == "NN" and text.endswith("s") and plural(text[:-1]) == text
            lemma = text[:-1] if is_plural else text
            return Word(text=text, tag="NNS" if is_plural else tag, lemma=lemma, position=position)
        return Word(text=text, tag=LITERAL_TAGS.get(text, "IN"), lemma=text, position=position)

    def parts(node: Derivation) -> tuple[list[Word], list[Phrase]]:
        """Collect the words and phrases a node hands up."""
        left, words, phrases = node.production.left, [], []
        for index, child in enumerate(node.children if left not in PUNCTUATION else ()):
            if isinstance(child, int):
                words.append(word(node, index, tokens[child]))
            else:
                own = parts(child)
                words, phrases = words + own[0], phrases + own[1]
        return ([], [_phrase(left, words, phrases)]) if left[0].isupper() else (words, phrases)

    return parts(root)[1], unknown


def _in_order(words: Iterable[Word]) -> tuple[Word, ...]:
    return tuple(sorted(words, key=lambda word: word.position))


def _phrase(left: str, words: list[Word], phrases: list[Phrase]) -> Phrase:
    """Make a phrase; part superlatives, ordinals and sides from the noun they stand before."""
    label = left.split("_")[0]
    if left == PARTED:
        # NPX[the cone]{ADJP[nearest], PP[to]{X}} becomes NP[]{NP[the cone], PP[nearest to]{X}}.
        base = Phrase(label="NP", words=_in_order(words))
        modifier, *rest = phrases
        if rest:
            joined = _in_order(modifier.words + rest[0].words)
            modifier = Phrase(label="PP", words=joined, children=rest[0].children)
        return Phrase(label="NP", words=(), children=(base, modifier))
    if label == "NP" and not words and not phrases[0].words:
        return Phrase(label=label, words=(), children=phrases[0].children + tuple(phrases[1:]))
    return Phrase(label=label, words=_in_order(words), children=tuple(phrases))
