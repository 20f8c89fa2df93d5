"""Minimisation of a smooth function by L-BFGS (optax), in one compiled program."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array

MEMORY = 10
"""Stored pairs of steps and gradient changes (history of L-BFGS)."""
_NOISE = 1e-5
"""Relative increase that the line search accepts, as float32 rounding may hide a decrease."""
_HALVINGS = 20
"""Maximum number of backtracking steps of the line search."""
_MIN_DECREASE = 1e-6, 0.1
"""Relative decrease of the value, or of the squared gradient norm, that counts as progress."""
_PATIENCE = 10
"""Steps without progress after which the minimisation ends."""


class Descent(NamedTuple):
    """Current point of a minimisation."""

    point: Array  # f32[...]
    value: Array  # f32[]
    grad: Array  # f32[...]
    num_steps: Array  # f32[], as derivatives need floats


class _LoopState(NamedTuple):
    """Loop state of a minimisation."""

    current: Descent
    memory: optax.OptState
    lowest: Array  # f32[2] value, squared gradient norm
    num_idle: Array  # f32[] steps without progress


def descend(
    value_fn: Callable[[Array], Array],
    start: Array,
    *,
    gradient_norm: Array | float,
    max_steps: Array | float,
) -> Descent:
    """Minimise a function until its gradient is small, or stops decreasing in float32.

    Steps are those of ``optax.lbfgs`` with a backtracking line search: near a minimum the full step
    is right, and its gradient starts the next one. Where rounding hides the descent, every step is
    halved to nothing at the cost of many evaluations, so ten steps without progress end the search.

    Args:
        value_fn: function of f32[...], to f32[].
        start: f32[...].
        gradient_norm: f32[], threshold on the Euclidean norm of the gradient.
        max_steps: f32[], maximum number of steps.
    """
    lbfgs = optax.lbfgs(
        None,
        memory_size=MEMORY,
        linesearch=optax.scale_by_backtracking_linesearch(
            _HALVINGS, decrease_factor=0.5, increase_factor=jnp.inf, rtol=_NOISE, store_grad=True
        ),
    )

    def is_running(state: _LoopState) -> Array:
        now = state.current
        is_steep = jnp.vdot(now.grad, now.grad) > gradient_norm**2
        return is_steep & (now.num_steps < max_steps) & (state.num_idle < _PATIENCE)

    def advance(state: _LoopState) -> _LoopState:
        now = state.current
        step, memory = lbfgs.update(
            now.grad, state.memory, now.point, value=now.value, grad=now.grad, value_fn=value_fn
        )
        value, grad = (optax.tree.get(memory, name) for name in ("value", "grad"))
        measures = jnp.stack([value, jnp.vdot(grad, grad)])
        is_lower = measures < state.lowest - jnp.array(_MIN_DECREASE) * jnp.abs(state.lowest)
        return _LoopState(
            Descent(now.point + jnp.asarray(step), value, grad, now.num_steps + 1.0),
            memory,
            jnp.where(is_lower, measures, state.lowest),
            jnp.where(is_lower.any(), 0.0, state.num_idle + 1.0),
        )

    value, grad = jax.value_and_grad(value_fn)(start)
    zero = jnp.float32(0.0)
    lowest = jnp.stack([value, jnp.vdot(grad, grad)])
    start_state = _LoopState(Descent(start, value, grad, zero), lbfgs.init(start), lowest, zero)
    return jax.lax.while_loop(is_running, advance, start_state).current
