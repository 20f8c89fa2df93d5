"""The minimum of the bilinear log-linear model's objective, and its derivatives (section 4.1).

    J(V) = Σ_ug n₀ softplus(x_uᵀ V y_ug) + n₁ softplus(−x_uᵀ V y_ug) + ½ ‖V‖²

Another strength of regularisation, or one for each word feature, goes into the words, x / √λ. J is
then 1-strongly convex, so that J(V) − min J ≤ ½ ‖∇J(V)‖² says how far a search still has to go. The
minimum is differentiated as a function of words, properties and counts, by the implicit function
theorem: ∇J(V*(θ), θ) = 0.
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
"""Of the linear system behind a derivative: residual as a share of its right side, steps."""


class Problem(NamedTuple):
    """Factors of one fit, of which the words may be scaled."""

    words: Array  # f32[U, A]
    properties: Array  # f32[U, G, B]
    times: Array  # f32[U, G, 2] how many factors have φ = 0, and φ = 1


class Search(NamedTuple):
    """What the search for a minimum measured."""

    value: Array  # f32[] J at the end
    num_steps: Array  # f32[], like all that a derivative passes


def data_loss(problem: Problem, weights: Array) -> Array:
    """Evaluate the negative log-likelihood of all factors, f32[].

    Every term is above zero, and so are both of a slope: written as (n₀ + n₁) softplus(z) − n₁ z,
    the thousands of equal factors that a model is sure of leave the rounding of their count, and
    no search in float32 ends.
    """
    log_odds = jnp.einsum("ugf,uf->ug", problem.properties, problem.words @ weights)
    surprise = problem.times[..., 0] * jax.nn.softplus(log_odds)
    return (surprise + problem.times[..., 1] * jax.nn.softplus(-log_odds)).sum()


def objective(problem: Problem, weights: Array) -> Array:
    """Evaluate J(V), f32[]."""
    return data_loss(problem, weights) + 0.5 * jnp.sum(weights * weights)


def slope_of(problem: Problem, weights: Array) -> Array:
    """Evaluate ∇J(V), f32[A, B]."""
    return jax.grad(objective, argnums=1)(problem, weights)


@jax.custom_jvp
def minimise(problem: Problem, gap: Array, max_steps: Array) -> tuple[Array, Search]:
    """Minimise J by L-BFGS; differentiable by all of the problem, forwards and backwards.

    A derivative solves one linear system in the Hessian at the minimum, by conjugate gradients:
    ∂V*/∂θ = −H⁻¹ ∂∇J/∂θ, where H ⪰ 1. It is that of the minimum, not of the steps that led there.

    Args:
        problem: its factors; ``vmap`` over ``times`` fits many splits at once.
        gap: f32[], nats; ends where J is nearer than this to its minimum for certain, or where
            float32 gets no nearer.
        max_steps: f32[].

    Returns:
        Weights f32[A, B], and what the search measured (of no derivative).
    """
    num_words = problem.words.shape[0]
    chex.assert_rank((problem.words, problem.properties, problem.times), (2, 3, 3))
    chex.assert_shape(problem.properties, (num_words, None, None))
    chex.assert_shape(problem.times, (*problem.properties.shape[:2], 2))
    chex.assert_type(list(problem), jnp.float32)
    found = descend(
        lambda weights: objective(problem, weights),
        jnp.zeros((problem.words.shape[1], problem.properties.shape[2]), jnp.float32),
        slope_length=jnp.sqrt(2.0 * gap),
        max_steps=max_steps,
    )
    return found.point, Search(found.value, found.num_steps)


@minimise.defjvp
def _minimise_jvp(
    primals: tuple[Problem, Array, Array], tangents: tuple[Problem, Array, Array]
) -> tuple[tuple[Array, Search], tuple[Array, Search]]:
    """Differentiate the condition ∇J = 0 at the minimum."""
    problem, moved = primals[0], tangents[0]
    weights, search = minimise(*primals)

    def hessian(direction: Array) -> Array:
        return jax.jvp(lambda at: slope_of(problem, at), (weights,), (direction,))[1]

    def solve(matrix: Callable[[Array], Array], right: Array) -> Array:
        return cg(matrix, right, tol=_LINEAR_TOLERANCE, maxiter=_LINEAR_STEPS)[0]

    turned = jax.jvp(lambda of: slope_of(of, weights), (problem,), (moved,))[1]
    change = jax.lax.custom_linear_solve(hessian, -turned, solve, symmetric=True)
    return (weights, search), (change, jax.tree.map(jnp.zeros_like, search))
