"""Registry of relations, with their free parameters and frames of reference (section 3.2, eq. 7a).

A relation is relative to the frame of the viewer at the utterance: "behind the cone" is beyond the
cone as seen from there. If the robot itself is the landmark ("on your left"), the frame is the
robot's intrinsic one at the utterance.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from jaxlangnav.messages import AT, BEHIND, FAR, FRONT, LEFT, NEAR, RIGHT
from jaxlangnav.pytree import field, pytree


@dataclasses.dataclass(frozen=True)
class SpatialRelation:
    """One relation: its names and the parameters of its density.

    With one landmark the figure's distance is log-normal and its direction von Mises about the axis
    (``density``); with two landmarks the relation has a module of its own (``between``).
    """

    name: str  # in documents
    words: str  # preposition before the landmark
    converse: int | None  # relation of the landmark to the figure: "behind" for "in front of"
    axis: float | None = None  # radians from ``along``, counter-clockwise; None: undirected
    distance: float = 2.4  # metres, median
    distance_sd: float = 0.35  # of the log of the distance
    order: tuple[float, float] | None = None  # "nearest": −1 by distance; "leftmost": 1 to the left
    num_landmarks: int = 1
    symbol: int | None = None  # its annotation symbol, if it has none of its own


REGISTRY = (
    SpatialRelation("front", "in front of", BEHIND, math.pi),
    SpatialRelation("behind", "behind", FRONT, 0.0),
    SpatialRelation("left", "to the left of", RIGHT, math.pi / 2, order=(0.0, 1.0)),
    SpatialRelation("right", "to the right of", LEFT, -math.pi / 2, order=(0.0, -1.0)),
    SpatialRelation("near", "near", NEAR, distance=2.2, order=(-1.0, 0.0)),
    SpatialRelation("far", "far from", FAR, None, 9.0, 0.3, order=(1.0, 0.0)),
    SpatialRelation("at", "at", AT, distance=0.0),
    SpatialRelation("between", "between", None, num_landmarks=2, symbol=NEAR),
)
"""In the order of ``messages.RELATIONS``, ``AT``, ``BETWEEN``; a neighbourhood is a few metres."""
SIDES = tuple(index for index, row in enumerate(REGISTRY) if row.axis is not None)
"""Directed relations: with the robot as the landmark, its sides."""
ORDERS = tuple(index for index, row in enumerate(REGISTRY) if row.order)
SYMBOL_OF = tuple(i if row.symbol is None else row.symbol for i, row in enumerate(REGISTRY))
"""Annotation symbol of each relation."""
MODELLED = [i for i, row in enumerate(REGISTRY) if row.num_landmarks == 1 and i != AT]
"""Relations with a row in ``RelationParams``: the six of section 3.1, and extensions."""
ROW_OF = [MODELLED.index(i if i in MODELLED else NEAR) for i in range(len(REGISTRY))]
NUM_RANKS = 4
"""Maximum rank: nearest (first), second, third, fourth."""


def symbol_of(relation: Array) -> Array:
    """Look up the annotation symbols of relations, i32[...]; NONE stays."""
    return jnp.where(relation < 0, relation, jnp.asarray(SYMBOL_OF, jnp.int32)[relation])


@pytree
class RelationParams:
    """Free parameters of the R relations of ``MODELLED``."""

    log_distance: Array = field("μ, log metres")  # f32[R]
    log_distance_sd: Array = field("σ, dimensionless")  # f32[R]
    axis: Array = field("radians, direction in the frame, 0: along, π/2: to the left")  # f32[R]
    concentration: Array = field("κ; 0 is undirected")  # f32[R]


def default_params() -> RelationParams:
    """Build the default parameters of the registry; directed relations have κ = 12."""
    rows = [REGISTRY[index] for index in MODELLED]
    return RelationParams(
        log_distance=jnp.log(jnp.array([row.distance for row in rows], jnp.float32)),
        log_distance_sd=jnp.array([row.distance_sd for row in rows], jnp.float32),
        axis=jnp.array([row.axis or 0.0 for row in rows], jnp.float32),
        concentration=jnp.array([0.0 if row.axis is None else 12.0 for row in rows], jnp.float32),
    )


@pytree
class ReferenceFrame:
    """Frame of reference of a relation: orthonormal directions in the map frame."""

    along_x: Array  # f32[...]
    along_y: Array  # f32[...]
    lateral_x: Array  # f32[...]
    lateral_y: Array  # f32[...]


def viewer_frame(
    viewer_x: ArrayLike, viewer_y: ArrayLike, landmark_x: ArrayLike, landmark_y: ArrayLike
) -> ReferenceFrame:
    """Build the frame of a viewer who faces a landmark, both f32[...] x, y, map frame.

    ``along`` points from the viewer through the landmark, ``lateral`` to the viewer's left.
    """
    dx, dy = jnp.subtract(landmark_x, viewer_x), jnp.subtract(landmark_y, viewer_y)
    scale = jax.lax.rsqrt(dx * dx + dy * dy + 1e-12)
    ux, uy = dx * scale, dy * scale
    return ReferenceFrame(along_x=ux, along_y=uy, lateral_x=-uy, lateral_y=ux)


def robot_frame(heading: Array) -> ReferenceFrame:
    """Build the intrinsic frame of the robot as landmark: "in front of you" is its heading.

    Of headings f32[...], map frame, ``along`` points backwards (for "behind"), ``lateral`` left.
    """
    cosine, sine = jnp.cos(heading), jnp.sin(heading)
    return ReferenceFrame(along_x=-cosine, along_y=-sine, lateral_x=-sine, lateral_y=cosine)


def to_frame(frame: ReferenceFrame, x: Array, y: Array) -> tuple[Array, Array]:
    """Transform offsets f32[...], metres, from map axes to along and lateral of a frame."""
    return x * frame.along_x + y * frame.along_y, x * frame.lateral_x + y * frame.lateral_y


def to_map(frame: ReferenceFrame, along: Array, lateral: Array) -> tuple[Array, Array]:
    """Transform frame coordinates f32[...], metres, to x and y in map axes."""
    x = along * frame.along_x + lateral * frame.lateral_x
    y = along * frame.along_y + lateral * frame.lateral_y
    return x, y
