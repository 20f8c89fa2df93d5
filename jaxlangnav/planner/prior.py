"""Where the things that people speak of tend to stand: learned from training worlds.

A table, learned by ``scripts/learn_prior.py`` from worlds whose seeds are in no results table, says
how much likelier than elsewhere a thing is found at a range and bearing from where the robot was
told. Only the order of search hangs on it; ``PlannerParams.prior_share`` = 0 takes it out. By
``PlannerParams.ahead``, of which nothing is learned, a place at a bearing b of the heading counts
as a von Mises law has it, exp κ cos b.
"""

import functools
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.inputs.arrays import parse_floats
from jaxlangnav.inputs.whole_files import read_file
from jaxlangnav.semantic_map.coverage import Coverage

RANGE_MAX = 1.25
"""Range at the outer edge of the table, as a share of how far the area reaches ahead."""
BEARING_MAX = np.pi / 2.0
"""Bearing to either side at its other edge, radians."""
RANGE_BINS, BEARING_BINS = 15, 9
TABLE_FILE = Path(__file__).parent / "data" / "prior.npy"
_MAX_BYTES = 1 << 20


@functools.cache
def table() -> np.ndarray:
    """Read the learned table, f32[RANGE_BINS, BEARING_BINS], density relative to uniform.

    A ValueError where the file holds no finite table without negative numbers.
    """
    try:
        found = parse_floats(read_file(TABLE_FILE, at_most=_MAX_BYTES))
        if found.shape != (RANGE_BINS, BEARING_BINS) or (found < 0.0).any():
            raise ValueError(f"shape {found.shape}, or a negative density")
    except (OSError, ValueError) as error:
        raise ValueError(f"{TABLE_FILE}: not a table of densities ({error})") from error
    return found


def relative_density(
    coverage: Coverage, viewer: Array, x: Array, y: Array, share: Array, ahead: Array
) -> Array:
    """Look up how much likelier than elsewhere a thing stands at each place.

        (share · learned + 1 − share) · exp κ (cos b − 1)

    Limits: 1 everywhere for a share and κ of 0; 1 − share straight ahead where no training world
    had anything.

    Args:
        coverage: for the operating area.
        viewer: f32[3], x, y, heading when the instruction was heard, map frame.
        x: f32[C], metres, map frame.
        y: f32[C], metres.
        share: f32[] in [0, 1], how far the table is trusted; the rest is uniform.
        ahead: f32[], κ ≥ 0, concentration of bearings b about the viewer's heading.
    """
    learned = jnp.asarray(table())
    offset_x, offset_y = x - viewer[0], y - viewer[1]
    ahead_x, ahead_y = jnp.cos(viewer[2]), jnp.sin(viewer[2])
    left, onward = offset_y * ahead_x - offset_x * ahead_y, offset_x * ahead_x + offset_y * ahead_y
    bearing = jnp.abs(jnp.arctan2(left, onward))
    away = jnp.sqrt(offset_x * offset_x + offset_y * offset_y + 1e-9)
    # The area reaches as far ahead as its farthest corner, and at least a centimetre.
    corner_x = coverage.area[jnp.array([0, 0, 1, 1])] - viewer[0]
    corner_y = coverage.area[jnp.array([2, 3, 2, 3])] - viewer[1]
    depth = jnp.maximum(jnp.max(corner_x * ahead_x + corner_y * ahead_y), 0.01)
    rows, columns = learned.shape
    row = jnp.floor(away / depth / RANGE_MAX * rows)
    column = jnp.floor(bearing / BEARING_MAX * columns)
    is_in = (row < rows) & (column < columns)
    flat = jnp.where(is_in, row * columns + column, 0.0).astype(jnp.int32)
    value = jnp.where(is_in, learned.reshape(-1)[flat], 0.0)
    return (share * value + (1.0 - share)) * jnp.exp(ahead * (jnp.cos(bearing) - 1.0))
