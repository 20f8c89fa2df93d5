"""The engine's two symbol spaces: what is seen of annotations and of behaviors (eq. 4).

Both are spaces of the correspondence graph as anyone's (``space``). The device form of the behavior
part is ``behavior_odds``, with the words contracted in before.
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from jaxlangnav.grounding import annotation_features as af
from jaxlangnav.grounding import behavior_features as bf
from jaxlangnav.grounding.behavior_properties import PROPERTY_NAMES
from jaxlangnav.grounding.correspondence import KIND, RANK, Block, Described
from jaxlangnav.grounding.features import RESTRICTORS, Senses, senses_of
from jaxlangnav.grounding.model import ANNOTATION_KINDS, BEHAVIOR_KINDS
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
from jaxlangnav.language.phrase import Phrase


def _annotation_table(
    space: AnnotationSpace, senses: Senses, groundings: Sequence[np.ndarray]
) -> af.PropertyTable:
    """Describe every annotation symbol of a phrase, given bool[S] of each child, f32[S, F]."""
    child = af.child_sets(space, groundings)
    expressed = np.zeros(space.size, bool)
    for grounding in groundings:
        expressed |= grounding
    tables = {
        "object": af.object_properties(space, senses, child),
        "region": af.region_properties(space, senses, child),
        "relation": af.relation_properties(space, senses, child),
    }
    return af.join_kinds(tables, af.shared_properties(senses, expressed, len(groundings)))


@functools.cache
def property_names() -> Mapping[str, tuple[str, ...]]:
    """Name the columns of the weights of every kind of symbol; files of weights hold the names.

    Returns:
        Kind, of either model, → F names.
    """
    nothing = Senses(*[frozenset()] * 5, is_robot=False)
    table = _annotation_table(AnnotationSpace(1), nothing, [])
    own = {KIND: table.names, RANK: af.rank_properties(nothing).names}
    return MappingProxyType(own | PROPERTY_NAMES)


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
        return self._symbols

    @functools.cached_property
    def _symbols(self) -> AnnotationSpace:
        """The same for every phrase, as they are indexed once."""
        return AnnotationSpace(len(self.type_names))

    def describe(self, phrase: Phrase, path: Path, world: None) -> Described:
        """Describe the symbols of a phrase, and the ranks that its words may give a region."""
        space, senses = self.symbols_in(world), senses_of(phrase, self.type_names)

        def given(children: Sequence[np.ndarray]) -> Mapping[str, Block]:
            return {KIND: Block(slice(None), _annotation_table(space, senses, children).values)}

        return Described(given, af.rank_properties(senses).values)


def _child_groundings(
    world: bf.World,
    space: BehaviorSpace,
    below: Sequence[tuple[Phrase, np.ndarray]],
    children: Sequence[np.ndarray],
) -> bf.ChildGroundings:
    """Join what child phrases, (phrase, i[7] rank for each relation), express of S in a world."""
    num_objects = world.object_type.shape[0]
    objects = np.zeros(num_objects, bool)
    regions = np.zeros((NUM_REGIONS, num_objects), bool)
    constraints = np.zeros((NUM_REGIONS, num_objects), bool)
    lies = world.is_object.copy()
    is_restricted = False
    for (phrase, rank), expressed in zip(below, children, strict=True):
        places = space.part(expressed, REGION) | space.part(expressed, GOAL)
        objects |= space.part(expressed, OBJECT)
        regions |= places
        constraints |= space.part(expressed, CONSTRAINT)
        if phrase.label in RESTRICTORS:
            lies &= bf.lies_in(world, places, rank)
            is_restricted = True
    return bf.ChildGroundings(objects, regions, constraints, lies, is_restricted, bool(children))


def _behavior_tables(
    world: bf.World, is_verb: bool, senses: Senses, child: bf.ChildGroundings
) -> dict[str, np.ndarray]:
    """Describe every behavior symbol of a phrase: kind → f32[symbols of the kind, F]."""
    if is_verb:
        return {
            "goal": bf.goal_properties(world, senses, child),
            "constraint": bf.constraint_properties(world, senses, child),
            "action": bf.action_properties(senses),
            "mode": bf.mode_properties(senses),
        }
    return {
        "object": bf.placed_object_properties(world, senses, child),
        "region": bf.placed_region_properties(world, senses, child),
    }


def _block(world: bf.World, space: BehaviorSpace, kind: str, table: np.ndarray) -> Block:
    """Say where the symbols of a kind stand; those of empty object slots are left out."""
    begin, end = space.span(KINDS.index(kind))
    if kind in ("action", "mode") or world.is_object.all():
        return Block(slice(begin, end), table)
    real = np.flatnonzero(np.resize(world.is_object, end - begin))
    return Block(begin + real, table[real])


_behavior_space = functools.cache(BehaviorSpace)


@dataclasses.dataclass(frozen=True)
class Behaviors:
    """The behavior symbols of placed objects as a space."""

    type_names: tuple[str, ...]  # object types in the order of their indices
    rank: Mapping[Path, int]  # that each phrase gives its region: 0, 1 nearest, 2 second, ...

    @property
    def columns(self) -> Mapping[str, Sequence[str]]:
        """Names of the properties of every kind of symbol."""
        return {kind: property_names()[kind] for kind in BEHAVIOR_KINDS}

    def symbols_in(self, world: bf.World) -> BehaviorSpace:
        """List the symbols of the objects of a world, the robot last."""
        return _behavior_space(world.object_type.shape[0])

    def describe(self, phrase: Phrase, path: Path, world: bf.World) -> Described:
        """Describe the symbols of a phrase."""
        space, senses = self.symbols_in(world), senses_of(phrase, self.type_names)
        below = [
            (child, ranks_meant(child, (*path, i), self.rank, self.type_names))
            for i, child in enumerate(phrase.children)
        ]

        def given(children: Sequence[np.ndarray]) -> Mapping[str, Block]:
            joined = _child_groundings(world, space, below, children)
            is_verb = phrase.label in VERB_LABELS
            tables = _behavior_tables(world, is_verb, senses, joined)
            return {kind: _block(world, space, kind, one) for kind, one in tables.items()}

        return Described(given)


def ranks_meant(
    phrase: Phrase, path: Path, rank: Mapping[Path, int], type_names: tuple[str, ...]
) -> np.ndarray:
    """Find for which relations a phrase means the extreme object, or the second, ... only.

    A phrase that passes on the region of a child ("that is nearest to the cone") passes on this.

    Args:
        phrase: the phrase.
        path: where it stands.
        rank: of each phrase, gold or inferred; absent is 0.
        type_names: object types.

    Returns:
        i[7], 0 where every object is meant.
    """
    meant = np.zeros(NUM_REGIONS, int)
    relations = sorted(senses_of(phrase, type_names).relations)
    if relations:  # what is below belongs to the landmark: "near the second cone"
        meant[relations] = rank.get(path, 0)
        return meant
    for i, child in enumerate(phrase.children):
        meant = np.maximum(meant, ranks_meant(child, (*path, i), rank, type_names))
    return meant
