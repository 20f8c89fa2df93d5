"""Worlds by hand: things where a test puts them."""

from collections.abc import Sequence

import numpy as np

from jaxlangnav.messages import NONE
from jaxlangnav.world import state
from jaxlangnav.world.state import Scenario

SIDE = (-20.0, 20.0, -20.0, 20.0)


def placed(
    things: Sequence, *, slots: int = 8, area: Sequence[float] = SIDE, goal: int = NONE, **more
) -> Scenario:
    """Put things, each its type, x and y, into the first of so many slots; one may be the goal."""
    if goal != NONE:
        more |= {"goal": np.float32(things[goal][1:]), "goal_index": np.int32(goal)}
    return state.placed(things, slots=slots, area=area, is_valid=np.bool_(True), **more)
