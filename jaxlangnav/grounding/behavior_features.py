"""Properties of behavior symbols: the grounding side of the bilinear score (section 3.3).

One world at a time, on the host: training, the reference search and tests use it. The device
kernel evaluates the same properties with bit arithmetic (``behavior``); a test compares the two.
"""

import dataclasses

import numpy as np

from jaxlangnav.grounding.features import Senses
from jaxlangnav.grounding.symbols import NUM_REGIONS, NUM_RELATIONS
from jaxlangnav.messages import ACTIONS, AT, MODES, NEAR, ROBOT


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


def _stack(shape: tuple[int, ...], columns: list[np.ndarray | bool]) -> np.ndarray:
    """Stack broadcast properties to f32[symbols, F]."""
    table = np.empty((*shape, len(columns)), np.float32)
    for i, column in enumerate(columns):
        table[..., i] = column
    return table.reshape(-1, len(columns))


def agrees(world: World, senses: Senses) -> np.ndarray:
    """Find the objects of the types that the words name; the robot for "you"; bool[N]."""
    is_type = np.isin(world.object_type, sorted(senses.types))
    return (is_type | ((world.object_type == ROBOT) & senses.is_robot)) & world.is_object


def object_properties(world: World, senses: Senses, child: ChildGroundings) -> np.ndarray:
    """Describe the object symbols of a noun or preposition phrase.

    Args:
        world: the world.
        senses: of the phrase's own words.
        child: groundings of its child phrases.

    Returns:
        f32[N, 13].
    """
    own = agrees(world, senses)
    has_previous = bool(world.is_previous.any())
    alike = np.isin(world.object_type, world.object_type[world.is_previous])
    inside, lies, limited = child.objects, child.lies, child.is_restricted
    return _stack(
        own.shape,
        [
            True,
            own,
            ~own & (bool(senses.types) or senses.is_robot),
            inside,
            inside & lies & limited,
            inside & ~lies & limited,
            child.has_children & ~inside,
            own & lies & limited,
            own & world.is_previous,
            world.is_previous,
            alike & ~world.is_previous,
            ~alike & has_previous,
            not has_previous,
        ],
    )


def _relations(senses: Senses) -> np.ndarray:
    """Mark the regions that the words name, bool[7, 1]."""
    return np.isin(np.arange(NUM_REGIONS), sorted(senses.relations))[:, None]


def region_properties(world: World, senses: Senses, child: ChildGroundings) -> np.ndarray:
    """Describe the region symbols; arguments as ``object_properties``, f32[7 N, 25]."""
    relation, at = _relations(senses), (np.arange(NUM_REGIONS) == AT)[:, None]
    inside, same = child.objects[None], child.regions
    robot = (world.object_type == ROBOT)[None]
    is_lone = not child.has_children and not senses.types
    each = list(np.eye(NUM_REGIONS, dtype=bool)[:, :, None])
    return _stack(
        same.shape,
        [
            True,
            relation,
            inside,
            relation & inside,
            ~relation & inside & bool(senses.relations),
            same,
            child.has_children & ~inside & ~same,
            at & inside & (not senses.relations),
            relation & agrees(world, senses)[None],
            relation & robot & is_lone,
            robot,
            *each,
            *(row & inside for row in each),
        ],
    )


def goal_properties(world: World, senses: Senses, child: ChildGroundings) -> np.ndarray:
    """Describe the goal symbols of a verb phrase; arguments as above, f32[7 N, 23]."""
    relation, at = _relations(senses), (np.arange(NUM_REGIONS) == AT)[:, None]
    inside, same = child.objects[None], child.regions
    robot = (world.object_type == ROBOT)[None]
    each = list(np.eye(NUM_REGIONS, dtype=bool)[:, :, None])
    return _stack(
        same.shape,
        [
            True,
            same,
            inside,
            ~inside & ~same,
            at & inside,
            at & same,
            relation & inside,
            relation & same,
            relation & robot,
            *each,
            *(row & same for row in each),
        ],
    )


def constraint_properties(world: World, senses: Senses, child: ChildGroundings) -> np.ndarray:
    """Describe the constraint symbols of a verb phrase; arguments as above, f32[7 N, 18]."""
    del senses
    shape = (NUM_REGIONS, world.object_type.shape[0])
    at = (np.arange(NUM_REGIONS) == AT)[:, None]
    near = (np.arange(NUM_REGIONS) == NEAR)[:, None]
    inside, same = child.objects[None], child.regions
    touched = inside | same.any(0, keepdims=True)
    each = list(np.eye(NUM_REGIONS, dtype=bool)[:, :, None])
    return _stack(
        shape,
        [
            True,
            same,
            inside,
            touched,
            near & touched,
            at & touched,
            ~touched,
            child.constraints,
            touched & ~child.constraints,
            near & inside,
            at & inside,
            *each,
        ],
    )


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
