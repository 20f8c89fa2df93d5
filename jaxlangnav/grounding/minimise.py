"""L-BFGS for the bilinear log-linear model, any number of fits at once (section 4.1).

    J(V) = Σ_ug n₀ softplus(x_uᵀ V y_ug) + n₁ softplus(−x_uᵀ V y_ug) + λ/2 ‖V‖²

The log-odds are linear in V. So a step needs them along its direction only: the line search is
arithmetic on them, without another product, and the gradient where it ends comes from the same
numbers. The program is small, so that it compiles in about a second.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

MEMORY = 5
"""Pairs of steps and changes of the gradient that estimate the curvature."""
_STEEP, _RISING, _SEARCHES = 0.9, 0.5, 12
"""A step may end where the slope is between −0.9 and 0.5 times what it was at its start."""


class Problem(NamedTuple):
    """Factors of one fit, in any basis."""

    words: Array  # f32[U, A]
    properties: Array  # f32[U, G, B]
    times: Array  # f32[U, G, 2] how many factors have φ = 0, and φ = 1


class _Carry(NamedTuple):
    """Where the search stands."""

    weights: Array  # f32[A, B]
    log_odds: Array  # f32[U, G]
    gradient: Array  # f32[A, B]
    steps: Array  # f32[M, A, B] newest first
    changes: Array  # f32[M, A, B] of the gradient
    inverse: Array  # f32[M] 1 / ⟨step, change⟩; 0 where there is none
    num_steps: Array  # i32[]


def log_odds_of(problem: Problem, weights: Array) -> Array:
    """Evaluate x_uᵀ V y_ug, f32[U, G]; linear in the weights f32[A, B]."""
    return jnp.einsum("ugf,uf->ug", problem.properties, problem.words @ weights)


def _pull_back(problem: Problem, slope: Array) -> Array:
    """Turn slopes by log-odds f32[U, G] into slopes by weights f32[A, B]: the transposed map."""
    return problem.words.T @ jnp.einsum("ugf,ug->uf", problem.properties, slope)


def _chance(log_odds: Array) -> Array:
    """Turn log-odds into probabilities; written out because XLA's logistic is slow on CPU."""
    return 1.0 / (1.0 + jnp.exp(-log_odds))


def _slope(problem: Problem, chance: Array) -> Array:
    """Evaluate the derivative of the loss by each log-odds, f32[U, G]."""
    return problem.times.sum(-1) * chance - problem.times[..., 1]


def _gradient(problem: Problem, weights: Array, chance: Array, l2: Array) -> Array:
    """Evaluate ∇J, f32[A, B], from the probabilities f32[U, G] that factors have φ = 1."""
    return _pull_back(problem, _slope(problem, chance)) + l2 * weights


def gradient(problem: Problem, weights: Array, l2: Array) -> Array:
    """Evaluate the gradient in closed form: what is expected of each feature, less what is seen.

        ∇J(V) = Σ_ug [(n₀ + n₁) σ(x_uᵀ V y_ug) − n₁] x_u y_ugᵀ + λ V

    Args:
        problem: its factors.
        weights: f32[A, B].
        l2: f32[], λ.

    Returns:
        f32[A, B].
    """
    return _gradient(problem, weights, _chance(log_odds_of(problem, weights)), l2)


def objective(problem: Problem, weights: Array, l2: Array) -> Array:
    """Evaluate J(V), f32[]."""
    log_odds = log_odds_of(problem, weights)
    loss = problem.times[..., 0] * jax.nn.softplus(log_odds)
    loss = loss + problem.times[..., 1] * jax.nn.softplus(-log_odds)
    return loss.sum() + 0.5 * l2 * jnp.sum(weights * weights)


def _direction(carry: _Carry) -> Array:
    """Multiply the gradient by the estimated inverse curvature (the two-loop recursion)."""
    direction, shares = -carry.gradient, []
    for i in range(MEMORY):
        shares.append(carry.inverse[i] * jnp.vdot(carry.steps[i], direction))
        direction = direction - shares[i] * carry.changes[i]
    newest = carry.changes[0]
    curved = carry.inverse[0] * jnp.vdot(newest, newest)
    # The first step goes one unit far: farther, factors saturate and the search crawls back.
    length = jnp.sqrt(jnp.vdot(carry.gradient, carry.gradient))
    direction = direction / jnp.where(curved > 0.0, curved, length)
    for i in reversed(range(MEMORY)):
        share = carry.inverse[i] * jnp.vdot(carry.changes[i], direction)
        direction = direction + (shares[i] - share) * carry.steps[i]
    return direction


def _go(
    problem: Problem, carry: _Carry, direction: Array, along: Array, l2: Array
) -> tuple[Array, Array]:
    """Find how far to go, f32[]: one, or by Newton steps inside a bracket; chances there."""
    across, square = jnp.vdot(carry.weights, direction), jnp.vdot(direction, direction)
    start = jnp.vdot(carry.gradient, direction)

    def look(length: Array) -> tuple[Array, Array]:
        chance = _chance(carry.log_odds + length * along)
        slope = jnp.vdot(_slope(problem, chance), along)
        return slope + l2 * (across + length * square), chance

    def is_open(state: tuple) -> Array:
        _, _, _, slope, _, count = state
        is_far = (slope < _STEEP * start) | (slope > -_RISING * start)
        return is_far & (count < _SEARCHES)

    def refine(state: tuple) -> tuple:
        length, low, high, slope, chance, count = state
        low, high = jnp.where(slope < 0.0, length, low), jnp.where(slope < 0.0, high, length)
        bend = problem.times.sum(-1) * chance * (1.0 - chance)
        newton = length - slope / (jnp.vdot(bend, along * along) + l2 * square)
        newton = jnp.minimum(newton, 4.0 * length)
        middle = jnp.where(jnp.isinf(high), 2.0 * length, 0.5 * (low + high))
        length = jnp.where((newton > low) & (newton < high), newton, middle)
        return length, low, high, *look(length), count + 1

    one = jnp.float32(1.0)
    first = (one, jnp.float32(0.0), jnp.float32(jnp.inf), *look(one), jnp.int32(0))
    length, _, _, _, chance, _ = jax.lax.while_loop(is_open, refine, first)
    return length, chance


def _advance(problem: Problem, carry: _Carry, l2: Array) -> _Carry:
    """Take one step."""
    direction = _direction(carry)
    along = log_odds_of(problem, direction)
    length, chance = _go(problem, carry, direction, along, l2)
    step = length * direction
    weights, log_odds = carry.weights + step, carry.log_odds + length * along
    slope = _gradient(problem, weights, chance, l2)
    change = slope - carry.gradient
    curved = jnp.vdot(step, change)
    inverse = jnp.where(curved > 0.0, 1.0 / curved, 0.0)

    def newest_first(new: Array, old: Array) -> Array:
        return jnp.concatenate([new[None], old[:-1]])

    return _Carry(
        weights,
        log_odds,
        slope,
        newest_first(step, carry.steps),
        newest_first(change, carry.changes),
        newest_first(inverse, carry.inverse),
        carry.num_steps + 1,
    )


def minimise(
    problem: Problem, l2: Array, tolerance: Array, max_steps: Array
) -> tuple[Array, Array, Array]:
    """Minimise J from zero weights.

    The objective is λ-strongly convex: J(V) − min J ≤ ‖∇J‖² / 2 λ.

    Args:
        problem: its factors; ``vmap`` over ``times`` fits many splits at once.
        l2: f32[], λ above zero.
        tolerance: f32[], ends where the Euclidean length of the gradient is below it.
        max_steps: i32[].

    Returns:
        Weights f32[A, B], the objective f32[] there, and the number of steps i32[].
    """
    shape = (problem.words.shape[1], problem.properties.shape[2])
    weights = jnp.zeros(shape, jnp.float32)
    memory = jnp.zeros((MEMORY, *shape), jnp.float32)
    carry = _Carry(
        weights=weights,
        log_odds=jnp.zeros(problem.times.shape[:2], jnp.float32),
        gradient=gradient(problem, weights, l2),
        steps=memory,
        changes=memory,
        inverse=jnp.zeros(MEMORY, jnp.float32),
        num_steps=jnp.int32(0),
    )

    def is_open(carry: _Carry) -> Array:
        square = jnp.vdot(carry.gradient, carry.gradient)
        return (square > tolerance * tolerance) & (carry.num_steps < max_steps)

    carry = jax.lax.while_loop(is_open, lambda carry: _advance(problem, carry, l2), carry)
    return carry.weights, objective(problem, carry.weights, l2), carry.num_steps
