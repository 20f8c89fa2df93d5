"""Relations between objects at known positions: whether they hold, and their degree.

Whether a relation holds is geometric (``relations.holds``); which object is the nearest, the second
or the leftmost is a comparison of degrees among the objects of one type.
"""

from dataclasses import dataclass

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
"""Maximum distance in metres of "on your left" in the corpus."""


@dataclass(frozen=True, kw_only=True)
class PlacedWorld:
    """Objects at known positions, and the pose of the robot."""

    objects: tuple[tuple[str, float, float], ...]  # type, x, y; map frame, metres
    robot: tuple[float, float, float]  # x, y, heading; metres, radians
    previous: int | None = None  # index of the previous command's goal
    attributes: tuple[int, ...] = ()  # attribute code of each object, or empty


@cached_jit()
def _all_relations(positions: Array, viewer: Array, heading: Array) -> Array:
    """Evaluate all relations for all pairs, bool[6, N, N + 1]; landmark N is the robot."""

    def table(relation: int) -> Array:
        pairs = holds(relation, positions[:, None], positions[None, :], viewer)
        to_robot = holds(relation, positions, viewer, viewer, heading)
        return jnp.concatenate([pairs, to_robot[:, None]], axis=1)

    return jnp.stack([table(relation) for relation in range(len(RELATIONS))])


class Geometry:
    """Relations between the objects of a world, as booleans and degrees."""

    def __init__(self, world: PlacedWorld, *, side_range: float = SIDE_RANGE) -> None:
        """Evaluate all six relations over all pairs; index ``len(objects)`` is the robot.

        ``side_range`` is the maximum distance in metres of "left" and "right" of the robot.
        """
        count = len(world.objects)
        positions = np.array([[x, y] for _, x, y in world.objects], np.float32).reshape(-1, 2)
        viewer = np.array(world.robot[:2], np.float32)
        heading = world.robot[2]
        inputs = jax.device_put((positions, viewer, np.float32(heading)))
        self.holds = np.array(_all_relations(*inputs))
        offset = positions[:, None] - np.concatenate([positions, viewer[None]])[None]
        distance = np.linalg.norm(offset, axis=-1)
        self.holds[np.ix_(SIDES, range(count), [count])] &= distance[:, -1:] <= side_range
        lateral = offset @ np.array([-np.sin(heading), np.cos(heading)])
        # Degree of each relation, f64[6, N, N + 1]; larger is stronger.
        self.strength = np.stack([degree(r, distance, lateral) for r in range(len(RELATIONS))])
