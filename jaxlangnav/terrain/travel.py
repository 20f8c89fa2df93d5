"""How far it is to walk: the one function (section 3.4, d of eq. 12)."""

from typing import Protocol

import jax.numpy as jnp
from jax import Array

from jaxlangnav.pytree import pytree
from jaxlangnav.terrain.view import Stretch, View


class Travel(Protocol):
    """How a robot comes from place to place: a record that JAX can trace (``@pytree``).

    All arguments are metres, map frame, and broadcast against each other.
    """

    def metres(self, from_x: Array, from_y: Array, to_x: Array, to_y: Array) -> Array:
        """Compute the length of the shortest way, f32[...]; at least that of the straight line."""
        ...

    def next_place(
        self, from_x: Array, from_y: Array, to_x: Array, to_y: Array
    ) -> tuple[Array, Array]:
        """Find where to make for in a straight line on that way, f32[] x and y of one robot."""
        ...

    def first_sight(
        self,
        view: View,
        stretch: Stretch,
        x: Array,
        y: Array,
        radius: Array,
        opening: Array | None = None,
    ) -> Array:
        """Compute after how many metres of ways [...] points [C] come into view, f32[..., C]."""
        ...


@pytree
class StraightLines:
    """Nothing is in the way."""

    def metres(self, from_x: Array, from_y: Array, to_x: Array, to_y: Array) -> Array:
        """Compute the straight distance, f32[...]; its slope is finite at zero, too."""
        span_x, span_y = to_x - from_x, to_y - from_y
        return jnp.sqrt(span_x * span_x + span_y * span_y + 1e-12)

    def next_place(
        self, from_x: Array, from_y: Array, to_x: Array, to_y: Array
    ) -> tuple[Array, Array]:
        """Make for the end of the way itself."""
        del from_x, from_y
        return to_x, to_y

    def first_sight(
        self,
        view: View,
        stretch: Stretch,
        x: Array,
        y: Array,
        radius: Array,
        opening: Array | None = None,
    ) -> Array:
        """Look about all along the line."""
        return view.first_sight(stretch, x, y, radius, opening)
