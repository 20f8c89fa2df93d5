"""Symbol spaces: what a phrase may mean (sections 3.1, 3.3 and 4.1).

The annotation space knows no world: object types, regions (a relation to a type, or to the robot)
and relations (a figure type in a region). With 8 types that is 8 + 54 + 432 = 494 symbols.
The behavior space is that of one world of n objects: noun and preposition phrases ground to n
objects and 7 n regions (the six relations and "at"), verb phrases to 2 actions, 3 modes, 7 n goal
regions and 7 n constraint regions.

A set of symbols is a boolean vector over a space: one correspondence variable per symbol.
"""

import dataclasses
import itertools
from collections.abc import Hashable, Iterable, Sequence
from functools import cached_property
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from jaxlangnav.language.phrase import Phrase
from jaxlangnav.messages import ACTIONS, MODES, NONE, REGIONS, RELATIONS, ROBOT

OBJECT, REGION, RELATION, ACTION, MODE, GOAL, CONSTRAINT = range(7)
KINDS = ("object", "region", "relation", "action", "mode", "goal", "constraint")
NUM_RELATIONS = len(RELATIONS)
NUM_REGIONS = len(REGIONS)
VERB_LABELS = ("VP", "S")
"""Labels of phrases that ground to actions, modes, goals and constraints."""
Symbol = TypeVar("Symbol", bound=Hashable)


class Symbols(Generic[Symbol]):
    """Symbols in the order of their correspondence variables, all different."""

    @cached_property
    def symbols(self) -> Sequence[Symbol]:
        """Every symbol in that order."""
        raise NotImplementedError

    @property
    def size(self) -> int:
        """S, how many symbols there are."""
        return len(self.symbols)

    @cached_property
    def index(self) -> dict[Symbol, int]:
        """Where each symbol stands."""
        return {symbol: i for i, symbol in enumerate(self.symbols)}

    def expressible(self, phrase: Phrase) -> range:
        """Find which symbols a phrase may express: each has a factor there."""
        return range(self.size)

    def mask(self, symbols: Iterable[Symbol]) -> np.ndarray:
        """Turn symbols into a set over the space.

        Args:
            symbols: members; each must belong to the space.

        Returns:
            bool[S].
        """
        expressed = np.zeros(self.size, bool)
        for symbol in symbols:
            expressed[self.index[symbol]] = True
        return expressed

    def members(self, expressed: np.ndarray) -> tuple[Symbol, ...]:
        """List the symbols of a set, in the order of the space."""
        return tuple(itertools.compress(self.symbols, expressed))


class Annotation(NamedTuple):
    """One annotation symbol: an object type, a region or a relation."""

    kind: int  # OBJECT, REGION or RELATION
    figure: int  # type index; NONE for a region
    relation: int  # relation index; NONE for an object
    landmark: int  # type index or ROBOT; NONE for an object


class BehaviorSymbol(NamedTuple):
    """One behavior symbol of a world."""

    kind: int  # any but RELATION
    relation: int  # region index for regions, goals and constraints; NONE otherwise
    slot: int  # object slot, action or mode


def object_symbol(figure: int) -> Annotation:
    """Build the symbol of an object type."""
    return Annotation(OBJECT, figure, NONE, NONE)


def region_symbol(relation: int, landmark: int) -> Annotation:
    """Build the symbol of a region; ``landmark`` is a type index or ROBOT."""
    return Annotation(REGION, NONE, relation, landmark)


def relation_symbol(figure: int, relation: int, landmark: int) -> Annotation:
    """Build the symbol of a figure in a region; ``landmark`` is a type index or ROBOT."""
    return Annotation(RELATION, figure, relation, landmark)


@dataclasses.dataclass(frozen=True)
class NamedSymbols(Symbols[str]):
    """Anyone's symbols, by their names."""

    names: Sequence[str]

    @cached_property
    def symbols(self) -> Sequence[str]:
        """The names."""
        return self.names


@dataclasses.dataclass(frozen=True)
class AnnotationSpace(Symbols[Annotation]):
    """All annotation symbols over ``num_types`` object types, objects first, relations last."""

    num_types: int

    @property
    def num_landmarks(self) -> int:
        """Types and the robot; the robot has the last landmark index."""
        return self.num_types + 1

    @property
    def num_regions(self) -> int:
        """6 relations × landmarks."""
        return NUM_RELATIONS * self.num_landmarks

    @property
    def size(self) -> int:
        """S, symbols of a phrase."""
        return self.num_types + self.num_regions * (1 + self.num_types)

    @cached_property
    def symbols(self) -> tuple[Annotation, ...]:
        """Every symbol in the order of the correspondence variables."""
        landmarks = (*range(self.num_types), ROBOT)
        regions = [(r, m) for r in range(NUM_RELATIONS) for m in landmarks]
        return (
            *(object_symbol(t) for t in range(self.num_types)),
            *(region_symbol(r, m) for r, m in regions),
            *(relation_symbol(f, r, m) for f in range(self.num_types) for r, m in regions),
        )

    def parts(self, expressed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """View a set as objects bool[T], regions bool[6, L] and relations bool[T, 6, L]."""
        first, second = self.num_types, self.num_types + self.num_regions
        shape = (NUM_RELATIONS, self.num_landmarks)
        return (
            expressed[:first],
            expressed[first:second].reshape(shape),
            expressed[second:].reshape(self.num_types, *shape),
        )


@dataclasses.dataclass(frozen=True)
class BehaviorSpace(Symbols[BehaviorSymbol]):
    """All behavior symbols of a world of ``num_objects`` object slots.

    Objects and regions come first (those of noun and preposition phrases), then actions, modes,
    goals and constraints (those of verb phrases).
    """

    num_objects: int

    @property
    def num_regions(self) -> int:
        """7 regions an object."""
        return NUM_REGIONS * self.num_objects

    @property
    def num_noun(self) -> int:
        """Symbols of a noun or preposition phrase."""
        return self.num_objects + self.num_regions

    @property
    def num_verb(self) -> int:
        """Symbols of a verb phrase."""
        return len(ACTIONS) + len(MODES) + 2 * self.num_regions

    @property
    def size(self) -> int:
        """Symbols of both kinds of phrase together."""
        return self.num_noun + self.num_verb

    @cached_property
    def symbols(self) -> tuple[BehaviorSymbol, ...]:
        """Every symbol in the order of the correspondence variables."""
        places = [(r, i) for r in range(NUM_REGIONS) for i in range(self.num_objects)]
        return (
            *(BehaviorSymbol(OBJECT, NONE, i) for i in range(self.num_objects)),
            *(BehaviorSymbol(REGION, r, i) for r, i in places),
            *(BehaviorSymbol(ACTION, NONE, a) for a in range(len(ACTIONS))),
            *(BehaviorSymbol(MODE, NONE, m) for m in range(len(MODES))),
            *(BehaviorSymbol(GOAL, r, i) for r, i in places),
            *(BehaviorSymbol(CONSTRAINT, r, i) for r, i in places),
        )

    def expressible(self, phrase: Phrase) -> range:
        """Find which symbols a phrase may express: those of verb phrases, or of others."""
        is_verb = phrase.label in VERB_LABELS
        return range(self.num_noun, self.size) if is_verb else range(self.num_noun)

    def part(self, expressed: np.ndarray, kind: int) -> np.ndarray:
        """View one kind of symbol of a set.

        Args:
            expressed: [..., S] over the space.
            kind: OBJECT, REGION, ACTION, MODE, GOAL or CONSTRAINT.

        Returns:
            [..., n], [..., 7, n], [..., 2] or [..., 3].
        """
        begin, end = self.span(kind)
        values = expressed[..., begin:end]
        if kind in (REGION, GOAL, CONSTRAINT):
            return values.reshape(*values.shape[:-1], NUM_REGIONS, self.num_objects)
        return values

    def span(self, kind: int) -> tuple[int, int]:
        """Find where one kind of symbol begins and ends."""
        sizes = (
            (OBJECT, self.num_objects),
            (REGION, self.num_regions),
            (ACTION, len(ACTIONS)),
            (MODE, len(MODES)),
            (GOAL, self.num_regions),
            (CONSTRAINT, self.num_regions),
        )
        begin = 0
        for other, size in sizes:
            if other == kind:
                return begin, begin + size
            begin += size
        raise ValueError(f"{KINDS[kind]} is no behavior symbol")
