"""Properties of annotation symbols: the grounding side of the bilinear score (section 3.1).

A property is a column of the weights and is declared once, by its name and what it says of the
symbols of a phrase. The order of declaration is that of the columns.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from jaxlangnav.grounding.model import Senses
from jaxlangnav.grounding.symbols import NUM_RELATIONS, AnnotationSpace
from jaxlangnav.messages import RELATIONS
from jaxlangnav.relations.table import NUM_RANKS

PropertyColumns = Mapping[str, np.ndarray | bool]
"""Name of a property → what it says of the symbols of one kind; arrays that broadcast to them."""
NUM_IDENTITY = 8
"""Object types with a property of their own; further types are carried by agreement alone."""
_IS_TYPE = tuple(f"is type {i}" for i in range(NUM_IDENTITY))
_IS_LANDMARK = (*(f"landmark is type {i}" for i in range(NUM_IDENTITY)), "landmark is the robot")
_IS_RELATION = tuple(f"is {name}" for name in RELATIONS)
_IS_RANK = tuple(f"is {rank}" for rank in range(1, NUM_RANKS + 1))


def stack_columns(shape: tuple[int, ...], columns: PropertyColumns) -> np.ndarray:
    """Stack properties of the symbols of one kind, broadcast to their shape, f32[S, F]."""
    values = np.empty((*shape, len(columns)), np.float32)
    for i, column in enumerate(columns.values()):
        values[..., i] = column
    return values.reshape(-1, len(columns))


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


def _identities(names: tuple[str, ...], rows: np.ndarray) -> dict[str, np.ndarray]:
    """Give every row a property of its own."""
    return dict(zip(names, rows, strict=True))


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
        **_identities(_IS_TYPE, np.eye(NUM_IDENTITY, space.num_types, dtype=bool)),
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
    landmarks = np.zeros((NUM_IDENTITY + 1, 1, types + 1), bool)
    landmarks[:NUM_IDENTITY, 0, :types] = np.eye(NUM_IDENTITY, types, dtype=bool)
    landmarks[NUM_IDENTITY, 0, types] = True
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
        **_identities(_IS_RELATION, np.eye(NUM_RELATIONS, dtype=bool)[:, :, None]),
        **_identities(_IS_LANDMARK, landmarks),
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
    own = np.isin(np.arange(1, NUM_RANKS + 1), sorted(senses.ranks))
    said = {"bias": True, "named": own, "another named": ~own & bool(senses.ranks)}
    return said | _identities(_IS_RANK, np.eye(NUM_RANKS, dtype=bool))


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
    names = [f"{kind}: {name}" for kind, of_kind in columns.items() for name in of_kind]
    in_common = _shared_columns(senses, child)
    shared = stack_columns((space.size,), in_common)
    joined = np.zeros((space.size, len(names) + shared.shape[1]), np.float32)
    shapes = [part.shape for part in space.parts(child.expressed)]
    row = column = 0
    for shape, of_kind in zip(shapes, columns.values(), strict=True):
        table = stack_columns(shape, of_kind)
        joined[row : row + table.shape[0], column : column + table.shape[1]] = table
        row, column = row + table.shape[0], column + table.shape[1]
    joined[:, column:] = shared
    return (*names, *(f"any: {name}" for name in in_common)), joined
