"""Sweeps in lanes, and the way that is left between patches (ours).

Who goes where most is to be seen next leaves corners and strips behind, and to look at these in the
end is as far again. Where all of the area may have to be looked at, as what is spoken of may be
nowhere, a sweep in lanes is as good a way to find it and the shortest to know that it is not there.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import SensorParams
from jaxlangnav.planner.search import SearchMap

NUM_SWEEPS = 4
"""Sweeps drafted: in lanes along y and along x, from the nearest corner and from the next one."""
SIGHT_MARGIN = 0.5
"""Metres by which a thing must be inside the sensing range to count on seeing it: cells have width,
looks are a step apart, and a look may miss."""
_LANE_END = 0.5
"""How far at least from the edge of what is to be swept a lane ends, as a share of the range."""
_SPARE_LANE = 0.02
"""Share of a lane by which a side may exceed whole lanes: sides of areas are not exact."""


def eyesight(sensor: SensorParams) -> tuple[Array, Array]:
    """Tell how far one counts on seeing, and how far one sees abreast of the way.

    Args:
        sensor: how far and how wide one sees.

    Returns:
        f32[] metres each.
    """
    radius = jnp.maximum(sensor.range_max - SIGHT_MARGIN, 0.5 * sensor.range_max)
    half = jnp.minimum(0.5 * sensor.field_of_view, 0.5 * jnp.pi)
    return radius, sensor.range_max * jnp.sin(half)


def is_worth_a_look(mass: Array) -> Array:
    """Tell which cells are not as good as looked at.

    Args:
        mass: f32[C], probability that what is looked for lies in each cell.

    Returns:
        bool[C].
    """
    return mass > 0.1 * jnp.mean(mass)


def between_patches(is_missed: Array, area: Array) -> Array:
    """Measure the way between the patches that tours leave, from patch to patch in lanes.

    Limits: one patch, or none, has no gaps.

    Args:
        is_missed: bool[T, C].
        area: f32[4], operating area, metres.

    Returns:
        f32[T] metres, in lanes along x or along y, whichever is less.
    """
    side = int(np.sqrt(is_missed.shape[1])) // 2
    blocks = jnp.any(is_missed.reshape(-1, side, 2, side, 2), axis=(2, 4))  # [T, y, x]
    size = jnp.stack([area[1] - area[0], area[3] - area[2]]) / side
    row, column = np.divmod(np.arange(side * side), side)
    column = np.where(row % 2 == 0, column, side - 1 - column)

    def in_lanes(blocks: Array, step: Array, lane: Array) -> Array:
        is_left = blocks.reshape(-1, side * side)[:, row * side + column]
        own = jnp.where(is_left, np.arange(side * side)[None], -1)
        last = jnp.pad(jax.lax.cummax(own, axis=1), ((0, 0), (1, 0)), constant_values=-1)[:, :-1]
        x, y = step * column.astype(np.float32), lane * row.astype(np.float32)
        from_last = jnp.hypot(x[None] - x[last], y[None] - y[last])
        beyond = jnp.maximum(from_last - 1.5 * jnp.max(size), 0.0)
        return jnp.sum(jnp.where(is_left & (last >= 0), beyond, 0.0), axis=1)

    return jnp.minimum(in_lanes(blocks, *size), in_lanes(blocks.mT, *size[::-1]))


def sweeps(
    search: SearchMap, here: Array, sensor: SensorParams, area: Array, *, num_stops: int
) -> Array:
    """Draft sweeps of what has not been looked at, in lanes along y and along x.

    Lanes are as wide as one sees abreast, and end where what lies beyond is in sight. Of each kind
    one begins in the corner nearest the robot, one in the next corner across the lanes.

    Limits: where nothing is left to be looked at, it is the whole area that is swept.

    Args:
        search: where looking is worth while.
        here: f32[2], where the robot is, metres, map frame.
        sensor: how far and how wide one sees.
        area: f32[4], operating area, metres.
        num_stops: K.

    Returns:
        f32[NUM_SWEEPS, 2, K] metres, x and y of the first K stops of each.
    """
    counts = is_worth_a_look(search.mass)
    counts = (counts | ~jnp.any(counts))[None]
    half_cell = 0.5 * (area[1::2] - area[::2]) / np.sqrt(search.x.shape[0])
    places = jnp.stack([search.x, search.y])
    low = jnp.min(jnp.where(counts, places, jnp.inf), axis=1) - half_cell
    high = jnp.max(jnp.where(counts, places, -jnp.inf), axis=1) + half_cell
    stop = np.arange(num_stops)
    drafted = [
        _sweep(low, high, here, sensor, stop, across=across, is_far=is_far)
        for across in (0, 1)
        for is_far in (False, True)
    ]
    return jnp.clip(jnp.stack(drafted), area[::2][None, :, None], area[1::2][None, :, None])


def _sweep(
    low: Array,
    high: Array,
    here: Array,
    sensor: SensorParams,
    stop: np.ndarray,
    *,
    across: int,
    is_far: bool,
) -> Array:
    """Draft one sweep of a box, f32[2, K] metres: lanes lie side by side along axis ``across``."""
    radius, abreast = eyesight(sensor)
    side, along = high - low, 1 - across
    number = jnp.maximum(jnp.ceil(side[across] / (2.0 * abreast) - _SPARE_LANE), 1.0)
    half = 0.5 * side[across] / number
    least = _LANE_END * sensor.range_max
    end = jnp.sqrt(jnp.maximum(radius**2 - half**2, least**2))
    end = jnp.minimum(end, 0.5 * side[along])
    is_nearer_low = here - low <= high - here
    offset = (2.0 * jnp.minimum(stop // 2, number - 1.0) + 1.0) * half
    is_from_low = is_nearer_low[across] != is_far
    is_low = is_nearer_low[along] != (((stop + 1) // 2) % 2 == 1)
    beside = jnp.where(is_from_low, low[across] + offset, high[across] - offset)
    ends = jnp.where(is_low, low[along] + end, high[along] - end)
    return jnp.stack([beside, ends] if across == 0 else [ends, beside])
