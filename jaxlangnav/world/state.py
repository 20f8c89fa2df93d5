"""Ground-truth records: a simulated world and the state of its robot (section 4.2).

Axis letters: **O** object slots of a world (eight by default), **E** episodes in a batch, **G**
fixed positions of recurring false detections.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jax import Array

from jaxlangnav.messages import NONE
from jaxlangnav.pytree import pytree
from jaxlangnav.terrain import OPEN, RANGING, SensorModel, Terrain

HYDRANT, CONE = 0, 1
"""Type indices, in the lexicon's order, of the two types in the templates of Table 2."""
CLUTTER_TYPES = (HYDRANT, CONE)
"""Types of random false detections, the worst case for a sentence about them."""
NUM_TYPES = 8
"""T, types of the shipped lexicon."""
NUM_SLOTS = 8
"""Default number of object slots of a world."""


@pytree
class Errors:
    """Detector errors in one world, at the rates of its ``SensorParams``.

    Random clutter is of ``CLUTTER_TYPES``, each at the rate of one type; a wrong label is any other
    type, uniformly. Without this record there are no false detections or wrong labels, whatever the
    rates.
    """

    clutter_type: Array  # i32[G] types of fixed clutter; NONE in empty slots
    clutter_x: Array  # f32[G] metres
    clutter_y: Array  # f32[G] metres
    clutter_probability: Array  # f32[] of fixed clutter in view to be reported in one scan


@pytree
class Scenario:
    """One world with its objects, the robot's start and the intended goal; map frame, metres."""

    object_type: Array  # i32[O] type index; NONE in empty slots
    object_x: Array  # f32[O] metres
    object_y: Array  # f32[O] metres
    is_object: Array  # bool[O]
    goal: Array  # f32[2] metres: the intended goal
    goal_index: Array  # i32[] slot of the intended object; NONE where the goal is only a position
    start: Array  # f32[3] x, y metres, heading radians
    area: Array  # f32[4] x_min, x_max, y_min, y_max metres: the operating area, known to all
    is_valid: Array  # bool[] sampling met all constraints; if False exclude the world
    terrain: Terrain = OPEN  # occlusion and obstacles, known to all policies as well
    sensor_model: SensorModel = RANGING  # measurement model of the detector
    object_attribute: Array | None = None  # i32[O] attribute codes, where reported
    errors: Errors | None = None  # errors of the detector; None: none


@pytree
class WorldState:
    """True state of the robot, and its odometry."""

    position: Array  # f32[2] true, map frame, metres
    heading: Array  # f32[] radians, true; odometry's too, unless that drifts
    odometry: Array  # f32[3] x, y metres, heading radians: dead reckoning from the start pose
    distance: Array  # f32[] metres truly travelled so far


def make_scenario(
    objects: Sequence[Any] = (),
    *,
    slots: int = NUM_SLOTS,
    area: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    **fields: Any,
) -> Scenario:
    """Build a scenario from listed objects, on the host.

    Args:
        objects: type, x and y of each object, metres, map frame: in the first slots.
        slots: O, object slots.
        area: x_min, x_max, y_min, y_max, metres.
        **fields: of the scenario; by default without goal and with the start at the origin.

    Returns:
        The world; without objects it is not valid.
    """
    rows = np.full((slots, 3), (NONE, 0.0, 0.0), np.float32)
    rows[: len(objects)] = np.reshape(objects, (-1, 3))
    columns = {
        "object_type": rows[:, 0].astype(np.int32),
        "object_x": rows[:, 1],
        "object_y": rows[:, 2],
        "is_object": np.arange(slots) < len(objects),
        "goal": np.zeros(2, np.float32),
        "goal_index": np.asarray(NONE, np.int32),
        "start": np.zeros(3, np.float32),
        "area": np.asarray(area, np.float32),
        "is_valid": np.asarray(len(objects) > 0),
    }
    return Scenario(**(columns | fields))


def walls_of(scenario: Scenario) -> np.ndarray:
    """List the distinct walls of a world, f32[W, 4], x, y of both ends, metres (host)."""
    ends = np.asarray(getattr(scenario.terrain.view, "ends", np.zeros((0, 4), np.float32)))
    return ends[np.sort(np.unique(ends, axis=0, return_index=True)[1])]
