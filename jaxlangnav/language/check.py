"""Readings that the grammar allows but that must be refused rather than guessed.

A wrong reading is worse than a refusal (issue 3): a noun compound with a type inside that is no
known compound ("car park"), "go by the cone" (past it, or near it?), a fragment or an unknown verb
with nothing known to hold on to.
"""

from itertools import pairwise

from jaxlangnav.language.phrase import LanguageError, Phrase, Word


def _type_of(word: Word) -> str | None:
    return next((sense for sense in word.senses if sense.startswith("type:")), None)


def _refuse(words: list[Word], reason: str) -> LanguageError:
    text = " ".join(word.text[:30] for word in words)
    where = f"word {words[0].position}"
    return LanguageError(f"'{text}' ({where}): {reason}")


def _check_compound(phrase: Phrase) -> None:
    """Refuse a noun phrase whose modifying noun is an object type of its own."""
    nouns = [word for word in phrase.words if word.tag.startswith("NN")]
    foreign = [word for word in phrase.words if "foreign" in word.senses]
    if foreign:
        words = [w for w in phrase.words if w.tag.startswith("NN")]
        raise _refuse(words, "is no object I know")
    for word, following in pairwise(nouns):
        if _type_of(word) is not None:
            raise _refuse([word, following], "names no one object")


def _check_verb(clause: Phrase) -> None:
    """Refuse a command in which neither verb nor object is known."""
    verbs = [word for word in clause.words if word.tag.startswith("VB") and not word.senses]
    has_action = any(s.startswith(("action", "constraint")) for w in clause.words for s in w.senses)
    types = [word for word in clause.all_words() if _type_of(word) is not None]
    anaphors = [w for w in clause.all_words() if set(w.senses) & {"anaphor", "place"}]
    if has_action or types or anaphors:
        return
    words = verbs or clause.all_words()
    raise _refuse(words[:1], "neither a verb nor an object that I know")


def _check_mode(clause: Phrase) -> None:
    """Refuse a command to be both quick and careful."""
    modes = {s: word for word in clause.words for s in word.senses if s.startswith("mode:")}
    if len(modes) > 1:
        raise _refuse(list(modes.values())[1:2], "contradicts the manner asked for before")


def _check_start(clause: Phrase) -> None:
    """Refuse a later clause that begins with an unknown verb and no connective before it."""
    first = clause.words[:1]
    if first and first[0].tag == "VB" and not first[0].senses:
        raise _refuse(list(first), "unknown word; it may be a verb or a mistyped relation")


def check(clauses: list[Phrase]) -> None:
    """Refuse what would be a guess.

    Args:
        clauses: roots of the trees, in order.

    Raises:
        LanguageError: one line naming the words.
    """
    for clause in clauses[1:]:
        _check_start(clause)
    for clause in clauses:
        for phrase in clause.walk():
            if phrase.label == "NP":
                _check_compound(phrase)
        if clause.label == "VP":
            _check_verb(clause)
            _check_mode(clause)
