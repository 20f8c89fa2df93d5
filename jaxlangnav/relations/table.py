"""The axes and the free parameters of the relations (section 3.2, eq. 7a): the only place."""

import math

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import BEHIND, FAR, FRONT, LEFT, NEAR, RELATIONS, RIGHT
from jaxlangnav.pytree import field, pytree

SIDES = (FRONT, BEHIND, LEFT, RIGHT)
"""Relations with an axis: of the robot itself they are its sides."""
AXIS = {FRONT: math.pi, BEHIND: 0.0, LEFT: math.pi / 2, RIGHT: -math.pi / 2, NEAR: 0.0, FAR: 0.0}
"""Radians from the frame's ``along``, counter-clockwise: behind is further along the line of sight.
"Near" and "far" lie all round, and have none."""
RELATION_WORDS = {
    "front": "in front of",
    "behind": "behind",
    "left": "to the left of",
    "right": "to the right of",
    "near": "near",
    "far": "far from",
}
"""What people say for a relation, before its landmark."""
CONVERSE = {FRONT: BEHIND, BEHIND: FRONT, LEFT: RIGHT, RIGHT: LEFT, NEAR: NEAR, FAR: FAR}
"""What a landmark is to its figure: "a cone with a tree behind it" is a cone in front of a tree."""
ORDERS = (LEFT, RIGHT, NEAR, FAR)
"""Relations by which things are ordered: "leftmost", "the second on your right", "nearest"."""
NUM_RANKS = 4
"""Ranks that can be told: nearest (first), second, third, fourth."""


@pytree
class RelationParams:
    """Free parameters of the six relations, in the order of ``messages.RELATIONS``."""

    log_distance: Array = field("μ, log metres")  # f32[6]
    log_distance_sd: Array = field("σ, dimensionless")  # f32[6]
    axis: Array = field("radians, direction in the frame, 0: along, π/2: to the left")  # f32[6]
    concentration: Array = field("κ; 0 is undirected")  # f32[6]


def default_params() -> RelationParams:
    """Build plausible relations: an object's neighbourhood is a few metres."""
    return RelationParams(
        log_distance=jnp.log(jnp.array([2.4, 2.4, 2.4, 2.4, 2.2, 8.0], jnp.float32)),
        log_distance_sd=jnp.array([0.35, 0.35, 0.35, 0.35, 0.35, 0.4], jnp.float32),
        axis=jnp.array([AXIS[index] for index in range(len(RELATIONS))], jnp.float32),
        concentration=jnp.array([12.0, 12.0, 12.0, 12.0, 0.0, 0.0], jnp.float32),
    )
