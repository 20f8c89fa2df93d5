"""Small Gaussians in canonical (information) form, exact operations (section 3.2).

A Gaussian over n scalar coordinates is held as Λ = Σ⁻¹ and η = Λ μ. Both axes of the plane share
one Λ, because every noise in the map is isotropic; x and y have an η each. n is small and known
at trace time, so the algorithms are unrolled: with the batch axes last ("…") they become a few
fused elementwise loops, many times faster than a batched LAPACK call.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.numerics.axes import column as along_batch


def invert(precision: Array) -> Array:
    """Invert a small symmetric positive definite matrix by n symmetric sweeps.

    Limits: a diagonal matrix gives the reciprocals; n = 1 gives 1 / Λ.

    Args:
        precision: f32[n, n, ...], symmetric positive definite.

    Returns:
        f32[n, n, ...], the inverse.
    """
    size = precision.shape[0]
    swept = precision
    for pivot_index in range(size):
        is_pivot = along_batch(jnp.arange(size) == pivot_index, precision.ndim - 1)
        pivot = swept[pivot_index, pivot_index]
        column = jnp.where(is_pivot, 0.0, swept[pivot_index])
        scaled = jnp.where(is_pivot, -1.0, column) / pivot[None]
        rest = swept - column[:, None] * scaled[None]
        swept = jnp.where(is_pivot[:, None], scaled[None], rest)
        swept = jnp.where(is_pivot[None], scaled[:, None], swept)
    return -swept


def product(matrix: Array, vector: Array) -> Array:
    """Multiply a small matrix by a vector, unrolled: XLA's own sum does not vectorise here.

    Args:
        matrix: f32[m, n, ...].
        vector: f32[n, ...].

    Returns:
        f32[m, ...].
    """
    total = matrix[:, 0] * vector[None, 0]
    for index in range(1, vector.shape[0]):
        total = total + matrix[:, index] * vector[None, index]
    return total


def add_noise(
    precision: Array, information_x: Array, information_y: Array, index: int, variance: Array
) -> tuple[Array, Array, Array]:
    """Add independent noise to one coordinate: a motion whose old pose is marginalised out.

        Λ' = Λ − s Λᵢ Λᵢᵀ,   η' = η − s Λᵢ ηᵢ,   s = q / (1 + q Λᵢᵢ)

    This is the exact Schur complement over the old pose, and holds for q = 0 as well.

    Args:
        precision: f32[n, n, ...].
        information_x: f32[n, ...], η of the x axis.
        information_y: f32[n, ...], η of the y axis.
        index: coordinate that moves.
        variance: f32[], q ≥ 0, square metres per axis.

    Returns:
        The new Λ, η of x and η of y.
    """
    column = precision[:, index]
    scale = (variance / (1.0 + variance * column[index]))[None]
    return (
        precision - scale[None] * column[:, None] * column[None],
        information_x - scale * column * information_x[None, index],
        information_y - scale * column * information_y[None, index],
    )


def shift(
    precision: Array,
    information_x: Array,
    information_y: Array,
    index: int,
    shift_x: Array,
    shift_y: Array,
) -> tuple[Array, Array]:
    """Translate the mean of one coordinate: η' = η + Λᵢ u.

    Args:
        precision: f32[n, n, ...].
        information_x: f32[n, ...].
        information_y: f32[n, ...].
        index: coordinate that moves.
        shift_x: f32[], metres.
        shift_y: f32[], metres.

    Returns:
        The new η of x and η of y.
    """
    column = precision[:, index]
    return information_x + column * shift_x, information_y + column * shift_y


def log_normal_isotropic(offset_x: Array, offset_y: Array, variance: Array) -> Array:
    """Evaluate an isotropic Gaussian log-density in the plane.

        log N(ν; 0, s I₂) = −|ν|² / 2s − log 2πs

    Args:
        offset_x: f32[...], metres.
        offset_y: f32[...], metres.
        variance: f32[...], s > 0, square metres per axis.

    Returns:
        f32[...], log of the density per square metre.
    """
    squared = offset_x * offset_x + offset_y * offset_y
    return -0.5 * squared / variance - jnp.log(2.0 * jnp.pi * variance)
