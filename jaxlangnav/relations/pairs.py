"""Labelled pairs of a figure and a landmark, in every frame of reference (section 3.2, eq. 7a).

What people say of where things are, as data: the word, both places, where the speaker stood at the
utterance and where the robot is now. In which of the frames it was meant is not labelled.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import RELATIONS
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.relations import (
    ReferenceFrame,
    RelationParams,
    law_of,
    log_density_of,
    prepare,
    robot_frame,
    viewer_frame,
)

FRAMES = ("viewer", "robot", "undirected")
"""Frames of reference of the mixture, in the order of every axis F."""


@pytree
class RelationPairs:
    """Labelled pairs; metres and radians, map frame."""

    relation: Array  # i32[N] index into ``messages.RELATIONS``
    figure_x: Array  # f32[N]
    figure_y: Array  # f32[N]
    landmark_x: Array  # f32[N] not read where the landmark is the robot
    landmark_y: Array  # f32[N]
    is_robot: Array  # bool[N] the landmark is the robot itself ("on your left")
    viewer: Array  # f32[N, 3] x, y, heading of speaker and robot at the utterance
    robot: Array  # f32[N, 3] x, y, heading of the robot now


def make_pairs(
    relation: np.ndarray,
    figure: np.ndarray,
    landmark: np.ndarray,
    viewer: np.ndarray,
    robot: np.ndarray | None = None,
    is_robot: np.ndarray | None = None,
) -> RelationPairs:
    """Check and pack labelled pairs (host only).

    Args:
        relation: i[N], index into ``messages.RELATIONS``.
        figure: f[N, 2], metres, map frame.
        landmark: f[N, 2], metres.
        viewer: f[N, 3], x, y, heading at the utterance, metres and radians.
        robot: f[N, 3], the robot's present pose; the viewer's by default.
        is_robot: bool[N], the landmark is the robot itself; False by default.

    Returns:
        The pairs.

    Raises:
        ValueError: no pairs, shapes that do not agree, an unknown relation, numbers that are not
            finite.
    """
    word = np.atleast_1d(np.asarray(relation))
    number = len(word)
    if number == 0:
        raise ValueError("there are no pairs to fit relations to")
    present = np.asarray(viewer if robot is None else robot, np.float32)
    own = np.zeros(number, bool) if is_robot is None else np.asarray(is_robot, bool)
    shaped = {
        "figure": (np.asarray(figure, np.float32), (number, 2)),
        "landmark": (np.asarray(landmark, np.float32), (number, 2)),
        "viewer": (np.asarray(viewer, np.float32), (number, 3)),
        "robot": (present, (number, 3)),
        "is_robot": (own, (number,)),
    }
    for name, (values, shape) in shaped.items():
        if values.shape != shape:
            raise ValueError(f"{name} has shape {values.shape}, but {number} pairs need {shape}")
        if not np.isfinite(values).all():
            raise ValueError(f"{name} holds numbers that are not finite: leave those pairs out")
    if not np.isin(word, np.arange(len(RELATIONS))).all():
        raise ValueError(
            f"relation must be an index from 0 to {len(RELATIONS) - 1} ({', '.join(RELATIONS)})"
        )
    figure, landmark = shaped["figure"][0], shaped["landmark"][0]
    return RelationPairs(
        relation=jnp.asarray(word, jnp.int32),
        figure_x=jnp.asarray(figure[:, 0]),
        figure_y=jnp.asarray(figure[:, 1]),
        landmark_x=jnp.asarray(landmark[:, 0]),
        landmark_y=jnp.asarray(landmark[:, 1]),
        is_robot=jnp.asarray(own),
        viewer=jnp.asarray(shaped["viewer"][0]),
        robot=jnp.asarray(present),
    )


def _in_frame(pairs: RelationPairs, pose: Array) -> tuple[Array, Array, ReferenceFrame]:
    """Compute offsets and directions of the pairs as seen from a pose f32[N, 3]."""
    x = jnp.where(pairs.is_robot, pose[:, 0], pairs.landmark_x)
    y = jnp.where(pairs.is_robot, pose[:, 1], pairs.landmark_y)
    seen, own = viewer_frame(pose[:, 0], pose[:, 1], x, y), robot_frame(pose[:, 2])
    frame = jax.tree.map(lambda one, other: jnp.where(pairs.is_robot, one, other), own, seen)
    return pairs.figure_x - x, pairs.figure_y - y, frame


def log_frame_densities(pairs: RelationPairs, *, params: RelationParams) -> Array:
    """Evaluate every pair in every frame, without the frames' shares.

    Limits: κ = 0 makes the viewer's frame and "undirected" the same; a robot that has not moved
    since the utterance makes its present frame the viewer's.

    Args:
        pairs: N labelled pairs.
        params: relations.

    Returns:
        f32[N, F], log-density per square metre.
    """
    by_viewer = _in_frame(pairs, pairs.viewer)
    by_robot = _in_frame(pairs, pairs.robot)
    directed = law_of(prepare(params), pairs.relation)
    ring = law_of(prepare(replace(params, concentration=jnp.zeros(6))), pairs.relation)
    return jnp.stack(
        [
            log_density_of(directed, *by_viewer),
            log_density_of(directed, *by_robot),
            log_density_of(ring, *by_viewer),
        ],
        axis=1,
    )
