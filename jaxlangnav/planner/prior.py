"""Spatial prior over positions of mentioned objects, learned from training worlds.

Two tables, learned by ``scripts/learn_prior.py`` from worlds whose seeds are in no results table,
have the relative density of an object at a range and bearing from the robot's pose at the
utterance: of goals, where no landmark is mentioned, and of goals and landmarks.
Only the order of search depends on it; ``PlannerParams.prior_share`` = 0 disables it. The prior
``PlannerParams.ahead``, which is not learned, is a von Mises density of the bearing b from the
heading, exp κ cos b.
"""

import functools
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.inputs.arrays import parse_floats
from jaxlangnav.inputs.atomic_files import read_file
from jaxlangnav.semantic_map.coverage import Coverage

RANGE_MAX = 1.25
"""Range at the outer edge of the table, as a fraction of the depth of the area ahead."""
BEARING_MAX = np.pi / 2.0
"""Bearing to either side at its other edge, radians."""
RANGE_BINS, BEARING_BINS = 15, 9
TABLE_FILE = Path(__file__).parent / "data" / "prior.npy"
_MAX_BYTES = 1 << 20


@functools.cache
def load_table() -> np.ndarray:
    """Read the learned tables, f32[2, RANGE_BINS, BEARING_BINS], densities relative to uniform.

    Raises a ValueError if the file has no finite, non-negative tables.
    """
    try:
        density = parse_floats(read_file(TABLE_FILE, max_bytes=_MAX_BYTES))
        if density.shape != (2, RANGE_BINS, BEARING_BINS) or (density < 0.0).any():
            raise ValueError(f"shape {density.shape}, or a negative density")
    except (OSError, ValueError) as error:
        raise ValueError(f"{TABLE_FILE}: not a table of densities ({error})") from error
    return density


def relative_density(
    coverage: Coverage, viewer: Array, x: Array, y: Array, weight: Array, ahead: Array, pair: Array
) -> Array:
    """Look up the prior density of an object at each position, relative to uniform.

        (w · learned + 1 − w) · exp κ (cos b − 1)

    Limits: 1 everywhere for w and κ of 0; 1 − w straight ahead where no training world had one.

    Args:
        coverage: for the operating area.
        viewer: f32[3], x, y, heading when the instruction was heard, map frame.
        x: f32[C], metres, map frame.
        y: f32[C], metres.
        weight: f32[] in [0, 1], w, weight of the tables; the rest is uniform.
        ahead: f32[], κ ≥ 0, concentration of bearings b about the viewer's heading.
        pair: f32[] in [0, 1], probability that a landmark is sought, too.
    """
    alone, beside = jnp.asarray(load_table())
    learned = (1.0 - pair) * alone + pair * beside
    offset_x, offset_y = x - viewer[0], y - viewer[1]
    cos, sin = jnp.cos(viewer[2]), jnp.sin(viewer[2])
    left, forward = (offset_y * cos - offset_x * sin, offset_x * cos + offset_y * sin)
    bearing = jnp.abs(jnp.arctan2(left, forward))
    distance = jnp.sqrt(offset_x * offset_x + offset_y * offset_y + 1e-9)
    # Depth of the area ahead: that of its farthest corner, at least a centimetre.
    corner_x = coverage.area[jnp.array([0, 0, 1, 1])] - viewer[0]
    corner_y = coverage.area[jnp.array([2, 3, 2, 3])] - viewer[1]
    depth = jnp.maximum(jnp.max(corner_x * cos + corner_y * sin), 0.01)
    rows, columns = learned.shape
    row = jnp.floor(distance / depth / RANGE_MAX * rows)
    column = jnp.floor(bearing / BEARING_MAX * columns)
    is_inside = (row < rows) & (column < columns)
    flat = jnp.where(is_inside, row * columns + column, 0.0).astype(jnp.int32)
    value = jnp.where(is_inside, learned.reshape(-1)[flat], 0.0)
    return (weight * value + (1.0 - weight)) * jnp.exp(ahead * (jnp.cos(bearing) - 1.0))
