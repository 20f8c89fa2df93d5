"""What the words of a sentence refer to in a conversation, beyond what its readings hold.

Readings say which things there are and how they are related. Across utterances it matters besides
which of them a command is about, which are named as known ("the hydrant is behind the car" speaks
of the hydrant that the task speaks of), which are another one, and which are only to be avoided.
"""

from collections.abc import Callable
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
    ways: tuple[tuple[int, ...], ...] = ()
    """Types that one noun may be any of; the first of them stands for the noun in ``goals``."""

    def may_be(self, kind: int) -> tuple[int, ...]:
        """List the types that the noun of a goal may be, ``kind`` first."""
        return next((way for way in self.ways if way[0] == kind), (kind,))


def spoken_of(tree: Parse, types_of: Callable[[str], tuple[int, ...]]) -> Spoken:
    """Find what a sentence speaks of.

    Args:
        tree: the sentence.
        types_of: the object types that a noun of the sentence may be, one or more.

    Returns:
        What it speaks of.
    """
    goals: list[int] = []
    known: set[int] = set()
    others: set[int] = set()
    avoided: list[tuple[int, bool]] = []
    ways: dict[tuple[int, ...], None] = {}

    def told(phrase: Phrase) -> tuple[int, ...]:
        types = _types_of(phrase, types_of)
        if len(types) > 1:
            ways.setdefault(types)
        return types

    for clause, kind in zip(tree.clauses, tree.kinds, strict=True):
        for leaf in leaves(clause):
            if any("other" in word.senses for word in leaf.words):
                others.update(told(leaf))
        if is_constraint(clause):
            phrases = [child for child in clause.children if child.label == "NP"]
            avoided += [(type_, not one.children) for one in phrases for type_ in told(one)]
        elif kind == COMMAND:
            goals.append(next(iter(told(clause)), NONE))
        else:
            known.update(*(told(child) for child in clause.children if _is_bare(child)))
    return Spoken(
        goals=tuple(goals),
        known=frozenset(known),
        others=frozenset(others),
        avoided=tuple(avoided),
        steps=tuple(one.end for one in tree.measures if one.end is not None),
        ways=tuple(ways),
    )


def _types_of(phrase: Phrase, types_of: Callable[[str], tuple[int, ...]]) -> tuple[int, ...]:
    """List the types that the thing may be which a phrase is about; none where it names none."""
    leaf = head_of(phrase)
    if leaf is not None and is_thing(leaf):
        return (ANYTHING,)
    sense = None if leaf is None else type_sense(leaf)
    return () if sense is None else types_of(sense[_SENSE:])


def _is_bare(phrase: Phrase) -> bool:
    """Tell whether a noun phrase names a thing as known, and says no more of it."""
    texts = {word.text for word in phrase.words}
    return phrase.label == "NP" and not phrase.children and not texts & {"a", "an", "another"}
