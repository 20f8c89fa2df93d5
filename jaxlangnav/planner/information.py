"""How far things lie from the way to a waypoint: what comes into view, what is passed too near."""

import jax.numpy as jnp
from jax import Array


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
