"""Worlds by hand: things where a test puts them."""

from collections.abc import Sequence

import numpy as np

from jaxlangnav.messages import NONE
from jaxlangnav.pytree import replace
from jaxlangnav.world.scenario import empty_scenario
from jaxlangnav.world.state import Scenario

SIDE = (-20.0, 20.0, -20.0, 20.0)


def placed(
    things: Sequence, *, slots: int = 8, area: Sequence[float] = SIDE, goal: int = NONE, **more
) -> Scenario:
    """Put things, each its type, x and y, into the first of so many slots; one may be the goal."""
    rows = np.full((slots, 3), (NONE, 0, 0), np.float32)
    rows[: len(things)] = np.reshape(things, (-1, 3))
    kind, x, y = rows.T
    return replace(
        empty_scenario(slots),
        object_type=kind.astype(np.int32),
        object_x=x,
        object_y=y,
        is_object=np.arange(slots) < len(things),
        goal=rows[goal, 1:] if goal != NONE else np.zeros(2, np.float32),
        goal_index=np.int32(goal),
        area=np.float32(area),
        is_valid=np.bool_(True),
        **more,
    )
