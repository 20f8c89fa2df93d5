"""The semantic map: topology, joint Gaussian over positions, weight (section 3.2, eq. 5c).

One particle is S = {G, X, w}. Its topology G has the objects with their types, observed or
hypothesised, and the referents of the mentions; X is a joint Gaussian over the robot and all
objects, with mean and covariance Σ (``numerics.gaussian``); w is its weight.

Slots 0 … O−1 hold observed objects, slots O … O+M−1 one hypothesis for each mention of the
instruction that has not been observed; N = O + M. The matrix Σ covers the observed objects and
the robot (index O). A hypothesised object is tied to its anchor by a single sampled constraint, so
its Gaussian follows from the anchor's and needs no row in Σ: a removed hypothesis leaves no trace.

Batches of particles carry the particle axis **last**; ``vmap`` with ``in_axes=-1``.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE
from jaxlangnav.numerics.batching import append_axes
from jaxlangnav.pytree import pytree, replace

START_VARIANCE = 1e-4
"""Variance of the robot's initial position, square metres per axis: one centimetre."""


@pytree
class SemanticMap:
    """One particle. Positions in metres, map frame."""

    object_type: Array  # i32[O] type code (``object_types``); NONE in empty slots
    covariance: Array  # f32[O + 1, O + 1] Σ, m², both axes; robot last; zero in empty slots
    mean_x: Array  # f32[O + 1] metres; robot last; zero in empty slots
    mean_y: Array  # f32[O + 1] metres
    reading: Array  # i32[] index of the particle's interpretation, of K
    referent: Array  # i32[M] observed slot of each mention; NONE while only hypothesised
    anchor: Array  # i32[M] slot in [0, N) that a hypothesis is tied to; NONE: the map frame
    root: Array  # i32[M] observed slot at the end of that chain of anchors; NONE: the map frame
    hypothesis_x: Array  # f32[M] metres, mean of the hypothesis
    hypothesis_y: Array  # f32[M]
    is_mentioned: Array  # bool[M] the interpretation has this mention, and it is an object
    existence: Array  # f32[O] existence probability, apart from the utterance; f32[0]: all exist
    drift: Array  # f32[2] heading error of odometry, radians, and sign of its constant bias, 0 if
    # there is none; f32[0]: a compass gives the heading

    @property
    def is_observed(self) -> Array:
        """Which observed slots are filled, bool[O]."""
        return self.object_type != NONE

    @property
    def is_referent(self) -> Array:
        """Which observed slots are referents of mentions, bool[O, ...]."""
        slots = append_axes(jnp.arange(self.object_type.shape[0]), self.referent.ndim + 1)
        return jnp.any(jnp.where(self.is_mentioned, self.referent, NONE)[None] == slots, axis=1)

    @property
    def is_hypothesised(self) -> Array:
        """Which mentions exist only as hypotheses, bool[M]."""
        return self.is_mentioned & (self.referent == NONE)


def empty(
    num_objects: int,
    num_mentions: int,
    start_x: Array,
    start_y: Array,
    *,
    has_doubts: bool = False,
    has_drift: bool = False,
) -> SemanticMap:
    """Build an empty particle with capacity for O objects and M mentions.

    Objects have existence probabilities if it ``has_doubts``; the heading drifts if ``has_drift``.
    """
    robot = jnp.zeros(num_objects + 1, jnp.float32).at[num_objects].set(1.0)
    none, zero = jnp.full(num_mentions, NONE, jnp.int32), jnp.zeros(num_mentions, jnp.float32)
    return SemanticMap(
        object_type=jnp.full(num_objects, NONE, jnp.int32),
        covariance=jnp.diag(robot * START_VARIANCE),
        mean_x=robot * start_x,
        mean_y=robot * start_y,
        reading=jnp.int32(0),
        referent=none,
        anchor=none,
        root=none,
        hypothesis_x=zero,
        hypothesis_y=zero,
        is_mentioned=jnp.zeros(num_mentions, bool),
        existence=jnp.zeros(num_objects if has_doubts else 0, jnp.float32),
        drift=jnp.zeros(2 if has_drift else 0, jnp.float32),
    )


def clear(particle: SemanticMap, mask: Array) -> SemanticMap:
    """Clear observed slots, bool[O, ...]; mentions of them have to be re-grounded."""
    row = jnp.concatenate([mask, jnp.zeros_like(mask[:1])])
    has_doubts = particle.existence.shape[0] > 0
    return replace(
        particle,
        object_type=jnp.where(mask, NONE, particle.object_type),
        covariance=jnp.where(row[:, None] | row[None], 0.0, particle.covariance),
        mean_x=jnp.where(row, 0.0, particle.mean_x),
        mean_y=jnp.where(row, 0.0, particle.mean_y),
        existence=jnp.where(mask, 0.0, particle.existence) if has_doubts else particle.existence,
    )
