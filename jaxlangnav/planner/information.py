"""What a waypoint would tell: hypotheses that come into view on the way to it.

The paper leaves exploration to chance and names information gathering as future work (section 5).
Here a waypoint is worth the probability of the particles whose hypothesised objects (figure or
landmark) would come into view along the segment to it, per metre walked.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.semantic_map.filter import ParticleBelief


def squared_distance_to_segment(
    x: Array, y: Array, from_x: Array, from_y: Array, to_x: Array, to_y: Array
) -> Array:
    """Compute squared distances of points to segments.

    Limits: a segment of no length is a point.

    Args:
        x: f32[...], points, metres.
        y: f32[...].
        from_x: f32[...], segment ends, broadcastable to the points.
        from_y: f32[...].
        to_x: f32[...].
        to_y: f32[...].

    Returns:
        f32[...], square metres.
    """
    span_x, span_y = to_x - from_x, to_y - from_y
    length = span_x * span_x + span_y * span_y + 1e-9
    along = jnp.clip(((x - from_x) * span_x + (y - from_y) * span_y) / length, 0.0, 1.0)
    return (x - from_x - along * span_x) ** 2 + (y - from_y - along * span_y) ** 2


def mass_revealed(
    belief: ParticleBelief,
    robot_x: Array,
    robot_y: Array,
    node_x: Array,
    node_y: Array,
    range_max: Array,
) -> Array:
    """Compute the probability of the particles that the way to each node would put to the test.

    Args:
        belief: weighted particles.
        robot_x: f32[], metres, map frame.
        robot_y: f32[], metres.
        node_x: f32[A], metres.
        node_y: f32[A], metres.
        range_max: f32[], sensing range, metres.

    Returns:
        f32[A] in [0, 1].
    """
    particles, weight = belief.particles, jnp.exp(belief.log_weight)
    reach = 0.95 * range_max
    is_seen = jnp.zeros((node_x.shape[0], weight.shape[0]), bool)
    for mention in range(particles.referent.shape[0]):
        squared = squared_distance_to_segment(
            particles.hypothesis_x[mention][None, :],
            particles.hypothesis_y[mention][None, :],
            robot_x,
            robot_y,
            node_x[:, None],
            node_y[:, None],
        )
        is_open = particles.is_hypothesised[mention][None, :]
        is_seen = is_seen | (is_open & (squared <= reach * reach))
    return jnp.sum(jnp.where(is_seen, weight[None, :], 0.0), axis=1)
