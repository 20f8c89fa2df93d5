"""From a derivation of the grammar to the phrase tree that grounding reads.

Left sides in capitals become phrases; the others hand their words and phrases up. "The nearest
cone to the tree" is parted as "the cone nearest to the tree", so that one construction has one
tree: NP[] over NP[the cone] and PP[nearest to] over NP[the tree].
"""

from jaxlangnav.language.forest import Derivation
from jaxlangnav.language.grammar import UNKNOWN_TAGS
from jaxlangnav.language.lexicon import plural
from jaxlangnav.language.phrase import Phrase, Word
from jaxlangnav.language.refusal import NOUN

PUNCTUATION = {"comma", "fullstop"}
PARTED = "NPX"


class TreeBuilder:
    """Builds the phrases of one sentence."""

    def __init__(self, texts: list[str], positions: list[int]) -> None:
        """Keep what the tokens stand for.

        Args:
            texts: the word of each token, lower case.
            positions: 1-based position among the words of each token.
        """
        self.unknown: list[tuple[str, int]] = []  # words whose part of speech was guessed
        self.texts = texts
        self.positions = positions

    def build(self, derivation: Derivation) -> list[Phrase]:
        """Build the clauses of a derivation of ``start``, in order."""
        _, phrases = self._parts(derivation)
        return phrases

    def _parts(self, node: Derivation) -> tuple[list[Word], list[Phrase]]:
        """Collect the words and phrases a node hands up."""
        production = node.production
        if production.left in PUNCTUATION:
            return [], []
        words: list[Word] = []
        phrases: list[Phrase] = []
        for index, child in enumerate(node.children):
            if isinstance(child, int):
                words.append(self._word(node, index, child))
                continue
            inner_words, inner_phrases = self._parts(child)
            words += inner_words
            phrases += inner_phrases
        if not production.left[0].isupper():
            return words, phrases
        return [], [_phrase(production.left, words, phrases)]

    def _word(self, node: Derivation, index: int, token: int) -> Word:
        """Make the word of a token under a lexical or literal production."""
        text, position = self.texts[token], self.positions[token]
        entry = node.production.entry
        if entry is not None:
            return Word(
                text=text, tag=entry.tags[index], lemma=entry.lemmas[index],
                senses=entry.senses[index], position=position,
            )  # fmt: skip
        left = node.production.left
        if left in UNKNOWN_TAGS:
            tag = UNKNOWN_TAGS[left]
            if node.production.right != (f'"{NOUN}"',):
                self.unknown.append((text, position))
            is_plural = tag == "NN" and text.endswith("s") and plural(text[:-1]) == text
            lemma = text[:-1] if is_plural else text
            return Word(text=text, tag="NNS" if is_plural else tag, lemma=lemma, position=position)
        return Word(text=text, tag=_LITERAL_TAGS.get(text, "IN"), lemma=text, position=position)


_LITERAL_TAGS = {
    "to": "TO",
    "and": "CC",
    "but": "CC",
    "'s": "POS",
    "face": "VB",
    "out": "RP",
    "is": "VBZ",
    "then": "RB",
    "you": "PRP",
    "both": "DT",
    "where": "WRB",
    "whichever": "WDT",
    "whatever": "WDT",
}


def _phrase(left: str, words: list[Word], phrases: list[Phrase]) -> Phrase:
    """Make a phrase; part superlatives, ordinals and sides from the noun they stand before."""
    label = left.split("_")[0]
    words = sorted(words, key=lambda word: word.position)
    if left == PARTED:
        return _part(words, phrases)
    if label == "NP" and not words and not phrases[0].words:
        return Phrase(label=label, words=(), children=phrases[0].children + tuple(phrases[1:]))
    return Phrase(label=label, words=tuple(words), children=tuple(phrases))


def _part(words: list[Word], phrases: list[Phrase]) -> Phrase:
    """Turn NPX[the cone]{ADJP[nearest], PP[to]{X}} into NP[]{NP[the cone], PP[nearest to]{X}}."""
    base = Phrase(label="NP", words=tuple(words))
    modifier, *rest = phrases
    if rest:
        joined = tuple(sorted(modifier.words + rest[0].words, key=lambda word: word.position))
        modifier = Phrase(label="PP", words=joined, children=rest[0].children)
    return Phrase(label="NP", words=(), children=(base, modifier))
