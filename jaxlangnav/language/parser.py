"""Parser from text to phrase trees; refusals are one-line errors (section 3.1).

Every word of the sentence is in the tree or the sentence is refused: a relation is never dropped.
Unknown nouns, adjectives, verbs and adverbs get their part of speech from context and are reported;
spelling is corrected and reported. Time is bounded: input is limited in characters and words,
and the parser is polynomial.
"""

import re
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

from jaxlangnav.language.grammar import NoParseError, load_grammar
from jaxlangnav.language.lexicon import REASONS, TYPE_CLASS, load_lexicon
from jaxlangnav.language.measured import measures_of, split_measures
from jaxlangnav.language.nouns import join_nouns, must_be_noun, name_nouns
from jaxlangnav.language.phrase import (
    COMMAND,
    MIN_PROBABILITY,
    STATEMENT,
    LanguageError,
    Parse,
    Phrase,
)
from jaxlangnav.language.reader.features import ReaderSentence
from jaxlangnav.language.reader.model import ReaderModel, load_reader
from jaxlangnav.language.reader.proposals import (
    MIN_OVERRULING,
    Proposal,
    propose_readings,
    safe_log,
)
from jaxlangnav.language.reference import Antecedent, join_constraints, join_topics, resolve
from jaxlangnav.language.refusal import NOUN, Token, explain, refuse_guesses
from jaxlangnav.language.spelling import repair
from jaxlangnav.language.tokens import (
    COMMA_MARK,
    FULLSTOP_MARK,
    MARKS,
    MAX_CHARACTERS,
    TOKEN,
    RawToken,
    join_contractions,
    normalize,
    strip_marks,
)
from jaxlangnav.language.tree import UNKNOWN, UNKNOWN_ADVERB, UNKNOWN_ING, build_phrases

MAX_WORDS = 64
MAX_UNKNOWN = 8  # unknown words; more have very many trees
MAX_PROPOSALS = 8
"""Number of rewritings of a sentence that are parsed, likeliest first."""
_IGNORED_SIGNS = set("\"'[]*`“”")
_COMMAS = {",", ":", "-", "–", "—", "(", ")"}
_SIGNS = {"&": "and", "@": "at", ">": "then", "→": "then", "°": "degrees"}
_REPEATED = re.compile(r"([a-z])\1{2,}")
"""A repeated letter: "pleeease"."""
_BARE_POINT = re.compile(r"(?<![\w.])\.(?=\d)")
"""A decimal point without a digit before it: ".5" is 0.5."""


class Sentence:
    """A sentence text with corrected spelling."""

    def __init__(
        self, text: str, labels: Collection[str], earlier: Antecedent | None = None
    ) -> None:
        """Tokenize a text and correct its spelling."""
        self.text, self.labels, self.earlier = text, frozenset(labels), earlier
        self.vocabulary = load_lexicon().vocabulary
        plain = _BARE_POINT.sub("0.", join_contractions(normalize(text)))
        if len(plain) > 2 * MAX_CHARACTERS:  # some signs expand to words
            raise LanguageError(
                f"the instruction has more than {MAX_CHARACTERS} characters; shorten it"
            )
        tokens: list[RawToken] = []
        num_words = 0
        for match in TOKEN.finditer(plain):
            piece = match.group()
            if piece[0] in ".!?;" or piece in _COMMAS:
                mark = COMMA_MARK if piece in _COMMAS else FULLSTOP_MARK
                tokens.append(RawToken(text=mark, position=num_words))
            elif piece not in _IGNORED_SIGNS:
                for word in self._split(_SIGNS.get(piece, piece)):
                    num_words += 1
                    tokens.append(RawToken(text=word, position=num_words))
        if num_words > MAX_WORDS:
            raise LanguageError(f"the instruction has more than {MAX_WORDS} words; shorten it")
        self.tokens = strip_marks(tokens)
        self.repairs: list[tuple[str, str]] = []
        self._correct_spelling()

    def _correct_spelling(self) -> None:
        """Correct misspelled words; a noun only to a noun, and names not at all."""
        tokens = [_to_token(token) for token in self.tokens]
        names = [token for token in join_nouns(tokens, self.labels) if token.terminal == NOUN]
        named = {name.position + k for name in names for k in range(len(name.text.split()))}
        for index, token in enumerate(tokens):
            is_unknown = token.terminal.startswith("?") and token.text[0].isalpha()
            if not is_unknown or token.position in named:
                continue
            repaired = repair(token.text, is_noun=must_be_noun(tokens, index))
            if repaired is not None:
                self.repairs.append((token.text, repaired))
                self.tokens[index] = replace(self.tokens[index], text=repaired)

    def _split(self, piece: str) -> list[str]:
        """Split "cone's" and hyphenated words whose parts are in the lexicon."""
        if piece in self.vocabulary:
            return [piece]
        if piece.endswith("'s") and not piece.endswith("'s's"):
            return [*self._split(piece[:-2]), "'s"]
        joined = piece.replace("-", "")
        if joined in _compounds():
            return list(_compounds()[joined])
        if joined in self.labels:  # "the white-board"
            return [joined]
        short = _REPEATED.sub(r"\1", piece)
        if short in self.vocabulary:
            return [short]
        parts = piece.split("-")
        return parts if len(parts) > 1 and set(parts) <= self.vocabulary else [piece]


def _to_token(spoken: RawToken) -> Token:
    """Build the grammar token of a word or mark, with its terminal."""
    text = terminal = spoken.text
    if text in MARKS:
        text = ""
    elif text not in load_lexicon().vocabulary:
        is_adverb, is_verb = text.endswith("ly"), text.endswith("ing")
        terminal = UNKNOWN_ADVERB if is_adverb and len(text) > 4 else UNKNOWN
        terminal = UNKNOWN_ING if is_verb and len(text) > 5 else terminal
    return Token(text=text, terminal=terminal, position=spoken.position)


@cache
def _compounds() -> dict[str, tuple[str, ...]]:
    entries = load_lexicon().entries[TYPE_CLASS]
    return {"".join(words): words for words in entries if len(words) > 1}


def _check_symbols(tokens: list[Token]) -> None:
    for index, (text, position) in enumerate((token.text, token.position) for token in tokens):
        is_noun = tokens[index].terminal == NOUN  # "room 12"
        if is_noun or not text or text[0].isalpha() or text in load_lexicon().vocabulary:
            continue
        reason = "this sign is not supported; use words"
        if text[0].isdigit():
            reason = "numbers are not supported; name a place, as in 'behind the cone'"
            following = tokens[index + 1].text if index + 1 < len(tokens) else ""
            is_distance = load_lexicon().refused.get(following) == REASONS["a distance"]
            reason = REASONS["a distance"] if is_distance or text[-1] == "m" else reason
        raise LanguageError.at(text[:30], position, reason)


def parse(
    text: str,
    labels: Collection[str] = (),
    earlier: Antecedent | None = None,
    *,
    is_rewritten: bool = True,
    least_probability: float = MIN_PROBABILITY,
) -> Parse:
    """Parse an instruction of one or more clauses.

    Args:
        text: what the person typed, at most 10,000 characters.
        labels: names of objects that are always nouns, such as the labels of a detector.
        earlier: antecedent from earlier utterances, for "it" and "the one on the left".
        is_rewritten: whether the trained reader may rewrite it; otherwise only the grammar is used.
        least_probability: threshold on the probability, in [0, 1], that the reader's rewriting
            means what was said; below, it is refused.

    Returns:
        The most probable phrase trees, unknown words and corrections.

    Raises:
        LanguageError: not a string, empty, too long, unsupported or not understood; one line that
            names the word and its position.
    """
    if not isinstance(text, str):
        raise LanguageError(f"the instruction is of type {type(text).__name__}, but must be a text")
    if len(text) > MAX_CHARACTERS:
        raise LanguageError(f"the instruction has more than {MAX_CHARACTERS} characters")
    sentence = Sentence(text, labels, earlier)
    if not sentence.tokens:
        raise LanguageError("the instruction is empty")
    if not is_rewritten:
        return parse_tokens(sentence, sentence.tokens, is_measured=False)
    try:
        verbatim = parse_tokens(sentence, sentence.tokens)
    except LanguageError as error:
        rewritings = [] if error.position is None else parse_rewritings(sentence)
        is_accepted = rewritings and (
            load_reader().accept(acceptance_features(rewritings)) >= least_probability
        )
        if not is_accepted:
            raise
        return rewritings[0].parse
    likeliest = next(iter(parse_rewritings(sentence, verbatim)), None)
    return likeliest.parse if likeliest and likeliest.probability >= MIN_OVERRULING else verbatim


class Rewriting(NamedTuple):
    """A meaning that a sentence may have in the controlled language."""

    probability: float  # by the reader, of all its wordings
    parse: Parse
    proposal: Proposal  # its likeliest wording


def acceptance_features(rewritings: Sequence[Rewriting]) -> dict[str, float]:
    """Describe the likeliest of a sentence's rewritings, at least one, for ``ReaderModel.accept``.

    Its edits, and how probable it is beside the others and beside refusal.
    """
    best = rewritings[0]
    return {
        **best.proposal.features,
        "bias": 1.0,
        "log p": safe_log(best.probability),
        "log other": safe_log(1.0 - best.probability),
        "log second": safe_log(rewritings[1].probability if rewritings[1:] else 0.0),
    }


def parse_rewritings(
    sentence: Sentence, verbatim: Parse | None = None, *, reader: ReaderModel | None = None
) -> list[Rewriting]:
    """Parse the reader's proposals, and sum the probabilities of those of one meaning."""
    proposals = propose_readings(
        sentence.tokens, sentence.labels, is_readable=verbatim is not None, model=reader
    )
    meanings: dict[object, Rewriting] = {}
    for proposal in proposals[:MAX_PROPOSALS]:
        parsed = verbatim
        if parsed is None or list(proposal.tokens) != sentence.tokens:
            try:
                parsed = parse_tokens(sentence, list(proposal.tokens), is_located=False)
            except LanguageError:
                continue
            parsed = replace(parsed, rewrites=proposal.changes, unread=proposal.left_out)
        meaning = (*map(_meaning, parsed.clauses), parsed.kinds, parsed.measures)
        first = meanings.get(meaning, Rewriting(0.0, parsed, proposal))
        total = first.probability + proposal.probability
        meanings[meaning] = first._replace(probability=total)
    return sorted(meanings.values(), key=lambda rewriting: -rewriting.probability)


def _meaning(phrase: Phrase) -> tuple[Any, ...]:
    """Build a key of a tree, equal for "go to the cone", "drive up to the cone", "the cone"."""
    children = tuple(map(_meaning, phrase.children))
    if phrase.label not in ("VP", "PP"):
        return (phrase.head, *children)
    senses = {sense for word in phrase.words for sense in word.senses} - {"action:navigate"}
    return (*sorted(senses), *children) if senses or len(children) != 1 else children[0]


def parse_tokens(
    sentence: Sentence, words: list[RawToken], *, is_measured: bool = True, is_located: bool = True
) -> Parse:
    """Parse tokens by the grammar alone; ``is_located``: locate the cause of a failure."""
    spoken, measures = split_measures(words) if is_measured else (words, [])
    tokens = join_nouns([_to_token(token) for token in spoken], sentence.labels)
    _check_symbols(tokens)
    tokens = [
        replace(token, terminal=UNKNOWN)  # "the lily"
        if token.terminal == UNKNOWN_ADVERB and must_be_noun(tokens, index)
        else token
        for index, token in enumerate(tokens)
    ]
    unknown = [t for t in tokens if t.terminal.startswith("?") and t.terminal != NOUN]
    if len(unknown) > MAX_UNKNOWN:
        first = unknown[0]
        raise LanguageError.at(first.text[:30], first.position, "unknown word, one of too many")
    try:
        derivation, probability = load_grammar().parse(
            [token.terminal for token in tokens], is_end_found=is_located
        )
    except NoParseError as error:
        raise explain(tokens, error.index) from None
    phrases, guesses = build_phrases(derivation, tokens)
    clauses = join_topics(resolve([*map(name_nouns, phrases)], sentence.earlier))
    refuse_guesses(clauses, {position for _, position in guesses})
    clauses = join_constraints(clauses)
    said = ReaderSentence(tuple(token.text for token in words), sentence.labels)
    if said.correction < len(words):  # the grammar would read both as commands
        word = words[said.correction]
        raise LanguageError.at(word.text, word.position, REASONS["amends"])
    return Parse(
        instruction=sentence.text,
        clauses=tuple(clauses),
        kinds=tuple(STATEMENT if clause.label == "S" else COMMAND for clause in clauses),
        unknown_words=tuple(guesses),
        repairs=tuple(sentence.repairs),
        probability=probability,
        measures=measures_of(clauses, measures),
    )
