"""Records of the ground truth: what a simulated place holds and where its robot is (section 4.2).

Axis letters: **O** object slots of a world (eight by default), **E** episodes in a batch, **T**
types that a detector tells apart, **G** places at which it is apt to see what is not there.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jax import Array

from jaxlangnav.messages import NONE
from jaxlangnav.pytree import pytree
from jaxlangnav.terrain import OPEN, POSITIONS, SensorModel, Terrain

HYDRANT, CONE = 0, 1
"""Type indices, by the lexicon's order, of the two types that the templates of Table 2 place."""
NUM_SLOTS = 8
"""Object slots of a world, unless it needs more."""


@pytree
class Errors:
    """What a detector gets wrong in one place, at the rates that its ``SensorParams`` give.

    Without this record nothing is invented and every label is right, whatever the rates.
    """

    is_type: Array  # bool[T] types told apart: a wrong label is any other of them, equally likely
    is_invented: Array  # bool[T] types that false detections take, each at the rate of one type
    haunt_type: Array  # i32[G] what fixed places are mistaken for; NONE in empty slots
    haunt_x: Array  # f32[G] metres
    haunt_y: Array  # f32[G] metres
    haunt_probability: Array  # f32[] of such a place in view to be reported in one look


@pytree
class Scenario:
    """One place with its objects, the robot's start and the intended goal; map frame, metres."""

    object_type: Array  # i32[O] type index; NONE in empty slots
    object_x: Array  # f32[O] metres
    object_y: Array  # f32[O] metres
    is_object: Array  # bool[O]
    goal: Array  # f32[2] metres: where a successful robot stops
    goal_index: Array  # i32[] slot of the intended object; NONE where the goal is a mere place
    start: Array  # f32[3] x, y metres, heading radians
    area: Array  # f32[4] x_min, x_max, y_min, y_max metres: the operating area, known to all
    is_valid: Array  # bool[] the law of the template was met; False: count it, do not use it
    terrain: Terrain = OPEN  # what hides things there and what is in the way, known to all as well
    sensor_model: SensorModel = POSITIONS  # how the robot's detector reports
    object_attribute: Array | None = None  # i32[O] codes of ``attributes``, where reported
    errors: Errors | None = None  # what the detector gets wrong there; None: nothing


@pytree
class WorldState:
    """Where the robot truly is, and where its odometry says it is."""

    position: Array  # f32[2] true, map frame, metres
    heading: Array  # f32[] radians, true; odometry's too, unless that drifts
    odometry: Array  # f32[3] x, y metres, heading radians: dead reckoning from the start pose
    distance: Array  # f32[] metres truly travelled so far


def placed(
    things: Sequence[Any] = (),
    *,
    slots: int = NUM_SLOTS,
    area: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    **more: Any,
) -> Scenario:
    """Put things by hand, on the host.

    Args:
        things: type, x and y of each, metres, map frame: in the first slots.
        slots: O, object slots.
        area: x_min, x_max, y_min, y_max, metres.
        **more: further fields of the scenario; by default it has no goal and starts at the origin.

    Returns:
        The place; one of no things is not valid.
    """
    rows = np.full((slots, 3), (NONE, 0.0, 0.0), np.float32)
    rows[: len(things)] = np.reshape(things, (-1, 3))
    fields = {
        "object_type": rows[:, 0].astype(np.int32),
        "object_x": rows[:, 1],
        "object_y": rows[:, 2],
        "is_object": np.arange(slots) < len(things),
        "goal": np.zeros(2, np.float32),
        "goal_index": np.asarray(NONE, np.int32),
        "start": np.zeros(3, np.float32),
        "area": np.asarray(area, np.float32),
        "is_valid": np.asarray(len(things) > 0),
    }
    return Scenario(**(fields | more))


def empty_scenario(number: int = NUM_SLOTS) -> Scenario:
    """Build a place without objects, on the host; of the shapes of one with so many slots."""
    return placed(slots=number)


def walls_of(scenario: Scenario) -> np.ndarray:
    """List the walls of a place, f32[W, 4], x, y of both ends, metres (host); each once."""
    ends = np.asarray(getattr(scenario.terrain.view, "ends", np.zeros((0, 4), np.float32)))
    return ends[np.sort(np.unique(ends, axis=0, return_index=True)[1])]
