"""Ways to sweep an area with a sensor that sees a given range all round (baselines of section 4.2).

A pattern gives one waypoint after the other, for ever, from the area, the range and the number of
waypoints reached so far. Each says what it has to know.
"""

from collections.abc import Callable

import jax.numpy as jnp
from jax import Array

NextPlace = Callable[[Array, Array, Array], tuple[Array, Array]]
"""From area, range and waypoints reached to the next waypoint."""
_LANE_MARGINS = (1.0, 0.3)
"""How far from the edge a lane ends, as a share of the range: on the first pass and later on. The
first pass turns as early as it can and leaves corners out of view; later ones look there."""
_ARC_POINTS = 8
_ARC_RADII = (0.0, 1.6, -1.6)
"""Of the passes: metres from the likeliest range, in sensing ranges."""
_ARC_DEPTH, _ARC_MARGIN = 0.66, 0.8
"""Likeliest range as a share of the area's depth; how much of its range it stays from the edge."""


def lane_waypoint(area: Array, range_max: Array, leg: Array) -> tuple[Array, Array]:
    """Compute a waypoint of the sweep of an area; after the last it begins anew.

    Args:
        area: f32[4], x_min, x_max, y_min, y_max, metres.
        range_max: f32[], sensing range, metres.
        leg: i32[], waypoints reached so far.

    Returns:
        x and y, f32[] metres.
    """
    depth, width = area[1] - area[0], area[3] - area[2]
    num_lanes = jnp.ceil(depth / (2.0 * range_max)).astype(jnp.int32)
    num_lanes = jnp.maximum(num_lanes, 1)
    at = leg % (2 * num_lanes)
    lane = at // 2
    is_far = ((at + 1) // 2) % 2 == 1  # near, far, far, near, near, far, ...
    share = jnp.where(leg < 2 * num_lanes, _LANE_MARGINS[0], _LANE_MARGINS[1])
    margin = jnp.minimum(share * range_max, 0.5 * width)
    x = area[0] + (lane.astype(jnp.float32) + 0.5) * depth / num_lanes.astype(jnp.float32)
    y = jnp.where(is_far, area[3] - margin, area[2] + margin)
    return x, y


def arc_waypoint(area: Array, range_max: Array, leg: Array) -> tuple[Array, Array]:
    """Compute a waypoint of the sweep by the worlds' law; after three arcs it goes on in lanes.

    Args:
        area: f32[4], x_min, x_max, y_min, y_max, metres; the start is in the middle of x_min.
        range_max: f32[], sensing range, metres.
        leg: i32[], waypoints reached so far.

    Returns:
        x and y, f32[] metres.
    """
    depth = area[1] - area[0]
    sweep, point = leg // _ARC_POINTS, leg % _ARC_POINTS
    offset = jnp.asarray(_ARC_RADII)[jnp.minimum(sweep, len(_ARC_RADII) - 1)]
    radius = jnp.clip(_ARC_DEPTH * depth + offset * range_max, 0.2 * depth, 0.95 * depth)
    reach = jnp.clip(
        jnp.pi / 4 - jnp.arcsin(jnp.minimum(_ARC_MARGIN * range_max / radius, 0.99)), 0
    )
    share = point.astype(jnp.float32) / (_ARC_POINTS - 1)
    angle = reach * (2.0 * share - 1.0) * jnp.where(sweep % 2 == 0, 1.0, -1.0)
    lane_x, lane_y = lane_waypoint(area, range_max, leg - _ARC_POINTS * len(_ARC_RADII))
    is_arc = sweep < len(_ARC_RADII)
    x = area[0] + radius * jnp.cos(angle)
    y = 0.5 * (area[2] + area[3]) + radius * jnp.sin(angle)
    return jnp.where(is_arc, x, lane_x), jnp.where(is_arc, y, lane_y)
