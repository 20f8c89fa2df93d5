"""Shortest ways among walls: straight from end to end of those that are in the way.

A shortest way among straight walls turns at their ends only. So the ways between all ends are
worked out once (Floyd and Warshall), and any other way is the straight line, or goes

    min_ij |p − e_i| + D_ij + |e_j − q|     over ends e_i in sight of p, e_j in sight of q
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.numerics.batching import prepend_axes
from jaxlangnav.pytree import pytree
from jaxlangnav.terrain import Terrain
from jaxlangnav.terrain.view import NEVER, Eye, StraightLines, Stretch, View
from jaxlangnav.terrain.walls import Walls, walls

CLEARANCE = 0.2
"""Metres past a wall's end at which a way turns round it."""
_UNDERFOOT = 0.1  # metres from such a turn that count as there: what comes next is made for
_DETOUR = 0.01  # metres by which a way is longer than the line before it counts as none


@pytree
class Geodesic:
    """Shortest ways among walls; K = two turns for each wall."""

    walls: Walls
    turn_x: Array  # f32[K] metres, map frame: places just past the ends
    turn_y: Array  # f32[K]
    between: Array  # f32[K, K] metres from turn to turn; ``NEVER`` where there is no way

    def metres(self, from_x: Array, from_y: Array, to_x: Array, to_y: Array) -> Array:
        """Compute the length of the shortest way among the walls, f32[...] metres.

        Limits: with no wall in between the straight line; ``NEVER`` or more where there is no way.
        """
        line = StraightLines().metres(from_x, from_y, to_x, to_y)
        first, last = self._to_turns(from_x, from_y), self._to_turns(to_x, to_y)
        # Of no walls there are no turns, and nothing to take the least of.
        none = 4.0 * NEVER
        ways = first[..., :, None] + prepend_axes(self.between, first.ndim + 1)
        reached = prepend_axes(jnp.min(ways, axis=-2, initial=none), line.ndim + 1)
        around = jnp.min(reached + prepend_axes(last, line.ndim + 1), axis=-1, initial=none)
        return jnp.where(self.walls.is_between(from_x, from_y, to_x, to_y), around, line)

    def next_place(
        self, from_x: Array, from_y: Array, to_x: Array, to_y: Array
    ) -> tuple[Array, Array]:
        """Find the turn to make for in a straight line, or the end where no wall stands before it.

        It is the end itself, too, where there is no way.
        """
        if not self.turn_x.size:
            return to_x, to_y
        first = self._to_turns(from_x, from_y)
        total = first + self.metres(self.turn_x, self.turn_y, to_x, to_y)
        best = jnp.argmin(total + jnp.where(first < _UNDERFOOT, _UNDERFOOT, 0.0))
        is_shut = self.walls.is_between(from_x, from_y, to_x, to_y)
        turns = is_shut & (total[best] < NEVER)
        return jnp.where(turns, self.turn_x[best], to_x), jnp.where(turns, self.turn_y[best], to_y)

    def first_sight(
        self,
        view: View,
        stretch: Stretch,
        x: Array,
        y: Array,
        radius: Array,
        opening: Array | None = None,
    ) -> Array:
        """Look about along a straight way; of one around walls count what its end shows alone."""
        line = StraightLines().metres(*stretch)[..., None]
        way = self.metres(*stretch)[..., None]
        eye = Eye(stretch.to_x[..., None], stretch.to_y[..., None], radius)
        axes = (1,) * (way.ndim - 1)
        at_end = view.sees(eye, x.reshape(*axes, -1), y.reshape(*axes, -1))
        late = jnp.where(at_end, way, NEVER)
        return jnp.where(
            way > line + _DETOUR, late, view.first_sight(stretch, x, y, radius, opening)
        )

    def _to_turns(self, x: Array, y: Array) -> Array:
        """Compute the straight ways to all turns, f32[..., K]; ``NEVER`` to those out of sight."""
        here = jnp.asarray(x)[..., None], jnp.asarray(y)[..., None]
        turns = [prepend_axes(turn, here[0].ndim) for turn in (self.turn_x, self.turn_y)]
        line = StraightLines().metres(*here, *turns)
        return jnp.where(self.walls.is_between(*here, *turns), NEVER, line)


@jax.jit
def geodesic(walls: Walls) -> Geodesic:
    """Work out the shortest ways between the ends of walls, for any number of questions."""
    one_x, one_y, other_x, other_y = walls.ends.T
    length = StraightLines().metres(one_x, one_y, other_x, other_y)
    past_x = CLEARANCE * (other_x - one_x) / length
    past_y = CLEARANCE * (other_y - one_y) / length
    x = jnp.concatenate([one_x - past_x, other_x + past_x])
    y = jnp.concatenate([one_y - past_y, other_y + past_y])
    line = StraightLines().metres(x[:, None], y[:, None], x[None], y[None])
    is_shut = walls.is_between(x[:, None], y[:, None], x[None], y[None])
    start = jnp.where(is_shut, NEVER, line)

    def through(turn: int, ways: Array) -> Array:
        return jnp.minimum(ways, ways[:, turn][:, None] + ways[turn][None])

    ways = jax.lax.fori_loop(0, x.size, through, start) if x.size else start
    between = jnp.minimum(ways, NEVER)
    return Geodesic(walls=walls, turn_x=x, turn_y=y, between=between)


_COUNTS = (4, 8, 16, 32)
"""Walls to which fewer are filled up, so that places of like numbers share compiled programs."""


def among_walls(*ends: tuple[float, float, float, float]) -> Terrain:
    """Build a place of straight walls, of x, y of one end and of the other, metres, map frame.

    Host only. The last wall stands there again until there are 4, 8, 16 or 32.

    Raises:
        ValueError: none, more than 32, or one that is not four finite numbers.
    """
    if not 0 < len(ends) <= _COUNTS[-1]:
        raise ValueError(f"there are {len(ends)} walls, but must be 1 to {_COUNTS[-1]}")
    number = next(size for size in _COUNTS if size >= len(ends))
    there = walls(*ends, *[ends[-1]] * (number - len(ends)))
    return jax.tree.map(np.asarray, Terrain(view=there, travel=geodesic(there)))
