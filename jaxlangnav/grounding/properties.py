"""The annotation and behavior symbol spaces, with the features of their symbols (eq. 4).

A property is a feature: a column of the weights, declared once by its name and its value for each
symbol of a phrase; the order of declaration is that of the columns. Those of behaviors are in
``behavior_properties``; their device form, with words contracted, is in ``behavior_odds``.
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag

from jaxlangnav.grounding.behavior_properties import (
    ChildGroundings,
    GateInputs,
    feature_matrices,
    feature_names,
    objects_in_regions,
)
from jaxlangnav.grounding.correspondence import RANKS, SYMBOLS, Block, Described
from jaxlangnav.grounding.model import (
    ANNOTATION_KINDS,
    BEHAVIOR_KINDS,
    RESTRICTORS,
    PropertyColumns,
    Senses,
    by_name,
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
    Ranks,
)
from jaxlangnav.grounding.worlds import World
from jaxlangnav.language.phrase import Phrase
from jaxlangnav.messages import RELATIONS
from jaxlangnav.relations.table import NUM_RANKS

NUM_IDENTITY = 8
"""Object types with an identity feature; further types only have agreement features."""


class _ChildSets(NamedTuple):
    """Union of what the child phrases of an annotation phrase express, with their heads."""

    expressed: np.ndarray  # bool[S] by any child
    objects: np.ndarray  # bool[T]
    regions: np.ndarray  # bool[6, L]
    relations: np.ndarray  # bool[T, 6, L]
    heads: np.ndarray  # bool[T] type of a child's head: its object, or a relation's figure
    num_children: int


def _child_sets(space: AnnotationSpace, groundings: Sequence[np.ndarray]) -> _ChildSets:
    """Unite the groundings bool[S] of the child phrases, and find their heads."""
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
    """Encode indices as a boolean vector, ignoring those out of range."""
    return np.isin(np.arange(size), list(indices))


def _object_columns(space: AnnotationSpace, senses: Senses, child: _ChildSets) -> PropertyColumns:
    """Compute the features of the object symbols, bool[T] each."""
    named = _members(senses.types, space.num_types)
    has_region = bool(child.regions.any())
    return {
        "bias": True,
        "named": named,
        "another named": ~named & bool(senses.types),
        "of a child": child.objects,
        "of a child, in a region": child.objects & has_region,
        "of a child, in a relation": child.objects & bool(child.relations.any()),
        "not of a child": bool(child.num_children) & ~child.objects,
        "named, in a region": named & has_region,
        **by_name("is type", range(NUM_IDENTITY), np.eye(NUM_IDENTITY, space.num_types)),
    }


def _region_columns(space: AnnotationSpace, senses: Senses, child: _ChildSets) -> PropertyColumns:
    """Compute the features of the region symbols, each broadcastable to bool[6, L]."""
    types, has_children = space.num_types, bool(child.num_children)
    relation = _members(senses.relations, NUM_RELATIONS)[:, None]
    is_robot = (np.arange(space.num_landmarks) == types)[None, :]
    head = np.append(child.heads, False)[None, :]
    named = np.append(_members(senses.types, types), senses.is_robot)[None, :]
    has_object = bool(child.heads.any())
    is_bare = not has_children and not senses.types
    is_type = np.eye(NUM_IDENTITY, types + 1) * ~is_robot
    return {
        "bias": True,
        "relation named": relation,
        "head": head,
        "head, relation named": relation & head,
        "head, other relation named": ~relation & head & bool(senses.relations),
        "named": named,
        "named, relation named": relation & named,
        "lone relation to the robot": relation & is_robot & is_bare,
        "robot named": is_robot & senses.is_robot,
        "of a child": child.regions,
        "of a child, of an object": child.regions & has_object,
        "of a child, of no object": child.regions & (not has_object),
        "not of a child, not head": has_children & ~child.regions & ~head,
        "relation named, of nothing": relation & ~head & ~named & ~(is_robot & is_bare),
        **by_name("is", RELATIONS, np.eye(NUM_RELATIONS)[:, :, None]),
        **by_name("landmark is type", range(NUM_IDENTITY), is_type[:, None]),
        "landmark is the robot": is_robot,
    }


def _relation_columns(space: AnnotationSpace, senses: Senses, child: _ChildSets) -> PropertyColumns:
    """Compute the features of the relation symbols, each broadcastable to bool[T, 6, L]."""
    named = _members(senses.types, space.num_types)[:, None, None]
    head, region = child.heads[:, None, None], child.regions[None]
    relation = _members(senses.relations, NUM_RELATIONS)[None, :, None]
    is_robot = (np.arange(space.num_landmarks) == space.num_types)[None, None, :]
    composed = head & region
    return {
        "bias": True,
        "of a child": child.relations,
        "composed": composed,
        "named, in a region": named & region,
        "named, relation to the robot named": named & relation & is_robot,
        "head, relation to the robot named": head & relation & is_robot,
        "region of a child, of no object": region & ~head & ~named,
        "head, other region": head & ~region,
        "neither": ~child.relations & ~composed,
    }


def _shared_columns(senses: Senses, child: _ChildSets) -> PropertyColumns:
    """Compute features shared by all kinds of symbols, so that kinds share statistics."""
    expressed = child.expressed
    return {
        "bias": True,
        "of a child": expressed,
        "of the only child": expressed & (child.num_children == 1),
        "of one of several": expressed & (child.num_children > 1),
        "of a child, nothing named": expressed & (not senses.types and not senses.relations),
        "not of a child": ~expressed & (child.num_children > 0),
    }


def rank_columns(senses: Senses) -> PropertyColumns:
    """Compute the features of the ranks 1 to 4 that a phrase may give its region, bool[4] each."""
    ranks = range(1, NUM_RANKS + 1)
    named = np.isin(ranks, sorted(senses.ranks))
    columns = {"bias": True, "named": named, "another named": ~named & bool(senses.ranks)}
    return columns | by_name("is", ranks, np.eye(NUM_RANKS))


def annotation_table(
    space: AnnotationSpace, senses: Senses, groundings: Sequence[np.ndarray]
) -> tuple[tuple[str, ...], np.ndarray]:
    """Build the feature matrix of a phrase's annotation symbols, given bool[S] of each child.

    F names, and f32[S, F]: features of objects, regions and relations side by side, each zero for
    symbols of another kind, then the shared features.
    """
    child = _child_sets(space, groundings)
    columns = {
        "object": _object_columns(space, senses, child),
        "region": _region_columns(space, senses, child),
        "relation": _relation_columns(space, senses, child),
    }
    shared = _shared_columns(senses, child)
    names = [f"{kind}: {name}" for kind, of_kind in columns.items() for name in of_kind]
    parts = zip(space.parts(child.expressed), columns.values(), strict=True)
    tables: Any = block_diag(*(stack_columns(part.shape, of_kind) for part, of_kind in parts))
    joined = np.hstack([tables, stack_columns((space.size,), shared)])
    return (*names, *(f"any: {name}" for name in shared)), joined


# ---------------------------------------------------------------- the two spaces

_annotation_space = functools.cache(AnnotationSpace)
_behavior_space = functools.cache(BehaviorSpace)


@functools.cache
def property_names() -> Mapping[str, tuple[str, ...]]:
    """List the names of the weights' columns by kind of symbol, as stored in weight files."""
    nothing = Senses(*[frozenset()] * 5, is_robot=False)
    names, _ = annotation_table(_annotation_space(1), nothing, [])
    annotation = {SYMBOLS: names, RANKS: tuple(rank_columns(nothing))}
    return MappingProxyType(annotation | feature_names())


@dataclasses.dataclass(frozen=True)
class Annotations:
    """The annotation symbol space with its features; it needs no world."""

    type_names: tuple[str, ...]  # object types in the order of their indices

    @property
    def columns(self) -> Mapping[str, Sequence[str]]:
        """Names of the features of symbols and ranks."""
        return {kind: property_names()[kind] for kind in ANNOTATION_KINDS}

    def symbols_in(self, world: None) -> AnnotationSpace:
        """List the symbols over the object types."""
        return _annotation_space(len(self.type_names))

    def describe(self, phrase: Phrase, path: Path, world: None) -> Described:
        """Compute the features of a phrase's symbols, and of the ranks it may give a region."""
        space, senses = self.symbols_in(world), senses_of(phrase, self.type_names)

        def given(children: Sequence[np.ndarray]) -> Mapping[str, Block]:
            return {SYMBOLS: Block(slice(None), annotation_table(space, senses, children)[1])}

        return Described(given, stack_columns((NUM_RANKS,), rank_columns(senses)))


@dataclasses.dataclass(frozen=True)
class Behaviors:
    """The behavior symbol space of a world's objects, with its features."""

    type_names: tuple[str, ...]  # object types in the order of their indices
    rank: Ranks

    @property
    def columns(self) -> Mapping[str, Sequence[str]]:
        """Names of the features by kind of symbol."""
        return {kind: property_names()[kind] for kind in BEHAVIOR_KINDS}

    def symbols_in(self, world: World) -> BehaviorSpace:
        """List the symbols of the objects of a world, the robot last."""
        return _behavior_space(world.object_type.shape[0])

    def describe(self, phrase: Phrase, path: Path, world: World) -> Described:
        """Compute the features of a phrase's symbols, except those of empty object slots."""
        space, senses = self.symbols_in(world), senses_of(phrase, self.type_names)
        is_verb = phrase.label in VERB_LABELS
        is_restrictor = [child.label in RESTRICTORS for child in phrase.children]
        gates = GateInputs.of(senses, bool(phrase.children), any(is_restrictor))
        ranks = [
            find_ranks(child, (*path, i), self.rank, self.type_names)
            for i, child in enumerate(phrase.children)
        ]

        def block(kind: str, matrix: np.ndarray) -> Block:
            begin, end = space.spans[KINDS.index(kind)]
            if kind in ("action", "mode") or world.is_object.all():
                return Block(slice(begin, end), matrix)
            present = np.flatnonzero(np.resize(world.is_object, end - begin))
            return Block(begin + present, matrix[present])

        def given(children: Sequence[np.ndarray]) -> Mapping[str, Block]:
            union = np.any([*children, np.zeros(space.size, bool)], axis=0)
            is_located = world.is_object.copy()
            for restricts, rank, expressed in zip(is_restrictor, ranks, children, strict=True):
                if restricts:
                    regions = space.part(expressed, REGION) | space.part(expressed, GOAL)
                    is_located &= objects_in_regions(world, regions, rank)
            joined = ChildGroundings(
                objects=space.part(union, OBJECT),
                regions=space.part(union, REGION) | space.part(union, GOAL),
                constraints=space.part(union, CONSTRAINT),
                is_located=is_located,
            )
            matrices = feature_matrices(world, is_verb, senses, gates, joined)
            return {kind: block(kind, matrix) for kind, matrix in matrices.items()}

        return Described(given)


def find_ranks(phrase: Phrase, path: Path, rank: Ranks, type_names: tuple[str, ...]) -> np.ndarray:
    """Compute the rank that a phrase gives each relation, i[7]: 0 none, 1 extreme, 2 second.

    A phrase that passes on the region of a child ("that is nearest to the cone") passes on its
    rank. ``rank`` is that of each phrase, gold or inferred; a missing entry is 0.
    """
    ranks = np.zeros(NUM_REGIONS, int)
    relations = sorted(senses_of(phrase, type_names).relations)
    if relations:  # ranks below belong to the landmark: "near the second cone"
        ranks[relations] = rank.get(path, 0)
        return ranks
    for i, child in enumerate(phrase.children):
        ranks = np.maximum(ranks, find_ranks(child, (*path, i), rank, type_names))
    return ranks
