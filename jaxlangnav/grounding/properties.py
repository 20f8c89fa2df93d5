"""The engine's two symbol spaces: what is seen of annotations and of behaviors (eq. 4).

The device form of the behavior part is ``behavior_odds``, with the words contracted in before.
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from jaxlangnav.grounding.annotation_properties import annotation_table, rank_columns, stack_columns
from jaxlangnav.grounding.behavior_properties import (
    ChildGroundings,
    behavior_names,
    behavior_tables,
    lies_in,
)
from jaxlangnav.grounding.correspondence import KIND, RANK, Block, Described
from jaxlangnav.grounding.model import (
    ANNOTATION_KINDS,
    BEHAVIOR_KINDS,
    RESTRICTORS,
    Senses,
    senses_of,
)
from jaxlangnav.grounding.symbols import (
    CONSTRAINT,
    GOAL,
    KINDS,
    NUM_REGIONS,
    OBJECT,
    REGION,
    VERB_LABELS,
    AnnotationSpace,
    BehaviorSpace,
    Path,
)
from jaxlangnav.grounding.worlds import World
from jaxlangnav.language.phrase import Phrase
from jaxlangnav.relations.table import NUM_RANKS

_annotation_space = functools.cache(AnnotationSpace)
_behavior_space = functools.cache(BehaviorSpace)


@functools.cache
def property_names() -> Mapping[str, tuple[str, ...]]:
    """Name the columns of the weights, F of every kind of symbol, as files of weights do."""
    nothing = Senses(*[frozenset()] * 5, is_robot=False)
    names, _ = annotation_table(_annotation_space(1), nothing, [])
    own = {KIND: names, RANK: tuple(rank_columns(nothing))}
    return MappingProxyType(own | behavior_names())


@dataclasses.dataclass(frozen=True)
class Annotations:
    """The annotation symbols as a space; there is no world yet."""

    type_names: tuple[str, ...]  # object types in the order of their indices

    @property
    def columns(self) -> Mapping[str, Sequence[str]]:
        """Names of the properties of symbols and ranks."""
        return {kind: property_names()[kind] for kind in ANNOTATION_KINDS}

    def symbols_in(self, world: None) -> AnnotationSpace:
        """List the symbols over the object types."""
        return _annotation_space(len(self.type_names))

    def describe(self, phrase: Phrase, path: Path, world: None) -> Described:
        """Describe the symbols of a phrase, and the ranks that its words may give a region."""
        space, senses = self.symbols_in(world), senses_of(phrase, self.type_names)

        def given(children: Sequence[np.ndarray]) -> Mapping[str, Block]:
            return {KIND: Block(slice(None), annotation_table(space, senses, children)[1])}

        return Described(given, stack_columns((NUM_RANKS,), rank_columns(senses)))


@dataclasses.dataclass(frozen=True)
class Behaviors:
    """The behavior symbols of placed objects as a space."""

    type_names: tuple[str, ...]  # object types in the order of their indices
    rank: Mapping[Path, int]  # that each phrase gives its region: 0, 1 nearest, 2 second, ...

    @property
    def columns(self) -> Mapping[str, Sequence[str]]:
        """Names of the properties of every kind of symbol."""
        return {kind: property_names()[kind] for kind in BEHAVIOR_KINDS}

    def symbols_in(self, world: World) -> BehaviorSpace:
        """List the symbols of the objects of a world, the robot last."""
        return _behavior_space(world.object_type.shape[0])

    def describe(self, phrase: Phrase, path: Path, world: World) -> Described:
        """Describe the symbols of a phrase; those of empty object slots are left out."""
        space, senses = self.symbols_in(world), senses_of(phrase, self.type_names)
        is_verb = phrase.label in VERB_LABELS
        below = [
            (child.label in RESTRICTORS, ranks_meant(child, (*path, i), self.rank, self.type_names))
            for i, child in enumerate(phrase.children)
        ]

        def given(children: Sequence[np.ndarray]) -> Mapping[str, Block]:
            joined = _child_groundings(world, space, below, children)
            tables = behavior_tables(world, is_verb, senses, joined)
            return {kind: _block(world, space, kind, one) for kind, one in tables.items()}

        return Described(given)


def _child_groundings(
    world: World,
    space: BehaviorSpace,
    below: Sequence[tuple[bool, np.ndarray]],
    children: Sequence[np.ndarray],
) -> ChildGroundings:
    """Join what child phrases, (is a restrictor, i[7] ranks), express of S in a world."""
    every = np.any([*children, np.zeros(space.size, bool)], axis=0)
    lies = world.is_object.copy()
    for (is_restrictor, rank), expressed in zip(below, children, strict=True):
        if is_restrictor:
            places = space.part(expressed, REGION) | space.part(expressed, GOAL)
            lies &= lies_in(world, places, rank)
    return ChildGroundings(
        objects=space.part(every, OBJECT),
        regions=space.part(every, REGION) | space.part(every, GOAL),
        constraints=space.part(every, CONSTRAINT),
        lies=lies,
        is_restricted=any(is_restrictor for is_restrictor, _ in below),
        has_children=bool(children),
    )


def _block(world: World, space: BehaviorSpace, kind: str, table: np.ndarray) -> Block:
    """Say where the symbols of a kind stand; those of empty object slots are left out."""
    begin, end = space.spans[KINDS.index(kind)]
    if kind in ("action", "mode") or world.is_object.all():
        return Block(slice(begin, end), table)
    real = np.flatnonzero(np.resize(world.is_object, end - begin))
    return Block(begin + real, table[real])


def ranks_meant(
    phrase: Phrase, path: Path, rank: Mapping[Path, int], type_names: tuple[str, ...]
) -> np.ndarray:
    """Find for which relations a phrase means the extreme object, or the second, ... only, i[7].

    A phrase that passes on the region of a child ("that is nearest to the cone") passes on this. 0
    where every object is meant; ``rank`` is that of each phrase, gold or inferred, absent 0.
    """
    meant = np.zeros(NUM_REGIONS, int)
    relations = sorted(senses_of(phrase, type_names).relations)
    if relations:  # what is below belongs to the landmark: "near the second cone"
        meant[relations] = rank.get(path, 0)
        return meant
    for i, child in enumerate(phrase.children):
        meant = np.maximum(meant, ranks_meant(child, (*path, i), rank, type_names))
    return meant
