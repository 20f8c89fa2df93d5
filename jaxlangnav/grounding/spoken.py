"""What the words of a sentence refer to in a conversation, beyond what its readings hold.

Readings say which things there are and how they are related. Across utterances it matters besides
which of them a command is about, which are named as known ("the hydrant is behind the car" speaks
of the hydrant that the task speaks of), which are another one, and which are only to be avoided.
"""

from dataclasses import dataclass

from jaxlangnav.kinds import ANYTHING
from jaxlangnav.language.constraint import is_constraint
from jaxlangnav.language.phrase import COMMAND, Parse, Phrase
from jaxlangnav.language.reference import head_of, is_thing, leaves, type_sense
from jaxlangnav.messages import NONE

_SENSE = len("type:")


@dataclass(frozen=True, kw_only=True)
class Spoken:
    """What a sentence speaks of; object types by their index."""

    goals: tuple[int, ...] = ()  # of each command: type of what it is about; ANYTHING; NONE: not
    # known
    known: frozenset[int] = frozenset()  # a statement says of the one spoken of before
    others: frozenset[int] = frozenset()  # another one is meant: "the other hydrant"
    avoided: tuple[tuple[int, bool], ...] = ()  # to keep away from, and whether from all of a type
    steps: tuple[tuple[float, float], ...] = ()
    """Where commands end that are told from the robot as it hears them: metres, its frame."""


def spoken_of(tree: Parse, type_names: tuple[str, ...]) -> Spoken:
    """Find what a sentence speaks of.

    Args:
        tree: the sentence.
        type_names: object types.

    Returns:
        What it speaks of.
    """
    goals: list[int] = []
    known: set[int] = set()
    others: set[int] = set()
    avoided: list[tuple[int, bool]] = []
    for clause, kind in zip(tree.clauses, tree.kinds, strict=True):
        for leaf in leaves(clause):
            if any("other" in word.senses for word in leaf.words):
                others.add(_type_of(leaf, type_names))
        if is_constraint(clause):
            phrases = [child for child in clause.children if child.label == "NP"]
            avoided += [(_type_of(one, type_names), not one.children) for one in phrases]
        elif kind == COMMAND:
            goals.append(_type_of(clause, type_names))
        else:
            known |= {_type_of(c, type_names) for c in clause.children if _is_bare(c)}
    return Spoken(
        goals=tuple(goals),
        known=frozenset(known - {NONE}),
        others=frozenset(others - {NONE}),
        avoided=tuple(one for one in avoided if one[0] != NONE),
        steps=tuple(one.end for one in tree.measures if one.end is not None),
    )


def _type_of(phrase: Phrase, type_names: tuple[str, ...]) -> int:
    """Look up the type of the thing that a phrase is about; NONE where it names none."""
    leaf = head_of(phrase)
    if leaf is not None and is_thing(leaf):
        return ANYTHING
    sense = None if leaf is None else type_sense(leaf)
    name = "" if sense is None else sense[_SENSE:]
    return type_names.index(name) if name in type_names else NONE


def _is_bare(phrase: Phrase) -> bool:
    """Tell whether a noun phrase names a thing as known, and says no more of it."""
    texts = {word.text for word in phrase.words}
    return phrase.label == "NP" and not phrase.children and not texts & {"a", "an", "another"}
