"""Properties of annotation symbols: the grounding side of the bilinear score (section 3.1)."""

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from jaxlangnav.grounding.features import Senses
from jaxlangnav.grounding.symbols import NUM_RELATIONS, AnnotationSpace
from jaxlangnav.messages import RELATIONS
from jaxlangnav.relations.table import NUM_RANKS

NUM_IDENTITY = 8
"""Object types with a property of their own; further types are carried by agreement alone."""
_IS_TYPE = tuple(f"is type {i}" for i in range(NUM_IDENTITY))
_IS_LANDMARK = (*(f"landmark is type {i}" for i in range(NUM_IDENTITY)), "landmark is the robot")
_IS_RELATION = tuple(f"is {name}" for name in RELATIONS)
_IS_RANK = tuple(f"is {rank}" for rank in range(1, NUM_RANKS + 1))


class PropertyTable(NamedTuple):
    """Properties of the symbols of one kind, each declared once: its name and what it says."""

    names: tuple[str, ...]  # of the F columns, and so of those of the weights
    values: np.ndarray  # f32[S, F]


@dataclasses.dataclass(frozen=True)
class ChildSets:
    """What the child phrases of an annotation phrase express, as they may be combined."""

    objects: np.ndarray  # bool[T] any child expresses the object
    regions: np.ndarray  # bool[6, L]
    relations: np.ndarray  # bool[T, 6, L]
    heads: np.ndarray  # bool[T] what a child phrase is about: its object, or a relation's figure
    has_children: bool


def child_sets(space: AnnotationSpace, groundings: list[np.ndarray]) -> ChildSets:
    """Join the groundings of the child phrases.

    The head of a phrase that expresses relations is the figure that is no landmark of another
    ("the cone near the car" is about the cone); a phrase that expresses a region has no head.

    Args:
        space: annotation symbols.
        groundings: bool[S] for each child.

    Returns:
        Unions over the children, and their heads.
    """
    num_types, num_landmarks = space.num_types, space.num_landmarks
    objects = np.zeros(num_types, bool)
    regions = np.zeros((NUM_RELATIONS, num_landmarks), bool)
    relations = np.zeros((num_types, NUM_RELATIONS, num_landmarks), bool)
    heads = np.zeros(num_types, bool)
    for grounding in groundings:
        child_objects, child_regions, child_relations = space.parts(grounding)
        objects |= child_objects
        regions |= child_regions
        relations |= child_relations
        if child_regions.any():
            continue
        figures = np.any(child_relations, axis=(1, 2))
        landmarks = np.asarray(np.any(child_relations, axis=(0, 1)))[:num_types]
        head_figures = figures & ~landmarks
        heads |= child_objects | (head_figures if head_figures.any() else figures)
    return ChildSets(objects, regions, relations, heads, bool(groundings))


def _members(indices: frozenset[int], size: int) -> np.ndarray:
    """Turn indices into a boolean vector, ignoring those out of range."""
    mask = np.zeros(size, bool)
    mask[[i for i in indices if i < size]] = True
    return mask


def _table(shape: tuple[int, ...], columns: Mapping[str, np.ndarray | bool]) -> PropertyTable:
    """Stack broadcast properties by name."""
    values = np.empty((*shape, len(columns)), np.float32)
    for i, column in enumerate(columns.values()):
        values[..., i] = column
    return PropertyTable(tuple(columns), values.reshape(-1, len(columns)))


def _identities(names: tuple[str, ...], rows: np.ndarray) -> dict[str, np.ndarray]:
    """Give every row a property of its own."""
    return dict(zip(names, rows, strict=True))


def _type_identity(num_types: int) -> np.ndarray:
    """Mark each of the first types, bool[NUM_IDENTITY, T]."""
    return np.eye(NUM_IDENTITY, num_types, dtype=bool)


def _landmark_identity(num_types: int) -> np.ndarray:
    """Mark each of the first types and the robot, bool[NUM_IDENTITY + 1, L]."""
    identity = np.zeros((NUM_IDENTITY + 1, num_types + 1), bool)
    identity[:NUM_IDENTITY, :num_types] = _type_identity(num_types)
    identity[NUM_IDENTITY, num_types] = True
    return identity


def object_properties(space: AnnotationSpace, senses: Senses, child: ChildSets) -> PropertyTable:
    """Describe the object symbols of a phrase, given what its children express.

    Args:
        space: annotation symbols.
        senses: of the phrase's words.
        child: groundings of the child phrases.

    Returns:
        f32[T, F]: bias, agreement with words and children and their inverse, type identity.
    """
    own = _members(senses.types, space.num_types)
    has_region = bool(child.regions.any())
    return _table(
        (space.num_types,),
        {
            "bias": True,
            "named": own,
            "another named": ~own & bool(senses.types),
            "of a child": child.objects,
            "of a child, in a region": child.objects & has_region,
            "of a child, in a relation": child.objects & bool(child.relations.any()),
            "not of a child": child.has_children & ~child.objects,
            "named, in a region": own & has_region,
            **_identities(_IS_TYPE, _type_identity(space.num_types)),
        },
    )


def region_properties(space: AnnotationSpace, senses: Senses, child: ChildSets) -> PropertyTable:
    """Describe the region symbols of a phrase; arguments as ``object_properties``, f32[6 L, F]."""
    size = space.num_landmarks
    relation = _members(senses.relations, NUM_RELATIONS)[:, None]
    is_robot = (np.arange(size) == space.num_types)[None, :]
    head = np.append(child.heads, False)[None, :]
    own = np.append(_members(senses.types, space.num_types), senses.is_robot)[None, :]
    has_object = bool(child.heads.any())
    is_lone = not child.has_children and not senses.types
    return _table(
        (NUM_RELATIONS, size),
        {
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
            "not of a child, not head": child.has_children & ~child.regions & ~head,
            "relation named, of nothing": relation & ~head & ~own & ~(is_robot & is_lone),
            **_identities(_IS_RELATION, np.eye(NUM_RELATIONS, dtype=bool)[:, :, None]),
            **_identities(_IS_LANDMARK, _landmark_identity(space.num_types)[:, None, :]),
        },
    )


def relation_properties(space: AnnotationSpace, senses: Senses, child: ChildSets) -> PropertyTable:
    """Describe the relation symbols; arguments as ``object_properties``, f32[6 T L, F]."""
    size = space.num_landmarks
    own_type = _members(senses.types, space.num_types)[:, None, None]
    head = child.heads[:, None, None]
    region = child.regions[None]
    relation = _members(senses.relations, NUM_RELATIONS)[None, :, None]
    is_robot = (np.arange(size) == space.num_types)[None, None, :]
    composed = head & region
    return _table(
        (space.num_types, NUM_RELATIONS, size),
        {
            "bias": True,
            "of a child": child.relations,
            "composed": composed,
            "named, in a region": own_type & region,
            "named, relation to the robot named": own_type & relation & is_robot,
            "head, relation to the robot named": head & relation & is_robot,
            "region of a child, of no object": region & ~head & ~own_type,
            "head, other region": head & ~region,
            "neither": ~child.relations & ~composed,
        },
    )


def rank_properties(senses: Senses) -> PropertyTable:
    """Describe the ranks 1 to 4 that a phrase may give its region, f32[4, 7]."""
    ranks = np.arange(1, NUM_RANKS + 1)
    own = np.isin(ranks, sorted(senses.ranks))
    named = bool(senses.ranks)
    is_rank = _identities(_IS_RANK, np.eye(NUM_RANKS, dtype=bool))
    said = {"bias": True, "named": own, "another named": ~own & named}
    return _table((NUM_RANKS,), said | is_rank)


def shared_properties(senses: Senses, expressed: np.ndarray, num_children: int) -> PropertyTable:
    """Describe symbols by what holds for every kind alike, so that kinds learn from each other.

    Args:
        senses: of the phrase's words.
        expressed: bool[S], some child expresses the symbol.
        num_children: of the phrase.

    Returns:
        f32[S, 6]: bias, passed on, from an only child, from several, by words that name
        nothing themselves, not passed on.
    """
    names_nothing = not senses.types and not senses.relations
    return _table(
        expressed.shape,
        {
            "bias": True,
            "of a child": expressed,
            "of the only child": expressed & (num_children == 1),
            "of one of several": expressed & (num_children > 1),
            "of a child, nothing named": expressed & names_nothing,
            "not of a child": ~expressed & (num_children > 0),
        },
    )


def join_kinds(tables: Mapping[str, PropertyTable], shared: PropertyTable) -> PropertyTable:
    """Put the properties of several kinds of symbol side by side, and shared ones after them.

    Args:
        tables: kind → f32[S_kind, F_kind].
        shared: f32[Σ S_kind, F].

    Returns:
        f32[Σ S_kind, Σ F_kind + F]; a symbol has zeros where other kinds have theirs.
    """
    names = [f"{kind}: {name}" for kind, table in tables.items() for name in table.names]
    rows, width = shared.values.shape[0], len(names)
    joined = np.zeros((rows, width + shared.values.shape[1]), np.float32)
    row = column = 0
    for table in tables.values():
        height, depth = table.values.shape
        joined[row : row + height, column : column + depth] = table.values
        row, column = row + height, column + depth
    joined[:, width:] = shared.values
    return PropertyTable((*names, *(f"any: {name}" for name in shared.names)), joined)
