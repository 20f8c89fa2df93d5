"""From text to a phrase tree, or a refusal of one clear line (section 3.1).

Every word of the sentence is in the tree or the sentence is refused: a relation is never dropped.
Unknown nouns, adjectives, verbs and adverbs get their part of speech from context and are named;
typing errors are repaired and reported. Time is bounded: input is limited in characters and words,
and the parser is polynomial.
"""

from functools import cache

from jaxlangnav.language.check import check
from jaxlangnav.language.constraint import join_constraints
from jaxlangnav.language.grammar import (
    COMMA,
    FULLSTOP,
    UNKNOWN,
    UNKNOWN_ADVERB,
    UNKNOWN_ING,
    NoParseError,
    load_grammar,
)
from jaxlangnav.language.lexicon import TYPE_CLASS, load_lexicon
from jaxlangnav.language.phrase import COMMAND, STATEMENT, LanguageError, Parse
from jaxlangnav.language.reference import Antecedent, resolve
from jaxlangnav.language.refusal import Token, explain
from jaxlangnav.language.spelling import repair
from jaxlangnav.language.tokens import TOKEN, plainly
from jaxlangnav.language.tree import TreeBuilder

MAX_CHARACTERS = 10_000
MAX_WORDS = 64
MAX_UNKNOWN = 8  # more guesses than this are no reading, and their trees are very many
_IGNORED = set("\"'()[]*`“”")
_COMMAS = {",", ":", "-", "–", "—"}


class _Reader:
    """Splits text into tokens, repairing and marking what the lexicon does not know."""

    def __init__(self) -> None:
        self.lexicon = load_lexicon()
        self.vocabulary = _vocabulary()
        self.tokens: list[Token] = []
        self.repairs: list[tuple[str, str]] = []
        self.num_words = 0

    def read(self, text: str) -> None:
        """Read all of a text."""
        text = plainly(text)
        if len(text) > 2 * MAX_CHARACTERS:  # some signs stand for whole words
            raise LanguageError(
                f"the instruction has more than {MAX_CHARACTERS} characters; shorten it"
            )
        for match in TOKEN.finditer(text):
            piece = match.group()
            if piece[0] in ".!?;" or piece in _COMMAS:
                self._mark(COMMA if piece in _COMMAS else FULLSTOP)
            elif piece not in _IGNORED:
                for word in self._split(piece):
                    self._word(word)
        while self.tokens and self.tokens[-1].terminal in (COMMA, FULLSTOP):
            self.tokens.pop()

    def _mark(self, terminal: str) -> None:
        """Add punctuation; a run of marks is its last, and none stands at the beginning."""
        if self.tokens and self.tokens[-1].terminal in (COMMA, FULLSTOP):
            self.tokens.pop()
        if self.tokens:
            self.tokens.append(Token(text="", terminal=terminal, position=self.num_words))

    def _split(self, piece: str) -> list[str]:
        """Part "cone's" and hyphened words of which the lexicon knows the parts."""
        if piece in self.vocabulary:
            return [piece]
        if piece.endswith("'s") and not piece.endswith("'s's"):
            return [*self._split(piece[:-2]), "'s"]
        joined = _compounds().get(piece.replace("-", ""))
        if joined is not None:
            return list(joined)
        parts = piece.split("-")
        return parts if len(parts) > 1 and set(parts) <= self.vocabulary else [piece]

    def _word(self, word: str) -> None:
        """Add a word: known, repaired, or marked unknown."""
        self.num_words += 1
        if self.num_words > MAX_WORDS:
            raise LanguageError(f"the instruction has more than {MAX_WORDS} words; shorten it")
        if not word[0].isalpha() and word not in self.vocabulary:
            raise LanguageError(_symbol_message(word, self.num_words))
        terminal = word
        if word not in self.vocabulary:
            repaired = repair(word)
            if repaired is None:
                terminal = _unknown_mark(word)
            else:
                self.repairs.append((word, repaired))
                word = terminal = repaired
        self.tokens.append(Token(text=word, terminal=terminal, position=self.num_words))


@cache
def _compounds() -> dict[str, tuple[str, ...]]:
    """Find the words of compounds that are written as one: "firehydrant", "fire-hydrant"."""
    entries = load_lexicon().entries[TYPE_CLASS]
    return {"".join(words): words for words in entries if len(words) > 1}


@cache
def _vocabulary() -> frozenset[str]:
    return load_lexicon().vocabulary


def _symbol_message(symbol: str, position: int) -> str:
    what = "this sign is not supported; use words"
    if symbol[0].isdigit():
        what = "numbers are not supported; name a place, as in 'behind the cone'"
    return f"'{symbol[:30]}' (word {position}): {what}"


def _unknown_mark(word: str) -> str:
    """Say what an unknown word can be, by its ending."""
    if word.endswith("ly") and len(word) > 4:
        return UNKNOWN_ADVERB
    if word.endswith("ing") and len(word) > 5:
        return UNKNOWN_ING
    return UNKNOWN


def parse(text: str, earlier: Antecedent | None = None) -> Parse:
    """Parse an instruction of one or more clauses.

    Args:
        text: what the person typed, at most 10,000 characters.
        earlier: what earlier utterances have been about, for "it" and "the one on the left".

    Returns:
        The most probable phrase trees, what was unknown and what was repaired.

    Raises:
        LanguageError: no text, empty, too long, unsupported or not understood; one line that
            names the word and its position.
    """
    if not isinstance(text, str):
        raise LanguageError(f"the instruction is of type {type(text).__name__}, but must be a text")
    if len(text) > MAX_CHARACTERS:
        raise LanguageError(f"the instruction has more than {MAX_CHARACTERS} characters")
    reader = _Reader()
    reader.read(text)
    tokens = reader.tokens
    if not tokens:
        raise LanguageError("the instruction is empty")
    unknown = [(t.text, t.position) for t in tokens if t.terminal.startswith("?")]
    if len(unknown) > MAX_UNKNOWN:
        text, position = unknown[0]
        raise LanguageError(f"'{text[:30]}' (word {position}): unknown word, one of too many")
    try:
        derivation, probability = load_grammar().parse([token.terminal for token in tokens])
    except NoParseError as error:
        raise LanguageError(explain(tokens, error.index)) from None
    builder = TreeBuilder([t.text for t in tokens], [t.position for t in tokens])
    clauses = resolve(builder.build(derivation), earlier)
    check(clauses, {position for _, position in builder.unknown})
    clauses = join_constraints(clauses)
    unknown = [
        (t.text, t.position) for t in tokens if t.terminal in (UNKNOWN, UNKNOWN_ADVERB, UNKNOWN_ING)
    ]
    return Parse(
        instruction=text,
        clauses=tuple(clauses),
        kinds=tuple(STATEMENT if clause.label == "S" else COMMAND for clause in clauses),
        unknown_words=tuple(builder.unknown),
        repairs=tuple(reader.repairs),
        probability=probability,
    )
