"""Worlds whose objects have known places: where the corpus labels behavior (section 3.3).

Which relations hold there is geometry (``relations.holds``), and which object is the nearest, the
second or the leftmost is a comparison among the objects of one type.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.kept import kept
from jaxlangnav.messages import FAR, NEAR, RELATIONS
from jaxlangnav.relations import holds


@dataclass(frozen=True, kw_only=True)
class PlacedWorld:
    """Objects whose places are known, and the robot among them."""

    objects: tuple[tuple[str, float, float], ...]  # type, x, y; map frame, metres
    robot: tuple[float, float, float]  # x, y, heading; metres, radians
    previous: int | None = None  # the goal of the command before this one
    attributes: tuple[int, ...] = ()  # of each object, codes of ``kinds.attributes``; or of none


@kept()
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

    def __init__(self, world: PlacedWorld, *, ranks_among_part: bool = True) -> None:
        """Evaluate all six relations over all pairs.

        Args:
            world: placed objects; index ``len(objects)`` stands for the robot.
            ranks_among_part: "the second cone on your left" is the second of those on the left;
                otherwise the second of all, if it is on the left.
        """
        self.world = world
        self.ranks_among_part = ranks_among_part
        self.num_objects = len(world.objects)
        self.everything = tuple(range(self.num_objects))
        places = np.array([[x, y] for _, x, y in world.objects], np.float32).reshape(-1, 2)
        viewer = np.array(world.robot[:2], np.float32)
        heading = world.robot[2]
        where = jax.device_put((places, viewer, np.float32(heading)))
        self.holds = np.asarray(_all_relations(*where))
        points = np.concatenate([places, viewer[None]], 0)
        self.offset = places[:, None] - points[None]
        self.distance = np.linalg.norm(self.offset, axis=-1)
        self.left = np.array([-np.sin(heading), np.cos(heading)])

    def strength(self, relation: int, figure: int, landmark: int) -> float:
        """Measure how much a relation holds, to find the extreme: larger is more so."""
        if relation == NEAR:
            return -float(self.distance[figure, landmark])
        if relation == FAR:
            return float(self.distance[figure, landmark])
        sideways = float(self.offset[figure, landmark] @ self.left)
        return sideways if RELATIONS[relation] == "left" else -sideways

    def is_extreme(
        self, relation: int, figure: int, landmark: int, place: int, among: tuple[int, ...]
    ) -> bool:
        """Tell whether a figure is the ``place``-th extreme of its type among some objects."""
        kind = self.world.objects[figure][0]
        mine = self.strength(relation, figure, landmark)
        more = sum(
            self.strength(relation, other, landmark) > mine
            for other in among
            if other not in (figure, landmark) and self.world.objects[other][0] == kind
        )
        return more == place - 1
