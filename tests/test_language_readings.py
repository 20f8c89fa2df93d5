"""Sentences as people say them: what each is read as, and which are refused.

``spoken.txt`` holds five sets, each written down with its meaning before the grammar had seen it
(docs/language.md has the first scores). A reading is written in short: ``nav`` or ``find`` (with
the mode), then where to, with what is said of it in brackets; ``@`` marks a region as a goal, a
number behind a relation its rank, ``avoid`` what to keep away from, ``say`` a statement, ``;`` a
new clause.
"""

import pytest
from hand_geometry import SPOKEN

from jaxlangnav.language.labels import rank, sense_of
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import LanguageError, Phrase

REFUSED = "REFUSED"


def thing(phrase: Phrase) -> str:
    """Write a noun phrase with what is said of it."""
    if phrase.children:
        base, *others = phrase.children
        said = "".join(f"[{place(other)}]" for other in others)
        return "@" + said[1:-1] if thing(base) == "place" else thing(base) + said
    marks = [mark for mark in ("other", "same") if sense_of(phrase, mark)]
    is_one = (
        "one" if sense_of(phrase, "anaphor") else "place" if sense_of(phrase, "place") else None
    )
    return " ".join([*marks, sense_of(phrase, "type") or is_one or "?"])


def place(phrase: Phrase) -> str:
    """Write a preposition phrase, an adjective or a relative clause."""
    if phrase.label == "SBAR":
        return "+".join(place(child) for child in phrase.children)
    relation = sense_of(phrase, "relation")
    if relation is None:
        inner = phrase.children[0]
        return thing(inner) if inner.label == "NP" else "@" + place(inner)
    if sense_of(phrase, "between"):
        return "between " + " and ".join(thing(child) for child in phrase.children)
    ranked = f"{relation}{rank(phrase) or ''}"
    return f"{ranked} {thing(phrase.children[0]) if phrase.children else 'robot'}"


def clause(root: Phrase) -> str:
    """Write a clause."""
    if root.label == "S":
        things = [thing(child) for child in root.children if child.label == "NP"]
        said = "".join(f"[{place(child)}]" for child in root.children if child.label != "NP")
        return f"say {things[0]}{said}"
    goals = []
    for child in root.children:
        if child.label == "VP":
            continue
        is_region = child.label != "NP" and sense_of(child, "relation") is not None
        written = thing(child) if child.label == "NP" else place(child)
        goals.append("@" + written if is_region else written)
    kept = [
        thing(leaf) for child in root.children if child.label == "VP" for leaf in child.children
    ]
    if sense_of(root, "constraint"):
        return "avoid " + ",".join(goals + kept)
    mode = sense_of(root, "mode")
    verb = ("find" if sense_of(root, "action") == "find" else "nav") + (f":{mode}" if mode else "")
    return " ".join([verb, ",".join(goals), *(f"avoid {name}" for name in kept)])


def reading(text: str) -> str:
    try:
        return " ; ".join(clause(root) for root in parse(text).clauses)
    except LanguageError:
        return REFUSED


def test_the_sets_are_there():
    assert 1000 < len(SPOKEN) < 1200  # as many as are read below
    assert sum(meaning == REFUSED for _, meaning in SPOKEN) > 200


@pytest.mark.parametrize("start", range(0, 1200, 100))
def test_sentences_are_read_as_meant(start):
    wrong = [
        f"{text}: {reading(text)}, not {meaning}"
        for text, meaning in SPOKEN[start : start + 100]
        if reading(text) != meaning
    ]
    assert not wrong, "\n".join(wrong)
