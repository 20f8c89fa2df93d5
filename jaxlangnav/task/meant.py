"""Where a robot that knew the whole world would go: what the person means (section 4.2).

The commands of Table 2 have the goal that their world was built around. Any other sentence is
judged by what it means to the behavior model among the true objects, all of them known.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.conversation import seen_from
from jaxlangnav.grounding.instruction import Understanding
from jaxlangnav.language.labels import PlacedWorld
from jaxlangnav.messages import AT, NONE
from jaxlangnav.planner.goals import region_offset
from jaxlangnav.pytree import replace
from jaxlangnav.relations import default_params, prepare
from jaxlangnav.task.placed import infer_in, place_scenario
from jaxlangnav.world.simulator import SUCCESS_RADIUS
from jaxlangnav.world.state import Scenario

_LEAST = 0.05
"""Goals less probable than this are not meant."""
_ALIKE = 0.8
"""Goals of at least this share of the best one's probability fit as well."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Goal:
    """A place that a sentence may mean."""

    region: int  # index into messages.REGIONS
    index: int  # slot of the scenario; NONE for the robot itself
    position: tuple[float, float]  # metres, map frame: the typical place of the region


def meant_goals(understood: Understanding, scenario: Scenario) -> tuple[list[Goal], bool]:
    """List where the last command of a sentence may end, in a world of which all is known.

    Args:
        understood: the sentence.
        scenario: ground truth.

    Returns:
        The goals that fit best, none where nothing fits; and whether finding is enough.
    """
    placed = place_scenario(scenario, understood.type_names)
    behaviors = infer_in(understood.instruction, placed, understood.type_names)
    if not behaviors:
        return [], False
    last, told = behaviors[-1], understood.instruction
    metres, frame = (np.asarray(one)[len(behaviors) - 1] for one in (told.metres, told.frame))
    viewer = np.asarray(seen_from(jnp.asarray(placed.robot, jnp.float32), frame[None]))[0]
    best = float(last.goal.max())
    if best < _LEAST:
        return [], False
    kept = np.flatnonzero(np.asarray(scenario.is_object))
    goals = [
        Goal(
            region=int(region),
            index=int(kept[slot]) if slot < len(kept) else NONE,
            position=_position(placed, int(region), int(slot), viewer, metres),
        )
        for region, slot in zip(*np.nonzero(last.goal >= _ALIKE * best), strict=True)
    ]
    return goals, bool(last.action.argmax() == 1)


def is_among(scenario: Scenario, goals: list[Goal]) -> bool:
    """Tell whether a world's own goal is one of those that a sentence means.

    Args:
        scenario: with its goal: an object, or a mere place.
        goals: of ``meant_goals``.

    Returns:
        True where the object is meant itself, or the place is within reach of one meant.
    """
    own = int(scenario.goal_index)
    if own != NONE:
        return any(goal.region == AT and goal.index == own for goal in goals)
    x, y = np.asarray(scenario.goal).tolist()
    return any(
        np.hypot(x - goal.position[0], y - goal.position[1]) <= SUCCESS_RADIUS for goal in goals
    )


def with_goal(scenario: Scenario, goal: Goal) -> Scenario:
    """Make a place the intended goal of a world.

    Args:
        scenario: ground truth.
        goal: what is meant.

    Returns:
        The same world with another goal.
    """
    index = goal.index if goal.region == AT else NONE
    return replace(
        scenario, goal=jnp.asarray(goal.position, jnp.float32), goal_index=jnp.int32(index)
    )


def _position(
    placed: PlacedWorld, region: int, slot: int, viewer: np.ndarray, metres: np.float32
) -> tuple[float, float]:
    """Compute the place that a region means."""
    is_robot = slot == len(placed.objects)
    x, y = viewer[:2].tolist() if is_robot else placed.objects[slot][1:]
    if region == AT:
        return x, y
    place = np.int32(region), np.float32(x), np.float32(y), viewer, np.bool_(is_robot), metres
    offset = _offset(*place)
    return x + float(offset[0]), y + float(offset[1])


@jax.jit
def _offset(
    region: Array, x: Array, y: Array, viewer: Array, is_robot: Array, metres: Array
) -> tuple:
    """Compute where in a region a robot goes, the way the planner does it."""
    return region_offset(prepare(default_params()), region, x, y, viewer, is_robot, metres)
