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
from jaxlangnav.messages import RELATIONS
from jaxlangnav.relations import holds
from jaxlangnav.relations.strength import degree_of, num_before


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
        sideways = self.offset @ np.array([-np.sin(heading), np.cos(heading)])
        # How much each relation holds, f64[6, N, N + 1], larger is more so.
        self.strength = np.stack(
            [degree_of(one, self.distance, sideways) for one in range(len(RELATIONS))]
        )

    def is_extreme(
        self, relation: int, figure: int, landmark: int, place: int, among: tuple[int, ...]
    ) -> bool:
        """Tell whether a figure is the ``place``-th extreme of its type among some objects."""
        kind = self.world.objects[figure][0]
        is_rival = np.zeros(self.num_objects, bool)
        for other in among:
            is_alike = self.world.objects[other][0] == kind
            is_rival[other] = is_alike and other not in (figure, landmark)
        before = num_before(self.strength[relation, :, landmark], is_rival)
        return bool(before[figure] == place - 1)
