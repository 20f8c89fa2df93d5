"""Geodesic distances among straight walls, by the visibility graph of their ends.

A shortest path among straight walls turns at their ends only. So the distances of all ends are
computed once (Floyd-Warshall), and any other distance is that of the straight line, or

    min_ij |p − e_i| + D_ij + |e_j − q|     over ends e_i in sight of p, e_j in sight of q
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.numerics.batching import prepend_axes
from jaxlangnav.pytree import pytree
from jaxlangnav.terrain import Terrain
from jaxlangnav.terrain.view import LARGE, Eye, Position, Segment, StraightLines, View
from jaxlangnav.terrain.walls import Walls, walls

CLEARANCE = 0.2
"""Metres past a wall's end at which a path turns around it."""
_ARRIVAL = 0.1  # metres from such a turn within which it counts as reached
_MIN_DETOUR = 0.01  # metres by which a path has to exceed the straight line to count as a detour


@pytree
class Geodesic:
    """Geodesic travel model among walls; K = two turns for each wall."""

    walls: Walls
    turn_x: Array  # f32[K] metres, map frame: points just past the ends
    turn_y: Array  # f32[K]
    between: Array  # f32[K, K] metres from turn to turn; ``LARGE`` if there is no path

    def metres(self, from_x: Array, from_y: Array, to_x: Array, to_y: Array) -> Array:
        """Compute the length of the shortest path among the walls, f32[...] metres.

        Limits: with no wall in between the straight line; ``LARGE`` or more if there is no path.
        """
        line = StraightLines().metres(from_x, from_y, to_x, to_y)
        first, last = self._to_turns(from_x, from_y), self._to_turns(to_x, to_y)
        # Without walls there are no turns: initial value of the empty minimum.
        no_path = 4.0 * LARGE
        via_turns = first[..., :, None] + prepend_axes(self.between, first.ndim + 1)
        reached = prepend_axes(jnp.min(via_turns, axis=-2, initial=no_path), line.ndim + 1)
        around = jnp.min(reached + prepend_axes(last, line.ndim + 1), axis=-1, initial=no_path)
        return jnp.where(self.walls.is_between(from_x, from_y, to_x, to_y), around, line)

    def next_place(self, from_x: Array, from_y: Array, to_x: Array, to_y: Array) -> Position:
        """Find the next turn of the shortest path; its end if no wall is in between, or no path."""
        if not self.turn_x.size:
            return to_x, to_y
        first = self._to_turns(from_x, from_y)
        total = first + self.metres(self.turn_x, self.turn_y, to_x, to_y)
        best = jnp.argmin(total + jnp.where(first < _ARRIVAL, _ARRIVAL, 0.0))
        is_blocked = self.walls.is_between(from_x, from_y, to_x, to_y)
        is_turn, x, y = is_blocked & (total[best] < LARGE), self.turn_x, self.turn_y
        return jnp.where(is_turn, x[best], to_x), jnp.where(is_turn, y[best], to_y)

    def first_sight(
        self, view: View, segment: Segment, x: Array, y: Array, radius: Array, fov: Array | None
    ) -> Array:
        """See ``View.first_sight``; for a path around walls only the view from its end counts."""
        line = StraightLines().metres(*segment)[..., None]
        path = self.metres(*segment)[..., None]
        eye = Eye(segment.to_x[..., None], segment.to_y[..., None], radius)
        at_end = view.sees(eye, prepend_axes(x, path.ndim), prepend_axes(y, path.ndim))
        at_end_only = jnp.where(at_end, path, LARGE)
        return jnp.where(
            path > line + _MIN_DETOUR, at_end_only, view.first_sight(segment, x, y, radius, fov)
        )

    def _to_turns(self, x: Array, y: Array) -> Array:
        """Compute the straight distances to all turns, f32[..., K]; ``LARGE`` if occluded."""
        point = jnp.asarray(x)[..., None], jnp.asarray(y)[..., None]
        turns = [prepend_axes(turn, point[0].ndim) for turn in (self.turn_x, self.turn_y)]
        line = StraightLines().metres(*point, *turns)
        return jnp.where(self.walls.is_between(*point, *turns), LARGE, line)


@jax.jit
def geodesic(walls: Walls) -> Geodesic:
    """Build the geodesic travel model of walls: distances between all their ends."""
    from_x, from_y, to_x, to_y = walls.ends.T
    length = StraightLines().metres(from_x, from_y, to_x, to_y)
    margin_x = CLEARANCE * (to_x - from_x) / length
    margin_y = CLEARANCE * (to_y - from_y) / length
    x = jnp.concatenate([from_x - margin_x, to_x + margin_x])
    y = jnp.concatenate([from_y - margin_y, to_y + margin_y])
    line = StraightLines().metres(x[:, None], y[:, None], x[None], y[None])
    start = jnp.where(walls.is_between(x[:, None], y[:, None], x[None], y[None]), LARGE, line)

    def relax(turn: int, lengths: Array) -> Array:
        return jnp.minimum(lengths, lengths[:, turn][:, None] + lengths[turn][None])

    lengths = jax.lax.fori_loop(0, x.size, relax, start) if x.size else start
    return Geodesic(walls=walls, turn_x=x, turn_y=y, between=jnp.minimum(lengths, LARGE))


_SIZES = (4, 8, 16, 32)
"""Numbers of walls to pad to, so that environments of similar size share compiled programs."""


def among_walls(*ends: tuple[float, float, float, float]) -> Terrain:
    """Build a terrain of straight walls, each x, y of one end and of the other, metres, map frame.

    Host only. The last wall is repeated until there are 4, 8, 16 or 32.

    Raises:
        ValueError: no wall, more than 32, or one that is not four finite numbers.
    """
    if not 0 < len(ends) <= _SIZES[-1]:
        raise ValueError(f"there are {len(ends)} walls, but must be 1 to {_SIZES[-1]}")
    size = next(size for size in _SIZES if size >= len(ends))
    padded = walls(*ends, *[ends[-1]] * (size - len(ends)))
    return jax.tree.map(np.asarray, Terrain(view=padded, travel=geodesic(padded)))
