"""Coverage map: log miss probability by cell (section 3.2, negative information).

The operating area is divided into G × G cells. Each has the log-probability that an object in it
would have been missed by all observations so far. It is never certain: with a detection probability
below one, a cell observed three times may still contain an unseen object.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import SensorParams
from jaxlangnav.numerics.batching import prepend_axes
from jaxlangnav.pytree import pytree
from jaxlangnav.terrain import RANGING, Eye, SensorModel, View

LOG_MISS_FLOOR = -30.0
_GOLDEN = 0.6180339887


@pytree
class Coverage:
    """Log-probability of having missed an object, by cell of the operating area."""

    log_miss: Array  # f32[G, G] indexed [y cell, x cell]; 0 where never observed
    area: Array  # f32[4] x_min, x_max, y_min, y_max, metres, map frame


def empty_coverage(area: Array, num_cells: int) -> Coverage:
    """Build the coverage map of an unobserved area f32[4], in G × G cells."""
    return Coverage(log_miss=jnp.zeros((num_cells, num_cells), jnp.float32), area=area)


def cell_size(coverage: Coverage) -> tuple[Array, Array]:
    """Compute the size of a cell, f32[] metres in x and in y."""
    size_x, size_y = _sides(coverage) / coverage.log_miss.shape[-1]
    return size_x, size_y


def _sides(coverage: Coverage) -> Array:
    """Compute the side lengths of the operating area in x and y, f32[2, ...] metres."""
    return coverage.area[1::2] - coverage.area[::2]


def cell_centres(coverage: Coverage) -> tuple[Array, Array]:
    """Compute the centres of the cells: f32[G] x and f32[G] y, metres, map frame."""
    size_x, size_y = cell_size(coverage)
    steps = jnp.arange(coverage.log_miss.shape[-1]) + 0.5
    return coverage.area[0] + steps * size_x, coverage.area[2] + steps * size_y


def area_size(coverage: Coverage) -> Array:
    """Compute the size of the operating area, f32[] square metres."""
    side_x, side_y = _sides(coverage)
    return side_x * side_y


def add_view(
    coverage: Coverage, eye: Eye, sensor: SensorParams, view: View, model: SensorModel = RANGING
) -> Coverage:
    """Add one observation: the log-probability of no detection is added to every cell."""
    centre_x, centre_y = cell_centres(coverage)
    size_x, size_y = cell_size(coverage)
    softness = 0.5 * (size_x + size_y)
    cells = centre_x[None, :], centre_y[:, None]
    probability = model.report_probability(view, eye, *cells, softness, sensor)
    log_miss = coverage.log_miss + jnp.log1p(-probability)
    return Coverage(log_miss=jnp.maximum(log_miss, LOG_MISS_FLOOR), area=coverage.area)


def log_miss_at(coverage: Coverage, x: Array, y: Array, first_row: Array | int = 0) -> Array:
    """Look up the log miss probability of an object at (x, y), f32[...].

    It is −∞ outside the operating area, where no object is. Of coverage maps stacked by rows,
    f32[n G, G], the one that begins at ``first_row`` is used, and areas are f32[4, ...].
    """
    num_cells = coverage.log_miss.shape[-1]
    size_x, size_y = (prepend_axes(size, x.ndim) for size in cell_size(coverage))
    column = jnp.floor((x - prepend_axes(coverage.area[0], x.ndim)) / size_x).astype(jnp.int32)
    row = jnp.floor((y - prepend_axes(coverage.area[2], y.ndim)) / size_y).astype(jnp.int32)
    is_in = (column >= 0) & (column < num_cells) & (row >= 0) & (row < num_cells)
    row = prepend_axes(jnp.asarray(first_row), row.ndim) + jnp.clip(row, 0, num_cells - 1)
    flat = row * num_cells + jnp.clip(column, 0, num_cells - 1)
    return jnp.where(is_in, coverage.log_miss.reshape(-1)[flat], -jnp.inf)


def sample_unseen(coverage: Coverage, uniform: Array, jitter: Array) -> tuple[Array, Array, Array]:
    """Sample positions in proportion to the miss probability, by systematic sampling.

    ``uniform``, f32[], is the offset of the grid; ``jitter``, f32[2, n], spreads the points over
    their cells. x and y, f32[n] metres, map frame; a point at a random index has the density
    itself; and f32[], the log of the unseen fraction of the area u.
    """
    num_cells, num_points = coverage.log_miss.shape[-1], jitter.shape[-1]
    size_x, size_y = cell_size(coverage)
    # Every row starts at another column: with even spacing and rows of equal weight all points
    # would lie in the same few columns.
    shift = (_GOLDEN * np.arange(num_cells) * num_cells).astype(int)
    order = (np.arange(num_cells)[None, :] + shift[:, None]) % num_cells
    weight = jnp.exp(coverage.log_miss)[np.arange(num_cells)[:, None], order]
    rows = jnp.cumsum(jnp.sum(weight, axis=1))
    total = rows[-1]
    levels = (jnp.arange(num_points) + uniform) / num_points * total
    row = jnp.minimum(jnp.sum(rows[:, None] <= levels[None, :], axis=0), num_cells - 1)
    row_start = jnp.where(row > 0, rows[jnp.maximum(row - 1, 0)], 0.0)
    columns = jnp.cumsum(weight, axis=1)
    column = jnp.sum(columns[row] <= (levels - row_start)[:, None], axis=1)
    column = jnp.minimum(column, num_cells - 1)
    column = (column + jnp.asarray(shift)[row]) % num_cells
    x = coverage.area[0] + (column + jitter[0]) * size_x
    y = coverage.area[2] + (row + jitter[1]) * size_y
    return x, y, jnp.log(total) - jnp.log(jnp.float32(num_cells * num_cells))
