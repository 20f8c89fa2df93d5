"""Looking at all of an area: ways between patches, corners of cells."""

import jax.numpy as jnp
import numpy as np
import pytest
from test_planner_policy import believe, random_places
from test_planner_tours import AREA

from jaxlangnav.planner.latency import _between_patches
from jaxlangnav.planner.search import CELLS, search_map


def test_ways_between_patches_by_hand() -> None:
    """Blocks of two cells a side are 1.67 m wide; what lies no farther apart than 2.5 m is one."""

    def metres(*cells: tuple[int, int]) -> float:
        is_missed = np.zeros((1, CELLS, CELLS), bool)
        for row, column in cells:
            is_missed[0, row, column] = True
        return float(_between_patches(jnp.asarray(is_missed.reshape(1, -1)), AREA)[0])

    block = 10.0 / 6.0
    assert metres() == metres((0, 0)) == metres((0, 0), (0, 3)) == 0.0
    assert metres((0, 0), (0, 11)) == pytest.approx(5 * block - 1.5 * block, rel=1e-5)
    expected = (5 * block - 1.5 * block) + (np.hypot(5, 5) * block - 1.5 * block)
    assert metres((0, 0), (0, 11), (11, 0)) == pytest.approx(expected, rel=1e-5)


def test_a_cell_stands_for_what_of_it_has_been_looked_at_least() -> None:
    log_miss = np.full((24, 24), -3.0)
    log_miss[1, 0] = 0.0
    belief, part = believe(random_places(), is_hung=False, log_miss=log_miss), 10.0 / 24
    found = search_map(belief, jnp.float32(0.0), jnp.float32(0.0))
    np.testing.assert_allclose([found.x[0], found.y[0]], [0.5 * part, 1.5 * part - 5.0], atol=1e-5)
