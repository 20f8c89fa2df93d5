"""Frames of reference, in which a relation is understood (section 3.2).

The frame is the viewer's at the moment of the utterance: "behind the cone" lies beyond the cone
as seen from where the person spoke. Where the robot itself is the landmark ("on your left"), the
frame is the robot's own at that moment.
"""

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from jaxlangnav.pytree import pytree


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


def to_map(frame: ReferenceFrame, along: Array, lateral: Array) -> tuple[Array, Array]:
    """Turn frame coordinates f32[...], metres, into x and y in map axes."""
    return (
        along * frame.along_x + lateral * frame.lateral_x,
        along * frame.along_y + lateral * frame.lateral_y,
    )
