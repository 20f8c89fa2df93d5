"""From text to a phrase tree, or a refusal of one clear line (section 3.1).

Every word of the sentence is in the tree or the sentence is refused: a relation is never dropped.
Unknown nouns, adjectives, verbs and adverbs get their part of speech from context and are named;
typing errors are repaired and reported. Time is bounded: input is limited in characters and words,
and the parser is polynomial.
"""

import re
from collections.abc import Collection
from dataclasses import replace
from functools import cache

from jaxlangnav.language.grammar import NoParseError, load_grammar
from jaxlangnav.language.lexicon import REASONS, TYPE_CLASS, load_lexicon
from jaxlangnav.language.measured import of_clauses, take_out
from jaxlangnav.language.nouns import is_noun_place, join_nouns, name_nouns
from jaxlangnav.language.phrase import COMMAND, LEAST_PROBABILITY, STATEMENT, LanguageError, Parse
from jaxlangnav.language.reader.proposals import propose_readings
from jaxlangnav.language.reference import Antecedent, join_constraints, resolve
from jaxlangnav.language.refusal import NOUN, Token, explain, refuse_guesses
from jaxlangnav.language.spelling import repair
from jaxlangnav.language.tokens import (
    COMMA_MARK,
    FULLSTOP_MARK,
    MARKS,
    TOKEN,
    SpokenToken,
    join_contractions,
    plainly,
    without_idle_marks,
)
from jaxlangnav.language.tree import UNKNOWN, UNKNOWN_ADVERB, UNKNOWN_ING, build_phrases

MAX_CHARACTERS = 10_000
MAX_WORDS = 64
MAX_UNKNOWN = 8  # more guesses than this are no reading, and their trees are very many
LEAST_TO_OVERRULE = 0.7
"""Of another reading of a sentence that can be read as it stands: at less it is read so."""
_IGNORED = set("\"'[]*`“”")
_COMMAS = {",", ":", "-", "–", "—", "(", ")"}
_SIGNS = {"&": "and", "@": "at", ">": "then", "→": "then"}
_DRAWN = re.compile(r"([a-z])\1{2,}")
"""A letter that is drawn out: "pleeease"."""

_CARRIED = re.compile(
    r"(?:deliver|take|bring|carry|get|run|haul|ferry|transport) "
    r"(?:it|that|them|those|these)\b"
)
"""Who has spoken of a thing before asks to bring that thing, which no robot here can do."""


class _Reader:
    """A text split into words and marks, what is mistyped repaired."""

    def __init__(
        self, text: str, labels: Collection[str], earlier: Antecedent | None = None
    ) -> None:
        """Read all of a text."""
        self.text, self.labels, self.earlier = text, frozenset(labels), earlier
        self.vocabulary = load_lexicon().vocabulary
        plain = join_contractions(plainly(text))
        if len(plain) > 2 * MAX_CHARACTERS:  # some signs stand for whole words
            raise LanguageError(
                f"the instruction has more than {MAX_CHARACTERS} characters; shorten it"
            )
        said: list[SpokenToken] = []
        num_words = 0
        for match in TOKEN.finditer(plain):
            piece = match.group()
            if piece[0] in ".!?;" or piece in _COMMAS:
                mark = COMMA_MARK if piece in _COMMAS else FULLSTOP_MARK
                said.append(SpokenToken(text=mark, position=num_words))
            elif piece not in _IGNORED:
                for word in self._split(_SIGNS.get(piece, piece)):
                    num_words += 1
                    said.append(SpokenToken(text=word, position=num_words))
        if num_words > MAX_WORDS:
            raise LanguageError(f"the instruction has more than {MAX_WORDS} words; shorten it")
        self.tokens = without_idle_marks(said)
        self.repairs: list[tuple[str, str]] = []
        self._mend()

    def _mend(self) -> None:
        """Repair what is mistyped; a noun only to a noun, and no part of a name at all."""
        tokens = [_to_token(one) for one in self.tokens]
        names = [one for one in join_nouns(tokens, self.labels) if one.terminal == NOUN]
        named = {one.position + k for one in names for k in range(len(one.text.split()))}
        for index, token in enumerate(tokens):
            is_unknown = token.terminal.startswith("?") and token.text[0].isalpha()
            if not is_unknown or token.position in named:
                continue
            repaired = repair(token.text, is_noun=is_noun_place(tokens, index))
            if repaired is not None:
                self.repairs.append((token.text, repaired))
                self.tokens[index] = replace(self.tokens[index], text=repaired)

    def _split(self, piece: str) -> list[str]:
        """Part "cone's" and hyphened words of which the lexicon knows the parts."""
        if piece in self.vocabulary:
            return [piece]
        if piece.endswith("'s") and not piece.endswith("'s's"):
            return [*self._split(piece[:-2]), "'s"]
        joined = piece.replace("-", "")
        if joined in _compounds():
            return list(_compounds()[joined])
        if joined in self.labels:  # "the white-board"
            return [joined]
        short = _DRAWN.sub(r"\1", piece)
        if short in self.vocabulary:
            return [short]
        parts = piece.split("-")
        return parts if len(parts) > 1 and set(parts) <= self.vocabulary else [piece]


def _to_token(spoken: SpokenToken) -> Token:
    """Say what a word or a mark can be to the grammar."""
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


def _check_symbols(spoken: list[SpokenToken]) -> None:
    for index, one in enumerate(spoken):
        if one.text in MARKS or one.text[0].isalpha() or one.text in load_lexicon().vocabulary:
            continue
        what = "this sign is not supported; use words"
        if one.text[0].isdigit():
            what = "numbers are not supported; name a place, as in 'behind the cone'"
            following = spoken[index + 1].text if index + 1 < len(spoken) else ""
            refused = load_lexicon().refused
            if refused.get(following) == REASONS["a distance"] or one.text[-1] == "m":
                what = REASONS["a distance"]
        raise LanguageError.at(one.text[:30], one.position, what)


def split_text(text: str, labels: Collection[str] = ()) -> list[SpokenToken]:
    """Split a text into words and marks, typing errors repaired; ``labels`` as of ``parse``.

    Raises:
        LanguageError: it has more words or characters than are read.
    """
    return _Reader(text, labels).tokens


def parse(
    text: str,
    labels: Collection[str] = (),
    earlier: Antecedent | None = None,
    *,
    is_rewritten: bool = True,
    least_probability: float = LEAST_PROBABILITY,
) -> Parse:
    """Parse an instruction of one or more clauses.

    Args:
        text: what the person typed, at most 10,000 characters.
        labels: names of things that are nouns whatever else they may be, such as those that a
            detector tells apart.
        earlier: what earlier utterances have been about, for "it" and "the one on the left".
        is_rewritten: whether other wordings are read; without, as the grammar alone reads it.
        least_probability: of what the trained reader makes of it, in [0, 1]; at less it is refused.

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
    reader = _Reader(text, labels, earlier)
    if not reader.tokens:
        raise LanguageError("the instruction is empty")
    if not is_rewritten:
        return _read(reader, reader.tokens, is_measured=False)
    try:
        as_said = _read(reader, reader.tokens)
    except LanguageError as error:
        if error.position is None:
            raise
        found = _read_freely(reader, None, least_probability)
        if found is None:
            raise
        return found
    return _read_freely(reader, as_said, LEAST_TO_OVERRULE) or as_said


def _read_freely(reader: _Reader, as_said: Parse | None, least: float) -> Parse | None:
    """Read a sentence by its likeliest meaning of at least ``least``, or as it stands, or None."""
    # Sentences of one meaning share their probabilities.
    found: dict[object, tuple[float, Parse]] = {}
    proposals = propose_readings(reader.tokens, reader.labels, is_readable=as_said is not None)
    probability, best, unread = 0.0, None, sum(one.probability for one in proposals)
    for one in proposals:
        others = [share for share, read in found.values() if read is not best]
        if probability + unread < least or (
            probability >= least and probability > max(others, default=0.0) + unread
        ):
            break  # whatever the rest may mean, this is decided
        unread -= one.probability
        if reader.earlier is not None and any(_CARRIED.search(was) for was, _ in one.changes):
            continue
        if list(one.tokens) == reader.tokens and as_said is not None:
            read = as_said
        else:
            try:
                read = _read(reader, list(one.tokens), is_blame_sought=False)
            except LanguageError:
                continue
            read = replace(read, rewrites=one.changes, unread=one.left_out)
        meaning = (*map(str, read.clauses), read.kinds, read.measures)
        share, first = found.get(meaning, (0.0, read))
        found[meaning] = (share + one.probability, first)
        probability, best = max(found.values(), key=lambda one: one[0])
    return best if probability >= least else as_said


def _read(
    reader: _Reader,
    said: list[SpokenToken],
    *,
    is_measured: bool = True,
    is_blame_sought: bool = True,
) -> Parse:
    """Read the words of an instruction; a refusal names the true cause where that is sought."""
    spoken, measured = take_out(said) if is_measured else (said, [])
    _check_symbols(spoken)
    tokens = join_nouns([_to_token(one) for one in spoken], reader.labels)
    tokens = [
        replace(one, terminal=UNKNOWN)  # "the lily"
        if one.terminal == UNKNOWN_ADVERB and is_noun_place(tokens, index)
        else one
        for index, one in enumerate(tokens)
    ]
    unknown = [one for one in tokens if one.terminal.startswith("?") and one.terminal != NOUN]
    if len(unknown) > MAX_UNKNOWN:
        first = unknown[0]
        raise LanguageError(
            f"'{first.text[:30]}' (word {first.position}): unknown word, one of too many"
        )
    try:
        derivation, probability = load_grammar().parse(
            [token.terminal for token in tokens], is_end_found=is_blame_sought
        )
    except NoParseError as error:
        raise explain(tokens, error.index) from None
    phrases, guessed = build_phrases(derivation, tokens)
    clauses = resolve([*map(name_nouns, phrases)], reader.earlier)
    refuse_guesses(clauses, {position for _, position in guessed})
    clauses = join_constraints(clauses)
    return Parse(
        instruction=reader.text,
        clauses=tuple(clauses),
        kinds=tuple(STATEMENT if clause.label == "S" else COMMAND for clause in clauses),
        unknown_words=tuple(guessed),
        repairs=tuple(reader.repairs),
        probability=probability,
        measures=of_clauses(clauses, measured),
    )
