"""Labelled pairs of a figure and a landmark, and their density in each frame (section 3.2, eq. 7a).

A pair has a relation, the positions of figure and landmark, the speaker's pose at the utterance and
the robot's pose now. The intended frame of reference is not labelled.
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
    density_of,
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
    figure: Array  # f32[N, 2] x, y
    landmark: Array  # f32[N, 2] ignored where the landmark is the robot
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
    """Validate N labelled pairs and convert them to arrays (host only).

    Args:
        relation: i[N], index into ``messages.RELATIONS``.
        figure: f[N, 2], metres, map frame.
        landmark: f[N, 2], metres.
        viewer: f[N, 3], x, y, heading at the utterance, metres and radians.
        robot: f[N, 3], the robot's present pose; the viewer's by default.
        is_robot: bool[N], the landmark is the robot itself; False by default.

    Raises:
        ValueError: no pairs, shapes that do not agree, an unknown relation, numbers that are not
            finite.
    """
    index = np.atleast_1d(np.asarray(relation))
    num_pairs = len(index)
    if num_pairs == 0:
        raise ValueError("there are no pairs to fit relations to")
    if index.ndim > 1:
        raise ValueError(f"relation has shape {index.shape}, but must have ({num_pairs},)")
    fields = {
        "figure": np.asarray(figure, np.float32),
        "landmark": np.asarray(landmark, np.float32),
        "viewer": np.asarray(viewer, np.float32),
        "robot": np.asarray(viewer if robot is None else robot, np.float32),
        "is_robot": np.zeros(num_pairs, bool) if is_robot is None else np.asarray(is_robot, bool),
    }
    sizes = {"figure": (2,), "landmark": (2,), "viewer": (3,), "robot": (3,), "is_robot": ()}
    for name, values in fields.items():
        shape = (num_pairs, *sizes[name])
        if values.shape != shape:
            raise ValueError(f"{name} has shape {values.shape}, but {num_pairs} pairs need {shape}")
        if not np.isfinite(values).all():
            raise ValueError(f"{name} holds numbers that are not finite: leave those pairs out")
    if not np.isin(index, np.arange(len(RELATIONS))).all():
        raise ValueError(
            f"relation must be an index from 0 to {len(RELATIONS) - 1} ({', '.join(RELATIONS)})"
        )
    arrays = {name: jnp.asarray(values) for name, values in fields.items()}
    return RelationPairs(relation=jnp.asarray(index, jnp.int32), **arrays)


def _in_frame(pairs: RelationPairs, pose: Array) -> tuple[Array, Array, ReferenceFrame]:
    """Compute offsets and reference frames of the pairs for a pose f32[N, 3]."""
    x, y = jnp.where(pairs.is_robot[:, None], pose[:, :2], pairs.landmark).T
    extrinsic, intrinsic = viewer_frame(pose[:, 0], pose[:, 1], x, y), robot_frame(pose[:, 2])
    frame = jax.tree.map(lambda i, e: jnp.where(pairs.is_robot, i, e), intrinsic, extrinsic)
    return pairs.figure[:, 0] - x, pairs.figure[:, 1] - y, frame


def log_frame_densities(pairs: RelationPairs, *, params: RelationParams) -> Array:
    """Evaluate the log-density of every pair in every frame, f32[N, F] per square metre.

    Without the mixture weights of the frames. Limits: κ = 0 makes the viewer's frame and
    "undirected" the same; without motion since the utterance the robot's frame is the viewer's.
    """
    by_viewer = _in_frame(pairs, pairs.viewer)
    by_robot = _in_frame(pairs, pairs.robot)
    undirected = replace(params, concentration=jnp.zeros_like(params.concentration))
    directed, ring = (density_of(prepare(each), pairs.relation) for each in (params, undirected))
    components = ((directed, by_viewer), (directed, by_robot), (ring, by_viewer))
    return jnp.stack([log_density_of(pdf, *offset) for pdf, offset in components], axis=1)
