"""The minimum of a smooth function by L-BFGS (optax), compiled whole."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array

MEMORY = 10
"""Pairs of steps and changes of the gradient that estimate the curvature."""
_NOISE = 1e-5
"""Share of a value within which float32 hides a rise: no step is refused for it."""
_SEARCHES = 20
"""Times that a step may be halved."""


class Descent(NamedTuple):
    """Where a search stands."""

    point: Array  # f32[...]
    value: Array  # f32[]
    slope: Array  # f32[...]
    num_steps: Array  # f32[], like all that a derivative passes


def descend(
    value_of: Callable[[Array], Array],
    start: Array,
    *,
    slope_length: Array | float,
    max_steps: Array | float,
) -> Descent:
    """Search for a minimum until the slope is short.

    The steps are those of ``optax.lbfgs`` with a line search that only ever shortens them: near a
    minimum a step of one is right, and its gradient is what the next step starts from, so that a
    step costs one value and one gradient.

    Args:
        value_of: the function, of f32[...], to f32[].
        start: f32[...].
        slope_length: f32[], ends where the Euclidean length of the slope is no more than this.
        max_steps: f32[], and at the latest then.

    Returns:
        Where it ends.
    """
    search = optax.lbfgs(
        None,
        memory_size=MEMORY,
        linesearch=optax.scale_by_backtracking_linesearch(
            _SEARCHES, decrease_factor=0.5, increase_factor=jnp.inf, rtol=_NOISE, store_grad=True
        ),
    )

    def is_open(carry: tuple[Descent, optax.OptState]) -> Array:
        at, _ = carry
        return (jnp.vdot(at.slope, at.slope) > slope_length**2) & (at.num_steps < max_steps)

    def advance(carry: tuple[Descent, optax.OptState]) -> tuple[Descent, optax.OptState]:
        at, memory = carry
        step, memory = search.update(
            at.slope, memory, at.point, value=at.value, grad=at.slope, value_fn=value_of
        )
        value, slope = (optax.tree.get(memory, name) for name in ("value", "grad"))
        return Descent(at.point + jnp.asarray(step), value, slope, at.num_steps + 1.0), memory

    begin = Descent(start, *jax.value_and_grad(value_of)(start), jnp.float32(0.0))
    return jax.lax.while_loop(is_open, advance, (begin, search.init(start)))[0]
