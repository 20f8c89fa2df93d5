"""Properties of behavior symbols: the grounding side of the bilinear score (section 3.3).

One world at a time, on the host: training, the reference search and tests use it. The device
kernel evaluates the same properties with bit arithmetic (``behavior``); a test compares the two.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxlangnav.grounding.behavior_properties import (
    CONSTRAINT_PROPERTIES,
    GOAL_PROPERTIES,
    OBJECT_PROPERTIES,
    REGION_PROPERTIES,
    PhraseWords,
    evaluate_properties,
)
from jaxlangnav.grounding.features import Senses
from jaxlangnav.grounding.symbols import NUM_REGIONS, NUM_RELATIONS
from jaxlangnav.messages import ACTIONS, AT, MODES, ROBOT


@dataclasses.dataclass(frozen=True)
class World:
    """Placed objects of one world on the host; the last slot is the robot."""

    object_type: np.ndarray  # i32[N] type index; ROBOT last
    is_object: np.ndarray  # bool[N]
    is_related: np.ndarray  # bool[6, N, N] relation, figure, landmark
    is_ranked: np.ndarray  # bool[4, 6, N, N] the figure is the extreme of its type, the second, ...
    is_previous: np.ndarray  # bool[N] goal of the command before


@dataclasses.dataclass(frozen=True)
class ChildGroundings:
    """What the child phrases express in one world."""

    objects: np.ndarray  # bool[N]
    regions: np.ndarray  # bool[7, N] regions, and goals of child verb phrases
    constraints: np.ndarray  # bool[7, N]
    lies: np.ndarray  # bool[N] lies in a region of every restricting child; all if there is none
    is_restricted: bool
    has_children: bool


def lies_in(world: World, regions: np.ndarray, rank: np.ndarray) -> np.ndarray:
    """Find which objects lie in one of the regions.

    Args:
        world: the world.
        regions: bool[7, N] regions.
        rank: i[7], 0 where every object of the region is meant, 1 the extreme one, 2 the second.

    Returns:
        bool[N]; an object lies "at" itself.
    """
    lies = regions[AT].copy()
    for relation in range(NUM_RELATIONS):
        table = world.is_ranked[rank[relation] - 1] if rank[relation] else world.is_related
        lies |= (table[relation] & regions[relation]).any(1)
    return lies & world.is_object


def _stack(shape: tuple[int, ...], columns: Sequence[np.ndarray | bool]) -> np.ndarray:
    """Stack broadcast properties to f32[symbols, F]."""
    table = np.empty((*shape, len(columns)), np.float32)
    for i, column in enumerate(columns):
        table[..., i] = column
    return table.reshape(-1, len(columns))


def agrees(world: World, senses: Senses) -> np.ndarray:
    """Find the objects of the types that the words name; the robot for "you"; bool[N]."""
    is_type = np.isin(world.object_type, sorted(senses.types))
    return (is_type | ((world.object_type == ROBOT) & senses.is_robot)) & world.is_object


def _words(senses: Senses, child: ChildGroundings) -> PhraseWords:
    """Read what the gates need."""
    return PhraseWords.of(senses, child.has_children, child.is_restricted)


def placed_object_properties(world: World, senses: Senses, child: ChildGroundings) -> np.ndarray:
    """Describe the object symbols of a noun or preposition phrase (``OBJECT_PROPERTIES``).

    Args:
        world: the world.
        senses: of the phrase's own words.
        child: groundings of its child phrases.

    Returns:
        f32[N, 13].
    """
    own = agrees(world, senses)
    # What is called by no type may be anything, whatever the goal before was.
    is_previous = world.is_previous & (not senses.is_thing)
    has_previous = bool(is_previous.any())
    alike = np.isin(world.object_type, world.object_type[is_previous])
    inside, lies = child.objects, child.lies
    conditions = {
        "always": True,
        "own": own,
        "other": ~own,
        "inside": inside,
        "inside_lies": inside & lies,
        "inside_elsewhere": inside & ~lies,
        "outside": ~inside,
        "own_lies": own & lies,
        "own_previous": own & is_previous,
        "previous": is_previous,
        "alike": alike & ~is_previous,
        "unlike": ~alike & has_previous,
        "no_previous": not has_previous,
    }
    return _stack(
        own.shape, evaluate_properties(OBJECT_PROPERTIES, _words(senses, child), conditions)
    )


def _regions(world: World, senses: Senses, child: ChildGroundings) -> dict[str, np.ndarray | bool]:
    """Evaluate the conditions of regions and goals, bool[7, N] and what broadcasts to it."""
    inside, same = child.objects[None], child.regions
    return {
        "base": True,
        "inside": inside,
        "same": same,
        "absent": ~inside & ~same,
        "own": agrees(world, senses)[None],
        "robot": (world.object_type == ROBOT)[None],
    }


def placed_region_properties(world: World, senses: Senses, child: ChildGroundings) -> np.ndarray:
    """Describe the region symbols (``REGION_PROPERTIES``); arguments as above, f32[7 N, 25]."""
    conditions = _regions(world, senses, child)
    columns = evaluate_properties(REGION_PROPERTIES, _words(senses, child), conditions)
    return _stack(child.regions.shape, columns)


def goal_properties(world: World, senses: Senses, child: ChildGroundings) -> np.ndarray:
    """Describe the goal symbols (``GOAL_PROPERTIES``); arguments as above, f32[7 N, 23]."""
    conditions = _regions(world, senses, child)
    columns = evaluate_properties(GOAL_PROPERTIES, _words(senses, child), conditions)
    return _stack(child.regions.shape, columns)


def constraint_properties(world: World, senses: Senses, child: ChildGroundings) -> np.ndarray:
    """Describe constraints (``CONSTRAINT_PROPERTIES``); arguments as above, f32[7 N, 18]."""
    inside, same = child.objects[None], child.regions
    touched = inside | same.any(0, keepdims=True)
    conditions = {
        "base": True,
        "same": same,
        "inside": inside,
        "touched": touched,
        "untouched": ~touched,
        "kept": child.constraints,
        "new": touched & ~child.constraints,
    }
    columns = evaluate_properties(CONSTRAINT_PROPERTIES, _words(senses, child), conditions)
    return _stack((NUM_REGIONS, world.object_type.shape[0]), columns)


def _choice_properties(named: frozenset[int], size: int) -> np.ndarray:
    """Describe the symbols of actions or modes, of which the words name some, f32[size, F]."""
    own = np.isin(np.arange(size), sorted(named))
    is_named = bool(named)
    return _stack((size,), [True, own, ~own & is_named, not is_named, *np.eye(size, dtype=bool)])


def action_properties(senses: Senses) -> np.ndarray:
    """Describe the two actions, f32[2, 6]."""
    return _choice_properties(senses.actions, len(ACTIONS))


def mode_properties(senses: Senses) -> np.ndarray:
    """Describe the three modes, f32[3, 7]."""
    return _choice_properties(senses.modes, len(MODES))
