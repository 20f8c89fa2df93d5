"""Error messages of refused sentences: one line that names the word and its position."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from jaxlangnav.inputs.object_types import group_of
from jaxlangnav.language.lexicon import REASONS, WORDS, load_lexicon
from jaxlangnav.language.phrase import LanguageError, Phrase, Word
from jaxlangnav.language.reference import is_untyped
from jaxlangnav.language.tokens import RawToken

NOUN = "?noun"
"""Terminal of a token that can only be a noun."""
UNKNOWN_HERE = "unknown word, and no reading fits it; say it in other words"
_NO_READING = "cannot be read here; say it in plainer words, or in commands joined by 'then'"
_LOOKS = "how a thing looks is said before its name, as in 'the red ball'"
_STRONG_REASONS = (REASONS["negation"], REASONS["condition"])
_FUNCTION, _ARTICLES = WORDS["small"], WORDS["pointing_articles"]


@dataclass(frozen=True, kw_only=True)
class Token(RawToken):
    """A word with its terminal in the grammar; a mark has no text here."""

    terminal: str


def explain(tokens: list[Token], index: int) -> LanguageError:
    """Choose the word to blame for a failed parse, and explain why in one line.

    In order: a refused expression; a negation anywhere; among the words up to the failure: a
    condition, the last unsupported or unknown word, a function word or action before, that word.
    ``index`` is the first token that continues no tree, or the number of tokens at the end.
    """
    texts = tuple(token.text for token in tokens)
    for start, token in enumerate(tokens[: index + 1]):
        for words, reason in load_lexicon().refused_expressions.items():
            if texts[start : start + len(words)] == words:
                return LanguageError.at(" ".join(words), token.position, reason)
    refused = load_lexicon().refused
    read = [token for token in tokens[: index + 1] if token.text]
    reasons = {token.position: refused.get(token.text) for token in read}
    strong_tokens = [t for t in read if refused.get(t.text) in _STRONG_REASONS]
    negated = [t for t in tokens if refused.get(t.text) == REASONS["negation"] and _explains(t)]
    first = min([*strong_tokens[:1], *negated[:1]], key=lambda token: token.position, default=None)
    if first is not None:
        reasons[first.position] = refused[first.text]
    stuck = None if index >= len(tokens) or not tokens[index].text else read[-1]
    unknown = [t for t in read if _is_unknown(t) and not _is_parsed_noun(t, tokens, index)]
    suspects = [t for t in reversed(read) if _explains(t) or t in unknown]
    recent = [t for t in read[-4:] if t.text in _FUNCTION and reasons[t.position]]
    recent += [t for t in read[-2:-1] if reasons[t.position] == REASONS["such an action"]]
    if first is None and stuck is not None and stuck.text not in _FUNCTION and _explains(stuck):
        first = stuck
    culprits = [first] if first is not None else [*suspects[:1], *recent[-1:]]
    if culprits:
        position = culprits[0].position
        following = next((t.text for t in tokens if t.position == position + 1), "")
        is_distance = refused.get(following) == REASONS["a distance"]  # "two metres"
        reason = refused[following] if is_distance else reasons[position] or UNKNOWN_HERE
        return _refusal(culprits[:1], reason)
    if stuck is None and (read[-1].text,) in load_lexicon().entries["side"]:
        return _refusal(read[-1:], REASONS["an open end"])
    if stuck is None:
        where = f"'{read[-1].text[:30]}' (word {read[-1].position})"
        line = f"the sentence breaks off after {where}; say all of it, as in 'go to the cone'"
        return LanguageError(line, position=read[-1].position)
    upcoming = [t for t in tokens[index + 1 : index + 3] if _is_unknown(t)]
    reason = _NO_READING if group_of(stuck.text) is None else _LOOKS
    return _refusal(upcoming[:1] or [stuck], UNKNOWN_HERE if upcoming else reason)


def _refusal(words: Sequence[Token | Word], reason: str) -> LanguageError:
    return LanguageError.at(" ".join(w.text[:30] for w in words), words[0].position, reason)


def _is_unknown(token: Token) -> bool:
    """Check whether a word is neither in the lexicon nor a label of the detector."""
    return token.terminal.startswith("?") and token.terminal != NOUN


def _is_parsed_noun(token: Token, tokens: list[Token], index: int) -> bool:
    """Check whether an unknown word was parsed as a noun: "the pillar", with words after it."""
    i = tokens.index(token)
    has_article = [t.text in _ARTICLES for t in tokens[max(i - 2, 0) : i]]
    if i + 1 == len(tokens):  # "the box on the workbench": an earlier word is to blame
        return bool(has_article) and has_article[-1]
    return any(has_article) and i < index and not tokens[i + 1].terminal.startswith("?")


def _explains(token: Token) -> bool:
    """Check whether a refused word explains a failure at any position."""
    return token.text in load_lexicon().refused and token.text not in _FUNCTION | WORDS["silent"]


# -------------------------------------------------- grammatical but doubtful readings
# A wrong reading is worse than a refusal (issue 3): an unknown noun compound that contains a type
# ("car park"), "go by the cone" (past it, or near it?), a fragment or an unknown verb without a
# known word.

_OF_WHAT = "of what kind? name the object"


def _check_compound(phrase: Phrase) -> None:
    """Refuse a noun phrase whose modifier is itself an object type."""
    nouns = [word for word in phrase.words if word.tag.startswith("NN")]
    if phrase.has_sense("foreign"):
        raise _refusal(nouns, "is no object I know; name another")
    for word, following in pairwise(nouns):
        if word.type_sense:
            raise _refusal([word, following], "names no one object; name one")


def _check_verb(clause: Phrase, guessed: set[int]) -> None:
    """Refuse a command in which neither verb nor object is known."""
    verbs = [word for word in clause.words if word.tag.startswith("VB") and not word.senses]
    has_action = any(s.startswith(("action", "constraint")) for w in clause.words for s in w.senses)
    every = clause.all_words()
    is_known = any(word.type_sense and word.position not in guessed for word in every)
    if has_action or is_known or any({"anaphor", "place"} & set(w.senses) for w in every):
        return
    words = [word for word in (*verbs, *every) if word.position in guessed] or verbs or every
    reason = "neither a verb nor an object that I know; say for example 'go to the cone'"
    raise _refusal(words[:1], reason)


def _check_unknown(clause: Phrase, unknown: set[int]) -> None:
    """Refuse too many unknown words: an unknown verb does not explain its object."""
    # "Smash the box" is not "go to the box"; only "to" makes a verb of motion. An unknown verb
    # before an unknown adjective, or three unknown words on one noun, is another language.
    # Words of a rewriting have the position of the replaced word, but have senses.
    guesses = [w for w in clause.words if w.position in unknown and not w.senses]
    verbs = [w for w in guesses if w.tag.startswith("VB")]
    is_motion = any(w.text in ("to", "toward", "towards") for c in clause.children for w in c.words)
    for phrase in clause.walk():
        guessed = [w for w in phrase.words if w.position in unknown and phrase is not clause]
        is_motion &= not guessed
        if len(guessed) > 2:
            raise _refusal(guessed[:1], "one of too many unknown words")
    if verbs and not is_motion:
        raise _refusal(verbs[:1], "a verb I do not know; say for example 'go to the cone'")


def _check_one(phrase: Phrase) -> None:
    """Refuse "the nearest one" without a type; "the one behind it" may be of any type."""
    leaf, *modifiers = phrase.children if phrase.label == "NP" else (phrase.children[0],)
    if leaf.label != "NP" or leaf.children:
        return
    is_known = leaf.has_sense("other") or any(word.type_sense for word in leaf.words)
    words = [word for other in modifiers for word in other.all_words()]
    is_ranked = any("superlative" in word.senses for word in words)
    is_modified = bool(modifiers) and (not is_ranked or any(word.type_sense for word in words))
    if leaf.has_sense("anaphor") and not is_known and not is_modified:
        raise _refusal(leaf.words[-1:], _OF_WHAT)


def _check_place(phrase: Phrase) -> None:
    """Refuse "go to the area": only relations say which place is meant."""
    is_modified = phrase.label == "NP"
    for np in phrase.children[1 if is_modified else 0 :]:
        if np.label == "NP" and not np.children and np.has_sense("place"):
            raise _refusal(np.words[-1:], "which one? say where, as in 'the spot behind the cone'")


def _check_landmark(phrase: Phrase) -> None:
    """Refuse "the hydrant behind the thing on your left": a landmark has a type."""
    figure, *modifiers = phrase.children
    if phrase.label != "NP" or is_untyped(figure):
        return
    for np in (inner for other in modifiers for inner in other.walk()):
        if np.label == "NP" and np.children and is_untyped(np.children[0]):
            raise _refusal(np.children[0].words[-1:], _OF_WHAT)


def _check_selection(phrase: Phrase) -> None:
    """Refuse "between" with one landmark, and two uses of "between" or ranks for one figure."""
    phrases = [part for child in phrase.children[1:] for part in (child, *child.children)]
    between, ranks = ([p for p in phrases if p.has_sense(s)] for s in ("between", "superlative"))
    for again in (*between[1:], *ranks[1:]):
        raise _refusal(_head(again), "said of one thing twice; say one of them")
    if between and phrase.children[0].has_sense("place"):
        raise _refusal(_head(between[0]), REASONS["between"])
    nouns = [word for word in phrase.children[0].all_words() if word.tag.startswith("NN")]
    if phrase.has_sense("between") and len(phrase.children) == 1 and nouns[0].tag != "NNS":
        raise _refusal(_head(phrase), "between that and what? name both")


def _head(phrase: Phrase) -> list[Word]:
    """List the words of a phrase that have senses."""
    return [word for word in phrase.words if word.senses]


def refuse_guesses(clauses: list[Phrase], unknown: set[int]) -> None:
    """Refuse doubtful readings with a LanguageError; ``unknown`` are positions of words."""
    for word in (clause.words[0] for clause in clauses[1:] if clause.words):
        # No connective precedes it.
        if word.tag == "VB" and word.position in unknown:
            reason = "unknown word; it may be a verb or a mistyped relation: say it in other words"
            raise _refusal([word], reason)
    for clause in clauses:
        for phrase in clause.walk():
            if phrase.label == "NP":
                _check_compound(phrase)
            if phrase.children:
                _check_one(phrase)
                _check_place(phrase)
                _check_landmark(phrase)
                _check_selection(phrase)
        _check_unknown(clause, unknown)
        if clause.label == "VP":
            _check_verb(clause, unknown if clause is clauses[0] else set())
            modes = {s: word for word in clause.words for s in word.senses if s.startswith("mode:")}
            if len(modes) > 1:
                reason = "contradicts the manner asked for before; say one of them"
                raise _refusal(list(modes.values())[1:2], reason)
