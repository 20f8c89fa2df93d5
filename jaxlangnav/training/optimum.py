"""Minimisation of the log-linear training objective, with implicit derivatives (section 4.1).

    J(V) = Σ_ug n₀ softplus(x_uᵀ V y_ug) + n₁ softplus(−x_uᵀ V y_ug) + ½ ‖V‖²

A regularisation strength λ, also one per word feature, is absorbed into the words, x / √λ. J is
then 1-strongly convex, so that J(V) − min J ≤ ½ ‖∇J(V)‖² bounds the remaining gap. The minimum is
differentiated with respect to words, properties and counts by the implicit function theorem:
∇J(V*(θ), θ) = 0.
"""

from collections.abc import Callable
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.sparse.linalg import cg

from jaxlangnav.numerics.descent import descend

_LINEAR_TOLERANCE, _LINEAR_STEPS = 1e-5, 500
"""Conjugate gradients of a derivative: relative residual and maximum number of steps."""


class Problem(NamedTuple):
    """Factors of one fit, whose words may be scaled."""

    words: Array  # f32[U, A]
    properties: Array  # f32[U, G, B]
    counts: Array  # f32[U, G, 2] number of factors with φ = 0, and φ = 1


class MinimiserInfo(NamedTuple):
    """Diagnostics of the minimisation."""

    value: Array  # f32[] J at the end
    num_steps: Array  # f32[], as derivatives need floats


def data_loss(problem: Problem, weights: Array) -> Array:
    """Evaluate the negative log-likelihood of all factors, f32[].

    Written as a sum of positive terms: in (n₀ + n₁) softplus(z) − n₁ z, the rounding errors of
    thousands of equal factors with small loss would keep a float32 search from converging.
    """
    log_odds = jnp.einsum("ugf,uf->ug", problem.properties, problem.words @ weights)
    loss_absent = problem.counts[..., 0] * jax.nn.softplus(log_odds)
    return (loss_absent + problem.counts[..., 1] * jax.nn.softplus(-log_odds)).sum()


def objective(problem: Problem, weights: Array) -> Array:
    """Evaluate J(V), f32[]."""
    return data_loss(problem, weights) + 0.5 * jnp.sum(weights * weights)


def gradient(problem: Problem, weights: Array) -> Array:
    """Evaluate ∇J(V), f32[A, B]."""
    return jax.grad(objective, argnums=1)(problem, weights)


@jax.custom_jvp
def minimise(problem: Problem, gap: Array, max_steps: Array) -> tuple[Array, MinimiserInfo]:
    """Minimise J by L-BFGS; differentiable in all of the problem, in forward and reverse mode.

    A derivative solves one linear system in the Hessian at the minimum, by conjugate gradients:
    ∂V*/∂θ = −H⁻¹ ∂∇J/∂θ, where H ⪰ 1. It is that of the minimum, not of the iterations.

    Args:
        problem: its factors; ``vmap`` over ``counts`` fits many splits at once.
        gap: f32[], nats; stops when J is guaranteed to be closer to its minimum than this, or when
            float32 makes no progress.
        max_steps: f32[].

    Returns:
        Weights f32[A, B], and diagnostics (with zero derivative).
    """
    chex.assert_rank((problem.words, problem.properties, problem.counts), (2, 3, 3))
    chex.assert_shape(problem.properties, (problem.words.shape[0], None, None))
    chex.assert_shape(problem.counts, (*problem.properties.shape[:2], 2))
    chex.assert_type(list(problem), jnp.float32)
    result = descend(
        lambda weights: objective(problem, weights),
        jnp.zeros((problem.words.shape[1], problem.properties.shape[2]), jnp.float32),
        gradient_norm=jnp.sqrt(2.0 * gap),
        max_steps=max_steps,
    )
    return result.point, MinimiserInfo(result.value, result.num_steps)


@minimise.defjvp
def _minimise_jvp(
    primals: tuple[Problem, Array, Array], tangents: tuple[Problem, Array, Array]
) -> tuple[tuple[Array, MinimiserInfo], tuple[Array, MinimiserInfo]]:
    """Differentiate the condition ∇J = 0 at the minimum."""
    problem, tangent = primals[0], tangents[0]
    weights, search = minimise(*primals)

    def hessian(direction: Array) -> Array:
        return jax.jvp(lambda w: gradient(problem, w), (weights,), (direction,))[1]

    def solve(matrix: Callable[[Array], Array], right: Array) -> Array:
        return cg(matrix, right, tol=_LINEAR_TOLERANCE, maxiter=_LINEAR_STEPS)[0]

    mixed = jax.jvp(lambda p: gradient(p, weights), (problem,), (tangent,))[1]
    change = jax.lax.custom_linear_solve(hessian, -mixed, solve, symmetric=True)
    return (weights, search), (change, jax.tree.map(jnp.zeros_like, search))
