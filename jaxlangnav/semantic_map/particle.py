"""The semantic map: topology, joint Gaussian over positions, weight (section 3.2, eq. 5c).

One particle is S = {G, X, w}. Its topology G is which objects exist, of what type, observed or
hypothesised, and which of them the words refer to; X is a joint Gaussian over the robot and all
objects in canonical form; w is its weight.

Slots 0 … O−1 hold observed objects, slots O … O+M−1 one hypothesis for each mention of the
instruction that has not been observed; N = O + M. The matrix Λ covers the observed objects and
the robot (index O). A hypothesised object hangs on its anchor by a single sampled constraint, so
its Gaussian follows from the anchor's and needs no row in Λ: taking a hypothesis back leaves no
trace. ``joint_gaussian`` assembles the full canonical form, hypotheses included.

Batches of particles carry the particle axis **last**; ``vmap`` with ``in_axes=-1``.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE
from jaxlangnav.pytree import pytree

START_PRECISION = 1e4
"""Information on the robot's first position, 1/m²: known to a centimetre."""


@pytree
class SemanticMap:
    """One particle. Positions in metres, map frame."""

    object_type: Array  # i32[O] type index; NONE in empty slots
    precision: Array  # f32[O + 1, O + 1] Λ, 1/m², both axes; robot last; identity in empty slots
    information_x: Array  # f32[O + 1] η of x, 1/m
    information_y: Array  # f32[O + 1] η of y, 1/m
    mean_x: Array  # f32[O + 1] metres, Λ⁻¹ η
    mean_y: Array  # f32[O + 1] metres
    reading: Array  # i32[] which of the K readings this particle believes
    referent: Array  # i32[M] observed slot each mention refers to; NONE while only hypothesised
    anchor: Array  # i32[M] slot in [0, N) that a hypothesis hangs on; NONE for the ground
    root: Array  # i32[M] observed slot at the end of that chain of anchors; NONE for the ground
    hypothesis_x: Array  # f32[M] metres, mean of the hypothesis
    hypothesis_y: Array  # f32[M]
    is_mentioned: Array  # bool[M] the particle's reading has this mention, and it is an object

    @property
    def is_observed(self) -> Array:
        """Which observed slots are filled, bool[O]."""
        return self.object_type != NONE

    @property
    def is_hypothesised(self) -> Array:
        """Which mentions exist only as hypotheses, bool[M]."""
        return self.is_mentioned & (self.referent == NONE)


def empty(num_objects: int, num_mentions: int, start_x: Array, start_y: Array) -> SemanticMap:
    """Build the map of a robot that has seen and heard nothing.

    Args:
        num_objects: O, capacity for observed objects.
        num_mentions: M, capacity for mentions.
        start_x: f32[], metres, map frame.
        start_y: f32[], metres.

    Returns:
        One particle.
    """
    size = num_objects + 1
    diagonal = jnp.ones(size, jnp.float32).at[num_objects].set(START_PRECISION)
    robot = jnp.zeros(size, jnp.float32).at[num_objects].set(1.0)
    return SemanticMap(
        object_type=jnp.full(num_objects, NONE, jnp.int32),
        precision=jnp.diag(diagonal),
        information_x=robot * start_x * START_PRECISION,
        information_y=robot * start_y * START_PRECISION,
        mean_x=robot * start_x,
        mean_y=robot * start_y,
        reading=jnp.int32(0),
        referent=jnp.full(num_mentions, NONE, jnp.int32),
        anchor=jnp.full(num_mentions, NONE, jnp.int32),
        root=jnp.full(num_mentions, NONE, jnp.int32),
        hypothesis_x=jnp.zeros(num_mentions, jnp.float32),
        hypothesis_y=jnp.zeros(num_mentions, jnp.float32),
        is_mentioned=jnp.zeros(num_mentions, bool),
    )


def positions(particle: SemanticMap) -> tuple[Array, Array]:
    """Gather the mean position of every slot.

    Args:
        particle: one particle.

    Returns:
        x and y, f32[N] each, metres, map frame: observed slots first, then hypotheses. Zero
        where a slot is empty.
    """
    num_objects = particle.object_type.shape[0]
    return (
        jnp.concatenate([particle.mean_x[:num_objects], particle.hypothesis_x]),
        jnp.concatenate([particle.mean_y[:num_objects], particle.hypothesis_y]),
    )


def joint_gaussian(particle: SemanticMap, kernel_variance: Array) -> tuple[Array, Array, Array]:
    """Assemble the whole joint Gaussian in canonical form, hypotheses included (eq. 5c).

    Each hypothesis adds one factor of precision 1/κ² to its anchor (or to the ground), which is
    why it can be retracted exactly. The robot comes last; empty slots have an identity diagonal.

    Args:
        particle: one particle.
        kernel_variance: f32[], κ², square metres per axis, of a sampled constraint.

    Returns:
        Λ f32[N + 1, N + 1], and the mean f32[N + 1] of x and of y.
    """
    num_objects, num_mentions = particle.object_type.shape[0], particle.referent.shape[0]
    num_slots = num_objects + num_mentions
    order = jnp.append(jnp.arange(num_objects), num_slots)
    precision = jnp.eye(num_slots + 1, dtype=jnp.float32)
    precision = precision.at[order[:, None], order[None, :]].set(particle.precision)
    for mention in range(num_mentions):
        is_in = particle.is_hypothesised[mention]
        anchor = particle.anchor[mention]
        unit = jnp.arange(num_slots + 1) == num_objects + mention
        hook = (jnp.arange(num_slots + 1) == anchor) & (anchor != NONE)
        edge = unit.astype(jnp.float32) - hook.astype(jnp.float32)
        factor = edge[:, None] * edge[None, :] / kernel_variance
        # The slot's own identity entry made room for an empty slot; the factor replaces it.
        factor = factor - jnp.outer(unit, unit)
        precision = precision + jnp.where(is_in, factor, 0.0)
    x, y = positions(particle)
    return (
        precision,
        jnp.append(x, particle.mean_x[num_objects]),
        jnp.append(y, particle.mean_y[num_objects]),
    )
