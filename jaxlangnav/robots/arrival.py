"""Whether the thing that a robot has arrived at is there: fail safe (section 4.3, ours).

A thing may have been moved after it was seen, or the robot may not be where it takes itself to be.
So an arrival is believed once the goal has been seen from where the robot halted.
"""

from collections.abc import Sequence

import jax
import numpy as np

from jaxlangnav.messages import AT
from jaxlangnav.navigator import NavigatorInfo, NavigatorState
from jaxlangnav.robots.robot import Detection

SAME_THING = 0.8
"""Metres within which a detection is of the goal that is believed to be there."""
GoalPoint = tuple[int, float, float]
"""Index of an object type, and x and y in the map frame, metres."""


def goal_object(state: NavigatorState, info: NavigatorInfo) -> GoalPoint | None:
    """Find the thing that a robot has arrived at.

    Args:
        state: after the decision to stop.
        info: of that decision.

    Returns:
        Its type and place; None where the goal is a mere region, which cannot be seen.
    """
    goals = jax.device_get(info.goals)
    mass = np.where(goals.is_object, goals.object_mass, 0.0)[:-1]
    away = np.hypot(goals.object_x[:-1] - info.robot[0], goals.object_y[:-1] - info.robot[1])
    slot = int(np.argmax(mass * np.exp(-away)))
    region = int(np.argmax(np.asarray(info.behavior.goal)[:, slot]))
    types = np.asarray(state.belief.particles.object_type)[slot]
    types = types[types >= 0]
    if region != AT or not len(types) or mass[slot] <= 0.0:
        return None
    kind = int(np.bincount(types).argmax())
    return kind, float(goals.object_x[slot]), float(goals.object_y[slot])


def is_seen(
    goal: GoalPoint,
    info: NavigatorInfo,
    found: Sequence[Detection],
    pose: np.ndarray,
) -> bool:
    """Tell whether one of the detections of a look is of the goal.

    Args:
        goal: what should be there.
        info: of the decision, with the believed place of the robot.
        found: what has been detected.
        pose: f64[3], of which the heading is used.

    Returns:
        True where one is of its type and near its place.
    """
    kind, x, y = goal
    robot_x, robot_y = np.asarray(info.robot, float)
    for one in found:
        bearing = pose[2] + one.bearing
        seen_x, seen_y = (
            robot_x + one.range * np.cos(bearing),
            robot_y + one.range * np.sin(bearing),
        )
        if one.object_type == kind and np.hypot(seen_x - x, seen_y - y) <= SAME_THING:
            return True
    return False
