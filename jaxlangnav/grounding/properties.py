"""The engine's two symbol spaces: what is seen of annotations and of behaviors (eq. 4).

A property is a column of the weights and is declared once, by its name and what it says of the
symbols of a phrase; the order of declaration is that of the columns. Those of behaviors stand in
``behavior_properties``, and their device form, words contracted in before, in ``behavior_odds``.
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from jaxlangnav.grounding.behavior_properties import (
    ChildGroundings,
    PhraseWords,
    behavior_names,
    behavior_tables,
    lies_in,
)
from jaxlangnav.grounding.correspondence import KIND, RANK, Block, Described
from jaxlangnav.grounding.model import (
    ANNOTATION_KINDS,
    BEHAVIOR_KINDS,
    RESTRICTORS,
    PropertyColumns,
    Senses,
    of_each,
    senses_of,
    stack_columns,
)
from jaxlangnav.grounding.symbols import (
    CONSTRAINT,
    GOAL,
    KINDS,
    NUM_REGIONS,
    NUM_RELATIONS,
    OBJECT,
    REGION,
    VERB_LABELS,
    AnnotationSpace,
    BehaviorSpace,
    Path,
)
from jaxlangnav.grounding.worlds import World
from jaxlangnav.language.phrase import Phrase
from jaxlangnav.messages import RELATIONS
from jaxlangnav.relations.table import NUM_RANKS

NUM_IDENTITY = 8
"""Object types with a property of their own; further types are carried by agreement alone."""


@dataclasses.dataclass(frozen=True)
class _ChildSets:
    """What the child phrases of an annotation phrase express, as they may be combined."""

    expressed: np.ndarray  # bool[S] by any child
    objects: np.ndarray  # bool[T]
    regions: np.ndarray  # bool[6, L]
    relations: np.ndarray  # bool[T, 6, L]
    heads: np.ndarray  # bool[T] what a child phrase is about: its object, or a relation's figure
    number: int


def _child_sets(space: AnnotationSpace, groundings: Sequence[np.ndarray]) -> _ChildSets:
    """Join the groundings bool[S] of the child phrases, and find their heads."""
    # The head of a phrase that expresses relations is the figure that is no landmark of another
    # ("the cone near the car" is about the cone); a phrase that expresses a region has no head.
    expressed, heads = np.zeros(space.size, bool), np.zeros(space.num_types, bool)
    for grounding in groundings:
        expressed |= grounding
        objects, regions, relations = space.parts(grounding)
        if regions.any():
            continue
        figures = np.any(relations, axis=(1, 2))
        landmarks = np.asarray(np.any(relations, axis=(0, 1)))[: space.num_types]
        head_figures = figures & ~landmarks
        heads |= objects | (head_figures if head_figures.any() else figures)
    return _ChildSets(expressed, *space.parts(expressed), heads, len(groundings))


def _members(indices: frozenset[int], size: int) -> np.ndarray:
    """Turn indices into a boolean vector, ignoring those out of range."""
    return np.isin(np.arange(size), list(indices))


def _object_columns(space: AnnotationSpace, senses: Senses, child: _ChildSets) -> PropertyColumns:
    """Describe the object symbols, bool[T] each."""
    own = _members(senses.types, space.num_types)
    has_region = bool(child.regions.any())
    return {
        "bias": True,
        "named": own,
        "another named": ~own & bool(senses.types),
        "of a child": child.objects,
        "of a child, in a region": child.objects & has_region,
        "of a child, in a relation": child.objects & bool(child.relations.any()),
        "not of a child": bool(child.number) & ~child.objects,
        "named, in a region": own & has_region,
        **of_each("is type", range(NUM_IDENTITY), np.eye(NUM_IDENTITY, space.num_types)),
    }


def _region_columns(space: AnnotationSpace, senses: Senses, child: _ChildSets) -> PropertyColumns:
    """Describe the region symbols, bool[6, L] each and what broadcasts to it."""
    types, has_children = space.num_types, bool(child.number)
    relation = _members(senses.relations, NUM_RELATIONS)[:, None]
    is_robot = (np.arange(space.num_landmarks) == types)[None, :]
    head = np.append(child.heads, False)[None, :]
    own = np.append(_members(senses.types, types), senses.is_robot)[None, :]
    has_object = bool(child.heads.any())
    is_lone = not has_children and not senses.types
    is_type = np.eye(NUM_IDENTITY, types + 1) * ~is_robot
    return {
        "bias": True,
        "relation named": relation,
        "head": head,
        "head, relation named": relation & head,
        "head, other relation named": ~relation & head & bool(senses.relations),
        "named": own,
        "named, relation named": relation & own,
        "lone relation to the robot": relation & is_robot & is_lone,
        "robot named": is_robot & senses.is_robot,
        "of a child": child.regions,
        "of a child, of an object": child.regions & has_object,
        "of a child, of no object": child.regions & (not has_object),
        "not of a child, not head": has_children & ~child.regions & ~head,
        "relation named, of nothing": relation & ~head & ~own & ~(is_robot & is_lone),
        **of_each("is", RELATIONS, np.eye(NUM_RELATIONS)[:, :, None]),
        **of_each("landmark is type", range(NUM_IDENTITY), is_type[:, None]),
        "landmark is the robot": is_robot,
    }


def _relation_columns(space: AnnotationSpace, senses: Senses, child: _ChildSets) -> PropertyColumns:
    """Describe the relation symbols, bool[T, 6, L] each and what broadcasts to it."""
    own_type = _members(senses.types, space.num_types)[:, None, None]
    head, region = child.heads[:, None, None], child.regions[None]
    relation = _members(senses.relations, NUM_RELATIONS)[None, :, None]
    is_robot = (np.arange(space.num_landmarks) == space.num_types)[None, None, :]
    composed = head & region
    return {
        "bias": True,
        "of a child": child.relations,
        "composed": composed,
        "named, in a region": own_type & region,
        "named, relation to the robot named": own_type & relation & is_robot,
        "head, relation to the robot named": head & relation & is_robot,
        "region of a child, of no object": region & ~head & ~own_type,
        "head, other region": head & ~region,
        "neither": ~child.relations & ~composed,
    }


def _shared_columns(senses: Senses, child: _ChildSets) -> PropertyColumns:
    """Describe symbols by what holds for every kind alike, so that kinds learn from each other."""
    expressed = child.expressed
    return {
        "bias": True,
        "of a child": expressed,
        "of the only child": expressed & (child.number == 1),
        "of one of several": expressed & (child.number > 1),
        "of a child, nothing named": expressed & (not senses.types and not senses.relations),
        "not of a child": ~expressed & (child.number > 0),
    }


def rank_columns(senses: Senses) -> PropertyColumns:
    """Describe the ranks 1 to 4 that a phrase may give its region, bool[4] each."""
    ranks = range(1, NUM_RANKS + 1)
    own = np.isin(ranks, sorted(senses.ranks))
    said = {"bias": True, "named": own, "another named": ~own & bool(senses.ranks)}
    return said | of_each("is", ranks, np.eye(NUM_RANKS))


def annotation_table(
    space: AnnotationSpace, senses: Senses, groundings: Sequence[np.ndarray]
) -> tuple[tuple[str, ...], np.ndarray]:
    """Describe every annotation symbol of a phrase, given bool[S] that each child expresses.

    F names, and f32[S, F]: the properties of objects, regions and relations side by side, each zero
    for symbols of another kind, and those that all kinds share.
    """
    child = _child_sets(space, groundings)
    columns = {
        "object": _object_columns(space, senses, child),
        "region": _region_columns(space, senses, child),
        "relation": _relation_columns(space, senses, child),
    }
    in_common = _shared_columns(senses, child)
    names = [f"{kind}: {name}" for kind, of_kind in columns.items() for name in of_kind]
    parts = zip(space.parts(child.expressed), columns.values(), strict=True)
    tables: Any = block_diag(*(stack_columns(part.shape, of_kind) for part, of_kind in parts))
    joined = np.hstack([tables, stack_columns((space.size,), in_common)])
    return (*names, *(f"any: {name}" for name in in_common)), joined


# ---------------------------------------------------------------- the two spaces

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
        is_restrictor = [child.label in RESTRICTORS for child in phrase.children]
        words = PhraseWords.of(senses, bool(phrase.children), any(is_restrictor))
        ranks = [
            ranks_meant(child, (*path, i), self.rank, self.type_names)
            for i, child in enumerate(phrase.children)
        ]

        def block(kind: str, table: np.ndarray) -> Block:
            begin, end = space.spans[KINDS.index(kind)]
            if kind in ("action", "mode") or world.is_object.all():
                return Block(slice(begin, end), table)
            real = np.flatnonzero(np.resize(world.is_object, end - begin))
            return Block(begin + real, table[real])

        def given(children: Sequence[np.ndarray]) -> Mapping[str, Block]:
            every = np.any([*children, np.zeros(space.size, bool)], axis=0)
            lies = world.is_object.copy()
            for is_told, rank, expressed in zip(is_restrictor, ranks, children, strict=True):
                if is_told:
                    places = space.part(expressed, REGION) | space.part(expressed, GOAL)
                    lies &= lies_in(world, places, rank)
            joined = ChildGroundings(
                objects=space.part(every, OBJECT),
                regions=space.part(every, REGION) | space.part(every, GOAL),
                constraints=space.part(every, CONSTRAINT),
                lies=lies,
            )
            tables = behavior_tables(world, is_verb, senses, words, joined)
            return {kind: block(kind, table) for kind, table in tables.items()}

        return Described(given)


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
