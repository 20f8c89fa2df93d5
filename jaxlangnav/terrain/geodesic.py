"""Ways among walls: shortest paths on a grid, worked out once for a place.

Cells are joined to their eight neighbours unless a wall stands between their centres. What walls
make a way longer by is the difference of two lengths on this grid, with walls and without:

    metres(p, q) = |p − q| + grid(p, q) − octile(p, q)

so where nothing is in the way it is the straight line to the bit, and the grid's own error, up to
8 % of a path that turns, enters only by what the detour adds.
"""

import functools

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.pytree import pytree
from jaxlangnav.terrain.travel import StraightLines
from jaxlangnav.terrain.view import NEVER, Eye, Stretch, View
from jaxlangnav.terrain.walls import Walls

NUM_CELLS = 16
"""Cells a side by default: gaps narrower than a cell may be missed."""
_STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
"""Rows and columns to the eight neighbours."""
_DETOUR = 0.01
"""Metres by which a way is longer than the line before it counts as none."""


@pytree
class Geodesic:
    """Shortest ways among walls; C = cells a side squared."""

    walls: Walls
    area: Array  # f32[4] x_min, x_max, y_min, y_max, metres, map frame
    detour: Array  # f32[C, C] metres that walls add between the centres of two cells

    def metres(self, from_x: Array, from_y: Array, to_x: Array, to_y: Array) -> Array:
        """Compute the length of the shortest way among the walls.

        Limits: without walls in between the straight line; ``NEVER`` more where there is no way.
        What lies outside of the area counts as in the nearest cell of it.

        Args:
            from_x: f32[...], metres, map frame.
            from_y: f32[...].
            to_x: f32[...].
            to_y: f32[...].

        Returns:
            f32[...], metres.
        """
        line = StraightLines().metres(from_x, from_y, to_x, to_y)
        start, end = self._cell(from_x, from_y), self._cell(to_x, to_y)
        detour = self.detour[start, end]
        return line + jnp.where(self.walls.is_between(from_x, from_y, to_x, to_y), detour, 0.0)

    def next_place(
        self, from_x: Array, from_y: Array, to_x: Array, to_y: Array
    ) -> tuple[Array, Array]:
        """Find the cell in a straight line from which the rest of the way is shortest.

        Args:
            from_x: f32[], metres, map frame: of one robot.
            from_y: f32[].
            to_x: f32[].
            to_y: f32[].

        Returns:
            f32[] x and y, metres, map frame: the end itself where no wall stands before it, or
            where there is no way.
        """
        x, y = cell_centres(self.area, self._side)
        first = StraightLines().metres(from_x, from_y, x, y)
        rest = self.metres(x, y, to_x, to_y)
        is_open = ~self.walls.is_between(from_x, from_y, x, y)
        total = jnp.where(is_open, first + rest, jnp.inf)
        best = jnp.argmin(total)
        is_direct = ~self.walls.is_between(from_x, from_y, to_x, to_y) | (total[best] >= NEVER)
        return jnp.where(is_direct, to_x, x[best]), jnp.where(is_direct, to_y, y[best])

    def first_sight(self, view: View, stretch: Stretch, x: Array, y: Array, radius: Array) -> Array:
        """Look about along a straight way; of one around walls count what its end shows alone."""
        line = StraightLines().metres(*stretch)[..., None]
        way = self.metres(*stretch)[..., None]
        eye = Eye(stretch.to_x[..., None], stretch.to_y[..., None], radius)
        axes = (1,) * (way.ndim - 1)
        at_end = view.sees(eye, x.reshape(*axes, -1), y.reshape(*axes, -1))
        late = jnp.where(at_end, way, NEVER)
        return jnp.where(way > line + _DETOUR, late, view.first_sight(stretch, x, y, radius))

    @property
    def _side(self) -> int:
        return round(self.detour.shape[-1] ** 0.5)

    def _cell(self, x: Array, y: Array) -> Array:
        """Find the cell of a place, i32[...]."""
        side = self._side
        column = jnp.floor((x - self.area[0]) / (self.area[1] - self.area[0]) * side)
        row = jnp.floor((y - self.area[2]) / (self.area[3] - self.area[2]) * side)
        column, row = jnp.clip(column, 0, side - 1), jnp.clip(row, 0, side - 1)
        return (row * side + column).astype(jnp.int32)


def cell_centres(area: Array, side: int) -> tuple[Array, Array]:
    """Compute the centres of side² cells, f32[C] x and y, metres; x runs faster."""
    steps = (jnp.arange(side) + 0.5) / side
    x = area[0] + steps * (area[1] - area[0])
    y = area[2] + steps * (area[3] - area[2])
    return jnp.tile(x, side), jnp.repeat(y, side)


@functools.partial(jax.jit, static_argnames="num_cells")
def geodesic(walls: Walls, area: Array, *, num_cells: int = NUM_CELLS) -> Geodesic:
    """Work out all shortest ways of a place.

    Args:
        walls: what is in the way.
        area: f32[4], x_min, x_max, y_min, y_max, metres, map frame.
        num_cells: cells a side; the table has num_cells⁴ entries.

    Returns:
        The ways, for as many questions as one likes.
    """
    x, y = cell_centres(area, num_cells)
    size_x, size_y = (area[1] - area[0]) / num_cells, (area[3] - area[2]) / num_cells
    lengths = [jnp.hypot(column * size_x, row * size_y) for row, column in _STEPS]
    grid_x, grid_y = x.reshape(num_cells, num_cells), y.reshape(num_cells, num_cells)
    costs = []
    for (row, column), length in zip(_STEPS, lengths, strict=True):
        to_x, to_y = grid_x + column * size_x, grid_y + row * size_y
        is_shut = walls.is_between(grid_x, grid_y, to_x, to_y)
        is_shut = is_shut | walls.is_between(to_x, to_y, grid_x, grid_y)
        costs.append(jnp.where(is_shut, NEVER, length))
    number = num_cells * num_cells
    start = jnp.where(jnp.eye(number, dtype=bool), 0.0, NEVER).reshape(number, num_cells, num_cells)
    found = _relaxed(start, costs)
    open_field = _relaxed(start, [jnp.full_like(grid_x, length) for length in lengths])
    detour = jnp.minimum(jnp.maximum(found - open_field, 0.0), NEVER)
    return Geodesic(walls=walls, area=area, detour=detour.reshape(number, number))


def _relaxed(start: Array, costs: list[Array]) -> Array:
    """Relax distances f32[C, G, G] over all neighbours until none gets shorter."""

    def improve(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        metres, _ = carry
        padded = jnp.pad(metres, ((0, 0), (1, 1), (1, 1)), constant_values=NEVER)
        shorter, side = metres, metres.shape[-1]
        for (row, column), cost in zip(_STEPS, costs, strict=True):
            beside = padded[:, 1 + row : 1 + row + side, 1 + column : 1 + column + side]
            shorter = jnp.minimum(shorter, beside + cost[None])
        return shorter, jnp.any(shorter < metres)

    return jax.lax.while_loop(lambda carry: carry[1], improve, (start, jnp.asarray(True)))[0]
