"""The axes, free parameters and frames of the relations (section 3.2, eq. 7a): the only place.

A relation is understood in the frame of the viewer at the moment of the utterance: "behind the
cone" lies beyond the cone as seen from where the person spoke. Where the robot itself is the
landmark ("on your left"), the frame is the robot's own at that moment.
"""

import math

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

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


@pytree
class ReferenceFrame:
    """Orthonormal directions in which a relation is understood, map frame."""

    along_x: Array  # f32[...]
    along_y: Array  # f32[...]
    lateral_x: Array  # f32[...]
    lateral_y: Array  # f32[...]


def viewer_frame(
    viewer_x: ArrayLike, viewer_y: ArrayLike, landmark_x: ArrayLike, landmark_y: ArrayLike
) -> ReferenceFrame:
    """Build the frame of somebody who looks at a landmark, both f32[...] x, y, map frame.

    ``along`` points from the viewer through the landmark, ``lateral`` to the viewer's left.
    """
    dx, dy = jnp.subtract(landmark_x, viewer_x), jnp.subtract(landmark_y, viewer_y)
    scale = jax.lax.rsqrt(dx * dx + dy * dy + 1e-12)
    ux, uy = dx * scale, dy * scale
    return ReferenceFrame(along_x=ux, along_y=uy, lateral_x=-uy, lateral_y=ux)


def robot_frame(heading: Array) -> ReferenceFrame:
    """Build the frame of the robot as its own landmark: "in front of you" is where it heads.

    Of headings f32[...], map frame, ``along`` points backwards (for "behind"), ``lateral`` left.
    """
    cosine, sine = jnp.cos(heading), jnp.sin(heading)
    return ReferenceFrame(along_x=-cosine, along_y=-sine, lateral_x=-sine, lateral_y=cosine)


def to_frame(frame: ReferenceFrame, x: Array, y: Array) -> tuple[Array, Array]:
    """Turn offsets f32[...], metres, map axes, into along and lateral of a frame."""
    return x * frame.along_x + y * frame.along_y, x * frame.lateral_x + y * frame.lateral_y


def to_map(frame: ReferenceFrame, along: Array, lateral: Array) -> tuple[Array, Array]:
    """Turn frame coordinates f32[...], metres, into x and y in map axes."""
    return (
        along * frame.along_x + lateral * frame.lateral_x,
        along * frame.along_y + lateral * frame.lateral_y,
    )
