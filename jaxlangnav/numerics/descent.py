"""Minimisation of a smooth function by L-BFGS (optax), in one compiled program."""

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
_DECREASE = 1e-6, 0.1
"""Shares by which the value, or the square of the slope's length, is to fall below its lowest."""
_PATIENCE = 10
"""Steps without either after which float32 gets no further."""


class Descent(NamedTuple):
    """Current point of a minimisation."""

    point: Array  # f32[...]
    value: Array  # f32[]
    slope: Array  # f32[...]
    num_steps: Array  # f32[], like all that a derivative passes


class _LoopState(NamedTuple):
    """Loop state of a minimisation."""

    at: Descent
    memory: optax.OptState
    lowest: Array  # f32[2] value, square of the slope's length
    num_idle: Array  # f32[] steps since one of them was as low


def descend(
    value_of: Callable[[Array], Array],
    start: Array,
    *,
    slope_length: Array | float,
    max_steps: Array | float,
) -> Descent:
    """Minimise a function until the gradient is short, or stops shrinking in float32.

    The steps are those of ``optax.lbfgs`` with a line search that only ever shortens them: near a
    minimum a step of one is right, and its gradient is what the next step starts from. Where
    rounding hides the way down every step is halved to nothing, at the cost of many, so ten steps
    that lower neither the value nor the slope are the end, too.

    Args:
        value_of: the function, of f32[...], to f32[].
        start: f32[...].
        slope_length: f32[], ends where the Euclidean length of the slope is no more than this.
        max_steps: f32[], and at the latest then.
    """
    search = optax.lbfgs(
        None,
        memory_size=MEMORY,
        linesearch=optax.scale_by_backtracking_linesearch(
            _SEARCHES, decrease_factor=0.5, increase_factor=jnp.inf, rtol=_NOISE, store_grad=True
        ),
    )

    def is_running(state: _LoopState) -> Array:
        at = state.at
        is_steep = jnp.vdot(at.slope, at.slope) > slope_length**2
        return is_steep & (at.num_steps < max_steps) & (state.num_idle < _PATIENCE)

    def advance(state: _LoopState) -> _LoopState:
        at = state.at
        step, memory = search.update(
            at.slope, state.memory, at.point, value=at.value, grad=at.slope, value_fn=value_of
        )
        value, slope = (optax.tree.get(memory, name) for name in ("value", "grad"))
        reached = jnp.stack([value, jnp.vdot(slope, slope)])
        is_lower = reached < state.lowest - jnp.array(_DECREASE) * jnp.abs(state.lowest)
        return _LoopState(
            Descent(at.point + jnp.asarray(step), value, slope, at.num_steps + 1.0),
            memory,
            jnp.where(is_lower, reached, state.lowest),
            jnp.where(is_lower.any(), 0.0, state.num_idle + 1.0),
        )

    value, slope = jax.value_and_grad(value_of)(start)
    zero = jnp.float32(0.0)
    lowest = jnp.stack([value, jnp.vdot(slope, slope)])
    start_state = _LoopState(Descent(start, value, slope, zero), search.init(start), lowest, zero)
    return jax.lax.while_loop(is_running, advance, start_state).at
