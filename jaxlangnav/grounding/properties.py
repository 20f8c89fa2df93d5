"""What is seen of every symbol that a phrase may express, given what its children do (eq. 4).

The device form of the behavior part is ``behavior_odds``, with the words contracted in before.
"""

import functools
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from jaxlangnav.grounding import annotation_features as af
from jaxlangnav.grounding import behavior_features as bf
from jaxlangnav.grounding.behavior_properties import PROPERTY_NAMES
from jaxlangnav.grounding.features import RESTRICTORS, Senses, senses_of
from jaxlangnav.grounding.symbols import (
    ACTION,
    CONSTRAINT,
    GOAL,
    MODE,
    NUM_REGIONS,
    OBJECT,
    REGION,
    AnnotationSpace,
    BehaviorSpace,
)
from jaxlangnav.language.phrase import Phrase

Path = tuple[int, ...]
"""Clause index, then child indices from the root of the clause."""


def _annotation_tables(
    space: AnnotationSpace, senses: Senses, groundings: list[np.ndarray]
) -> dict[str, af.PropertyTable]:
    """Describe every annotation symbol of a phrase; arguments as ``annotation_properties``."""
    child = af.child_sets(space, groundings)
    expressed = np.zeros(space.size, bool)
    for grounding in groundings:
        expressed |= grounding
    tables = {
        "object": af.object_properties(space, senses, child),
        "region": af.region_properties(space, senses, child),
        "relation": af.relation_properties(space, senses, child),
    }
    shared = af.shared_properties(senses, expressed, len(groundings))
    return {"symbol": af.join_kinds(tables, shared), "rank": af.rank_properties(senses)}


def annotation_properties(
    space: AnnotationSpace, senses: Senses, groundings: list[np.ndarray]
) -> dict[str, np.ndarray]:
    """Describe every annotation symbol of a phrase.

    Args:
        space: annotation symbols.
        senses: of the phrase's words.
        groundings: bool[S] of each child phrase.

    Returns:
        "symbol" → f32[S, F], and "rank" → f32[4, F].
    """
    tables = _annotation_tables(space, senses, groundings)
    return {kind: table.values for kind, table in tables.items()}


@functools.cache
def property_names() -> Mapping[str, tuple[str, ...]]:
    """Name the columns of the weights of every kind of symbol; files of weights hold the names.

    Returns:
        Kind, of either model, → F names.
    """
    nothing = Senses(*[frozenset()] * 5, is_robot=False)
    tables = _annotation_tables(AnnotationSpace(1), nothing, [])
    own = {kind: table.names for kind, table in tables.items()}
    return MappingProxyType(own | PROPERTY_NAMES)


def child_groundings(
    world: bf.World,
    space: BehaviorSpace,
    children: Sequence[tuple[Phrase, np.ndarray, np.ndarray]],
) -> bf.ChildGroundings:
    """Join what the child phrases express in a world.

    Args:
        world: the world.
        space: its symbols.
        children: (phrase, bool[S] expressed, i[7] rank meant for each relation) each.

    Returns:
        Their groundings, as the properties need them.
    """
    num_objects = world.object_type.shape[0]
    objects = np.zeros(num_objects, bool)
    regions = np.zeros((NUM_REGIONS, num_objects), bool)
    constraints = np.zeros((NUM_REGIONS, num_objects), bool)
    lies = world.is_object.copy()
    is_restricted = False
    for phrase, expressed, rank in children:
        places = space.part(expressed, REGION) | space.part(expressed, GOAL)
        objects |= space.part(expressed, OBJECT)
        regions |= places
        constraints |= space.part(expressed, CONSTRAINT)
        if phrase.label in RESTRICTORS:
            lies &= bf.lies_in(world, places, rank)
            is_restricted = True
    return bf.ChildGroundings(objects, regions, constraints, lies, is_restricted, bool(children))


def behavior_properties(
    world: bf.World, is_verb: bool, senses: Senses, child: bf.ChildGroundings
) -> dict[str, np.ndarray]:
    """Describe every behavior symbol of a phrase.

    Args:
        world: the world.
        is_verb: whether the phrase grounds to actions, modes, goals and constraints.
        senses: of the phrase's words.
        child: groundings of its children.

    Returns:
        Kind → f32[symbols of the kind, F].
    """
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


KIND_OF = {
    "object": OBJECT,
    "region": REGION,
    "goal": GOAL,
    "constraint": CONSTRAINT,
    "action": ACTION,
    "mode": MODE,
}
"""Names of the weight blocks of the behavior model → kinds of symbol."""


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
