"""Worlds by hand: things where a test puts them."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from jaxlangnav.messages import NONE
from jaxlangnav.world import state
from jaxlangnav.world.files import to_toml
from jaxlangnav.world.state import Scenario, WorldState

SIDE = (-20.0, 20.0, -20.0, 20.0)


def placed(
    things: Sequence, *, slots: int = 8, area: Sequence[float] = SIDE, goal: int = NONE, **more
) -> Scenario:
    """Put things, each its type, x and y, into the first of so many slots; one may be the goal."""
    if goal != NONE:
        more |= {"goal": np.float32(things[goal][1:]), "goal_index": np.int32(goal)}
    return state.make_scenario(things, slots=slots, area=area, is_valid=np.bool_(True), **more)


def world_file(area: Sequence[float], *things: tuple[str, float, float], **more) -> str:
    """Write a world file: things by type, x and y, and whatever else it says."""
    sides = dict(zip(("x_min", "x_max", "y_min", "y_max"), area, strict=True))
    objects = [dict(zip(("type", "x", "y"), one, strict=True)) for one in things]
    return to_toml({**more, "area": sides, "objects": objects})


def standing(
    x: float = 0.0, y: float = 0.0, heading: float = 0.0, *, off: float = 0.0, walked: float = 0.0
) -> WorldState:
    """A robot at a place; its odometry has it so much to the upper right of there."""
    return WorldState(
        position=jnp.array([x, y]),
        heading=jnp.float32(heading),
        odometry=jnp.array([x + off, y + off, heading]),
        distance=jnp.float32(walked),
    )
