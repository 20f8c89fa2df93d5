"""Candidate waypoints by hand: frontiers, visited places (eq. 9)."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.planner.graph import frontiers, nowhere, unexplored_cells, visit
from jaxlangnav.semantic_map.coverage import Coverage, cell_centres

AREA = jnp.array([0.0, 8.0, -4.0, 4.0])
CELLS, BLOCKS = 16, 4
FRONTIERS = jax.jit(frontiers, static_argnames="num_blocks")


def coverage(log_miss: np.ndarray) -> Coverage:
    return Coverage(log_miss=jnp.asarray(log_miss, jnp.float32), area=AREA)


def test_nothing_explored_has_no_frontier() -> None:
    _, _, is_frontier = FRONTIERS(coverage(np.zeros((CELLS, CELLS))), BLOCKS, 0.5)
    assert not is_frontier.any()


def test_frontier_lies_beside_what_was_seen() -> None:
    """The left half seen: the frontier is the first unexplored column, in every block row."""
    log_miss = np.zeros((CELLS, CELLS))
    log_miss[:, :8] = -3.0
    x, y, is_frontier = FRONTIERS(coverage(log_miss), BLOCKS, 0.5)
    found = np.asarray(is_frontier).reshape(BLOCKS, BLOCKS)
    assert found.tolist() == [[False, False, True, False]] * 4
    # Column 8 has its centre at 4.25 m; the four rows of a block average to the block's middle.
    np.testing.assert_allclose(np.asarray(x)[found.reshape(-1)], 4.25)
    np.testing.assert_allclose(np.asarray(y)[found.reshape(-1)], [-3.0, -1.0, 1.0, 3.0])


def test_everything_seen_once_leaves_what_was_seen_least() -> None:
    """Unexplored is relative: nothing is written off for good."""
    log_miss = np.full((CELLS, CELLS), -6.0)
    log_miss[4:8, 4:8] = -3.0
    cells = np.asarray(unexplored_cells(coverage(log_miss), jnp.float32(0.5)))
    assert cells[4:8, 4:8].all()
    assert cells.sum() == 16
    _, _, is_frontier = FRONTIERS(coverage(log_miss), BLOCKS, 0.5)
    assert np.asarray(is_frontier).reshape(BLOCKS, BLOCKS)[1, 1]
    assert is_frontier.sum() == 1


def test_every_frontier_node_is_a_mean_of_frontier_cells() -> None:
    """Against a plain loop over cells, on random coverage."""
    log_miss = np.where(np.random.default_rng(0).uniform(size=(CELLS, CELLS)) < 0.5, -3.0, 0.0)
    x, y, is_frontier = FRONTIERS(coverage(log_miss), BLOCKS, 0.5)
    centre_x, centre_y = (np.asarray(axis) for axis in cell_centres(coverage(log_miss)))
    places: dict[int, list] = {}
    for row in range(CELLS):
        for column in range(CELLS):
            beside = [(row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)]
            inside = [one for one in beside if min(one) >= 0 and max(one) < CELLS]
            if log_miss[row, column] == 0.0 and any(log_miss[one] < 0.0 for one in inside):
                block = (row // 4) * BLOCKS + column // 4
                places.setdefault(block, []).append((centre_x[column], centre_y[row]))
    for block in range(BLOCKS**2):
        assert bool(is_frontier[block]) == (block in places)
        if block in places:
            np.testing.assert_allclose([x[block], y[block]], np.mean(places[block], 0), rtol=1e-5)


def test_visited_places_are_kept_apart_and_the_oldest_goes() -> None:
    step, visited = jax.jit(visit), nowhere(3)
    for x in (0.0, 0.5, 1.2, 1.3, 2.4):
        visited = step(visited, jnp.float32(x), jnp.float32(0.0), jnp.float32(1.0))
    np.testing.assert_allclose(visited.x, [0.0, 1.2, 2.4])
    assert visited.is_node.all()
    assert int(visited.count) == 3
    visited = step(visited, jnp.float32(9.0), jnp.float32(0.0), jnp.float32(1.0))
    np.testing.assert_allclose(visited.x, [9.0, 1.2, 2.4])
