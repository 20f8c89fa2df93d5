"""Worlds whose objects have known places: which relations hold there, and how strongly.

Which relations hold is geometry (``relations.holds``); which object is the nearest, the second or
the leftmost is a comparison among the objects of one type.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.inputs.program_cache import cached_jit
from jaxlangnav.messages import RELATIONS
from jaxlangnav.relations import holds
from jaxlangnav.relations.strength import degree
from jaxlangnav.relations.table import SIDES

SIDE_RANGE = 5.0
"""Metres: the corpus calls nothing "on your left" that is farther off."""


@dataclass(frozen=True, kw_only=True)
class PlacedWorld:
    """Objects whose places are known, and the robot among them."""

    objects: tuple[tuple[str, float, float], ...]  # type, x, y; map frame, metres
    robot: tuple[float, float, float]  # x, y, heading; metres, radians
    previous: int | None = None  # the goal of the command before this one
    attributes: tuple[int, ...] = ()  # of each object, codes of ``attributes``; or of none


@cached_jit()
def _all_relations(places: Array, viewer: Array, heading: Array) -> Array:
    """Evaluate all relations: bool[6, N, N + 1], landmark N is the robot."""
    own_heading: Any = heading

    def one(relation: int) -> Array:
        pairs = holds(relation, places[:, None], places[None, :], viewer)
        own = holds(relation, places, viewer, viewer, own_heading)
        return jnp.concatenate([pairs, own[:, None]], axis=1)

    return jnp.stack([one(relation) for relation in range(len(RELATIONS))])


class Geometry:
    """Which relations hold between the objects of a world, and how strongly."""

    def __init__(self, world: PlacedWorld, *, side_range: float = SIDE_RANGE) -> None:
        """Evaluate all six relations over all pairs; index ``len(objects)`` stands for the robot.

        Up to ``side_range`` metres something is on a side of the robot.
        """
        count = len(world.objects)
        places = np.array([[x, y] for _, x, y in world.objects], np.float32).reshape(-1, 2)
        viewer = np.array(world.robot[:2], np.float32)
        heading = world.robot[2]
        where = jax.device_put((places, viewer, np.float32(heading)))
        self.holds = np.array(_all_relations(*where))
        points = np.concatenate([places, viewer[None]], 0)
        offset = places[:, None] - points[None]
        distance = np.linalg.norm(offset, axis=-1)
        sides = np.ix_(SIDES, range(count), [count])
        self.holds[sides] &= distance[:, -1:] <= side_range
        sideways = offset @ np.array([-np.sin(heading), np.cos(heading)])
        # How much each relation holds, f64[6, N, N + 1], larger is more so.
        self.strength = np.stack([degree(one, distance, sideways) for one in range(len(RELATIONS))])
