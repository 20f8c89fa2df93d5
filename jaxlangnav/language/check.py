"""Readings that the grammar allows but that must be refused rather than guessed.

A wrong reading is worse than a refusal (issue 3): a noun compound with a type inside that is no
known compound ("car park"), "go by the cone" (past it, or near it?), a fragment or an unknown verb
with nothing known to hold on to.
"""

from collections.abc import Sequence
from itertools import pairwise

from jaxlangnav.language.phrase import LanguageError, Phrase, Word
from jaxlangnav.language.reference import is_thing

_OF_WHAT = "of what kind? name the object"


def _refuse(words: Sequence[Word], reason: str) -> LanguageError:
    text = " ".join(word.text[:30] for word in words)
    return LanguageError.at(text, words[0].position, reason)


def _check_compound(phrase: Phrase) -> None:
    """Refuse a noun phrase whose modifying noun is an object type of its own."""
    nouns = [word for word in phrase.words if word.tag.startswith("NN")]
    if phrase.says("foreign"):
        raise _refuse(nouns, "is no object I know; name another")
    for word, following in pairwise(nouns):
        if word.type_sense:
            raise _refuse([word, following], "names no one object; name one")


def _check_verb(clause: Phrase, guessed: set[int]) -> None:
    """Refuse a command in which neither verb nor object is known."""
    verbs = [word for word in clause.words if word.tag.startswith("VB") and not word.senses]
    has_action = any(s.startswith(("action", "constraint")) for w in clause.words for s in w.senses)
    said = clause.all_words()
    is_known = any(word.type_sense and word.position not in guessed for word in said)
    if has_action or is_known or any({"anaphor", "place"} & set(w.senses) for w in said):
        return
    words = [one for one in (*verbs, *said) if one.position in guessed] or verbs or said
    reason = "neither a verb nor an object that I know; say for example 'go to the cone'"
    raise _refuse(words[:1], reason)


def _check_unknown(clause: Phrase, unknown: set[int]) -> None:
    """Refuse a guess that rests on a guess: an unknown verb says nothing of its object.

    "Smash the box" is not "go to the box"; only "to" makes a verb of motion. An unknown verb
    before an unknown adjective, or three unknown words on one noun, is another language.
    """
    # What a rule has put in stands where another word stood, and is known by its senses.
    guesses = [w for w in clause.words if w.position in unknown and not w.senses]
    verbs = [w for w in guesses if w.tag.startswith("VB")]
    is_motion = any(w.text in ("to", "toward", "towards") for c in clause.children for w in c.words)
    for phrase in clause.walk():
        guessed = [w for w in phrase.words if w.position in unknown and phrase is not clause]
        if len(guessed) > 2 or (verbs and guessed):
            raise _refuse((verbs or guessed)[:1], "one of too many unknown words")
    if verbs and not is_motion:
        raise _refuse(verbs[:1], "a verb I do not know; say for example 'go to the cone'")


def _check_one(phrase: Phrase) -> None:
    """Refuse "the nearest one" and "the red one" where nothing says one of what.

    "The one nearest to the cone" is of any kind.
    """
    leaf, *others = phrase.children if phrase.label == "NP" else (phrase.children[0],)
    if leaf.label != "NP" or leaf.children:
        return
    is_known = leaf.says("other") or any(word.type_sense for word in leaf.words)
    words = [word for other in others for word in other.all_words()]
    is_ranked = any("superlative" in word.senses for word in words)
    is_told = bool(others) and (not is_ranked or any(word.type_sense for word in words))
    if leaf.says("anaphor") and not is_known and not is_told:
        raise _refuse(leaf.words[-1:], _OF_WHAT)


def _check_landmark(phrase: Phrase) -> None:
    """Refuse "the hydrant behind the thing on your left": a landmark has a type."""
    figure, *others = phrase.children
    if phrase.label != "NP" or is_thing(figure):
        return
    for one in (inner for other in others for inner in other.walk()):
        if one.label == "NP" and one.children and is_thing(one.children[0]):
            raise _refuse(one.children[0].words[-1:], _OF_WHAT)


def _check_between(phrase: Phrase) -> None:
    """Refuse "between" with one landmark, and what is said to lie between twice over."""
    parts = [one for child in phrase.children[1:] for one in (child, *child.children)]
    told = [one for one in parts if one.says("between")]
    if len(told) > 1:
        raise _refuse(_head(told[1]), "said of one thing twice; say one of them")
    nouns = [word for word in phrase.children[0].all_words() if word.tag.startswith("NN")]
    if phrase.says("between") and len(phrase.children) == 1 and nouns[0].tag != "NNS":
        raise _refuse(_head(phrase), "between that and what? name both")


def _head(phrase: Phrase) -> list[Word]:
    """Find the words that carry the senses of a phrase."""
    return [word for word in phrase.words if word.senses]


def refuse_guesses(clauses: list[Phrase], unknown: set[int]) -> None:
    """Refuse what would be a guess.

    Args:
        clauses: roots of the trees, in order.
        unknown: positions of words that the lexicon does not know.

    Raises:
        LanguageError: one line naming the words.
    """
    for first in (clause.words[0] for clause in clauses[1:] if clause.words):
        # No connective stands before it.
        if first.tag == "VB" and first.position in unknown:
            reason = "unknown word; it may be a verb or a mistyped relation: say it in other words"
            raise _refuse([first], reason)
    for clause in clauses:
        for phrase in clause.walk():
            if phrase.label == "NP":
                _check_compound(phrase)
            if phrase.children:
                _check_one(phrase)
                _check_landmark(phrase)
                _check_between(phrase)
        _check_unknown(clause, unknown)
        if clause.label == "VP":
            _check_verb(clause, unknown if clause is clauses[0] else set())
            modes = {s: word for word in clause.words for s in word.senses if s.startswith("mode:")}
            if len(modes) > 1:
                reason = "contradicts the manner asked for before; say one of them"
                raise _refuse(list(modes.values())[1:2], reason)
