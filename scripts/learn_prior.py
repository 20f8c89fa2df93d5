"""Estimate the spatial prior for search: the tables of ``planner.prior``.

    python scripts/learn_prior.py

Training worlds have seed 2000, the first 1,000 of each row of Table 2; results tables use other
seeds. The histograms are by range and bearing from the start: over goals, of rows that mention no
landmark; over goals and landmarks, of the others.
"""

import numpy as np

from jaxlangnav.experiments.rows import TABLE2_ROWS
from jaxlangnav.experiments.tasks import make_tasks
from jaxlangnav.inputs.atomic_files import replacing
from jaxlangnav.planner.prior import BEARING_BINS, BEARING_MAX, RANGE_BINS, RANGE_MAX, TABLE_FILE
from jaxlangnav.world.state import CONE, Scenario

SEED, WORLDS = 2000, 1000
"""Of the training worlds, so many of each row."""
_SMOOTH = (0.25, 0.5, 0.25)
_SAMPLES = 400
"""Grid points per side for the area fraction of each bin."""


def _histogram(x: np.ndarray, y: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Compute the histogram of positions by range and bearing, f64[RANGE_BINS, BEARING_BINS]."""
    count, _, _ = np.histogram2d(
        np.hypot(x, y) / depth,
        np.abs(np.arctan2(y, x)),
        bins=(RANGE_BINS, BEARING_BINS),
        range=((0.0, RANGE_MAX), (0.0, BEARING_MAX)),
    )
    return count


def _smooth(table: np.ndarray) -> np.ndarray:
    """Convolve with a short kernel along both axes, with edge padding."""
    for axis in (0, 1):
        widths = [(1, 1) if axis == other else (0, 0) for other in (0, 1)]
        parts = np.lib.stride_tricks.sliding_window_view(
            np.pad(table, widths, mode="edge"), 3, axis
        )
        table = parts @ np.array(_SMOOTH)
    return table


def learn(rows: list[Scenario]) -> np.ndarray:
    """Estimate the density of mentioned objects relative to a uniform one over the operating area.

    Args:
        rows: ``training_worlds``; the start is the origin and faces +x, as in all drawn worlds.

    Returns:
        f32[2, RANGE_BINS, BEARING_BINS], of rows without and with a landmark; they count alike.
    """
    total = np.zeros((2, RANGE_BINS, BEARING_BINS))
    for spec, scenario in zip(TABLE2_ROWS, rows, strict=True):
        place = np.stack([scenario.object_x, scenario.object_y], axis=2)
        cone = np.argmax(np.asarray(scenario.object_type) == CONE, axis=1)  # first: the landmark
        mentioned = np.asarray(scenario.goal), place[np.arange(len(cone)), cone]
        number = 1 if spec.relation == "null" else 2
        for x, y in (at.T for at in mentioned[:number]):
            total[number - 1] += _histogram(x, y, np.asarray(scenario.area)[:, 1])
    total /= total.sum(axis=(1, 2), keepdims=True)
    # Mass of the uniform density in each bin, on a fine grid; all areas have the same shape.
    _, far, low, high = np.asarray(rows[0].area)[0]
    grid = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    x, y = np.meshgrid(far * grid, low + (high - low) * grid)
    uniform = _smooth(_histogram(x.ravel(), y.ravel(), np.full(x.size, far)) / x.size)
    return np.stack([_smooth(table) / np.maximum(uniform, 1e-4) for table in total], dtype="f4")


def training_worlds(worlds: int = WORLDS) -> list[Scenario]:
    """Sample the training worlds, leaves [E, …] for each row of Table 2."""
    return [make_tasks(row.setting(seed=SEED), worlds).scenario for row in TABLE2_ROWS]


if __name__ == "__main__":
    with replacing(TABLE_FILE) as temporary:
        np.save(temporary, learn(training_worlds()))
