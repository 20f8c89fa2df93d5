"""Most probable tree of a packed parse forest, and its conversion to phrases for grounding.

Lark's Earley parser packs all derivations of a sentence in one forest. Viterbi finds the best one,
the inside algorithm its posterior; both are linear in the size of the forest.

Left sides in capitals become phrases; others pass their words and phrases to the parent. "The
nearest cone to the tree" is split as "the cone nearest to the tree", so that both have the same
tree: NP[] over NP[the cone] and PP[nearest to] over NP[the tree].
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from lark.parsers.earley_forest import PackedNode, SymbolNode

from jaxlangnav.language.lexicon import LITERAL_TAGS, LexicalEntry
from jaxlangnav.language.nouns import singular
from jaxlangnav.language.phrase import Phrase, Word
from jaxlangnav.language.refusal import NOUN, Token


class Production(NamedTuple):
    """A rule of the PCFG, with its log-probability, and its expression if it is lexical."""

    left: str
    right: tuple[str, ...]  # nonterminals, or terminals (quoted words, classes of unknown words)
    log_probability: float
    entry: LexicalEntry | None = None  # lexical: the expression


class Derivation(NamedTuple):
    """A node of the most probable tree; leaves are indices of tokens."""

    production: Production
    children: tuple["Derivation | int", ...]


class _NodeScore(NamedTuple):
    """Viterbi score, inside score and best derivation (children in order) of one forest node."""

    log_best: float
    log_sum: float
    children: tuple["Derivation | int", ...]


def read_forest(
    root: SymbolNode, by_rule: Mapping[tuple[str, ...], Production]
) -> tuple[Derivation, float]:
    """Find the best derivation of a packed parse forest and its posterior probability.

    Viterbi and inside algorithms, without recursion; ``by_rule`` maps lark rules to productions.
    """
    memo: dict[int, _NodeScore] = {}

    def score(node: SymbolNode, packed: PackedNode) -> _NodeScore:
        """Compute the scores of one packed alternative of a node."""
        log_best = log_sum = 0.0
        children: tuple[Derivation | int, ...] = ()
        for part in packed.children:
            if not isinstance(part, SymbolNode):
                # ROS 2 installs lark 0.12 in place of 1: there, a token is itself a node.
                children += (getattr(part, "token", part).start_pos,)
                continue
            value = memo[id(part)]
            log_best, log_sum = log_best + value.log_best, log_sum + value.log_sum
            children += value.children
        if node.is_intermediate:
            return _NodeScore(log_best, log_sum, children)
        rule = packed.rule
        production = by_rule[rule.origin.name, *(symbol.name for symbol in rule.expansion)]
        log_p = production.log_probability
        return _NodeScore(log_best + log_p, log_sum + log_p, (Derivation(production, children),))

    stack: list[Any] = [root]
    while stack:
        node = stack[-1]
        parts = [c for p in node.children for c in p.children if isinstance(c, SymbolNode)]
        pending = [child for child in parts if id(child) not in memo]
        if id(node) not in memo and pending:
            stack.extend(pending)
            continue
        stack.pop()
        scores = [score(node, packed) for packed in node.children]
        best = max(scores, key=lambda s: s.log_best)
        max_log_sum = max(s.log_sum for s in scores)
        log_sum = max_log_sum + math.log(sum(math.exp(s.log_sum - max_log_sum) for s in scores))
        memo.setdefault(id(node), _NodeScore(best.log_best, log_sum, best.children))
    best = memo[id(root)]
    derivation: Any = best.children[0]
    return derivation, math.exp(best.log_best - best.log_sum)


# -------------------------------------------- from the most probable derivation to phrases

UNKNOWN, UNKNOWN_ADVERB, UNKNOWN_ING = "?", "?ly", "?ing"
UNKNOWN_WORD_CLASSES = {
    "unknown_noun": ("NN", {UNKNOWN: 1.0, UNKNOWN_ING: 0.1, NOUN: 0.01}),
    "adj": ("JJ", {UNKNOWN: 0.3, UNKNOWN_ING: 0.05}),
    "v_to": ("VB", {UNKNOWN: 0.05}),
    "v_obj": ("VB", {UNKNOWN: 0.05}),
    "g_to": ("VBG", {UNKNOWN_ING: 0.05}),
    "g_obj": ("VBG", {UNKNOWN_ING: 0.05}),
    "adv": ("RB", {UNKNOWN_ADVERB: 0.5}),
}
"""Classes of unknown words → tag, and weight by class relative to the class's known words."""
PUNCTUATION = ("comma", "fullstop")
"""Names of ``MARKS`` in the rules."""
SPLIT_NP = "NPX"


def build_phrases(
    root: Derivation, tokens: Sequence[Token]
) -> tuple[list[Phrase], list[tuple[str, int]]]:
    """Build the clauses of a derivation of ``start``, in order.

    Also returns the words, with positions, whose part of speech was guessed.
    """
    unknown: list[tuple[str, int]] = []

    def word(node: Derivation, index: int, token: Token) -> Word:
        """Build the word of a token under a lexical or literal production."""
        text, position, entry = token.text, token.position, node.production.entry
        if entry is not None:
            return replace(entry[index], text=text, position=position)
        if node.production.left in UNKNOWN_WORD_CLASSES:
            tag, _ = UNKNOWN_WORD_CLASSES[node.production.left]
            if node.production.right != (f'"{NOUN}"',):
                unknown.append((text, position))
            lemma = singular(text) if tag == "NN" else text
            tag = tag if lemma == text else "NNS"
            return Word(text=text, tag=tag, lemma=lemma, position=position)
        return Word(text=text, tag=LITERAL_TAGS.get(text, "IN"), lemma=text, position=position)

    def parts(node: Derivation) -> tuple[list[Word], list[Phrase]]:
        """Collect the words and phrases that a node passes to its parent."""
        left, words, phrases = node.production.left, [], []
        for index, child in enumerate(node.children if left not in PUNCTUATION else ()):
            if isinstance(child, int):
                words.append(word(node, index, tokens[child]))
            else:
                more_words, more_phrases = parts(child)
                words, phrases = words + more_words, phrases + more_phrases
        return ([], [_phrase(left, words, phrases)]) if left[0].isupper() else (words, phrases)

    return parts(root)[1], unknown


def _in_order(words: Iterable[Word]) -> tuple[Word, ...]:
    return tuple(sorted(words, key=lambda word: word.position))


def _phrase(left: str, words: list[Word], phrases: list[Phrase]) -> Phrase:
    """Build a phrase; split superlatives, ordinals and sides from the noun that follows them."""
    label = left.split("_")[0]
    if left == SPLIT_NP:
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
