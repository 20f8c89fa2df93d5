"""Small Gaussians in moment form, conditioned on one relative position at a time (section 3.2).

A Gaussian over n coordinates is stored as its mean and its covariance Σ. Both axes of the plane
share one Σ, because every noise in the map is isotropic; x and y have a mean each. The design asks
for the information form Λ = Σ⁻¹, sparse in hundreds of poses. Here the old poses are marginalised
out and n is nine, so Λ would be dense, and the covariance of robot and object, which association
needs at every step, would cost an inversion. A measurement is a rank-one downdate of Σ.

n is small and known at trace time, so the code is unrolled: with the batch axes last ("…") it
becomes a few fused elementwise loops, many times faster than batched LAPACK calls.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.numerics.batching import append_axes, materialize, select_row


class Moments(NamedTuple):
    """A joint Gaussian over n coordinates, the same covariance in both axes of the plane."""

    covariance: Array  # f32[n, n, ...] square metres
    mean_x: Array  # f32[n, ...] metres
    mean_y: Array  # f32[n, ...]


def add_coordinates(
    moments: Moments, origin: int, is_new: Array, offset_x: Array, offset_y: Array, variance: Array
) -> Moments:
    """Add coordinates relative to an existing one: x_i = x_origin + z_i + N(0, R).

        Σ'_ij = Σ_{o(i) o(j)} + R δ_ij,   o(i) the origin where i is new and i itself elsewhere

    This is the limit of a flat prior conditioned on z; the old coordinate is overwritten.

    Args:
        moments: joint Gaussian.
        origin: coordinate that is not new.
        is_new: bool[n, ...], coordinates to add.
        offset_x: f32[n, ...], z, metres.
        offset_y: f32[n, ...].
        variance: f32[n, ...] or f32[n, 1, ...], R, square metres per axis.
    """
    covariance, mean_x, mean_y = moments
    base = slice(origin, origin + 1)
    rows = jnp.where(is_new[:, None], covariance[base], covariance)
    both = jnp.where(is_new[None], rows[:, base], rows)
    is_diagonal = append_axes(jnp.eye(covariance.shape[0], dtype=bool), covariance.ndim)
    return Moments(
        both + jnp.where(is_diagonal & is_new[None], variance[None], 0.0),
        jnp.where(is_new, mean_x[base] + offset_x, mean_x),
        jnp.where(is_new, mean_y[base] + offset_y, mean_y),
    )


def condition_offsets(
    moments: Moments,
    edges: Sequence[tuple[int, int]],
    is_used: Array,
    offset_x: Array,
    offset_y: Array,
    variance: Array,
) -> Moments:
    """Condition on measured relative positions z_k = x_i − x_j + N(0, R_k), one after the other.

        S = hᵀ Σ h + R,   g = Σ h / √S,   Σ' = Σ − g gᵀ,   μ' = μ + g (z − hᵀ μ) / √S

    with h = e_i − e_j. g gᵀ is symmetric to the last bit, so Σ stays so. The variance hᵀ Σ h,
    which rounding may take below zero, is clipped: S ≥ R.
    Limits: R → ∞ changes nothing; the order of the measurements does not matter.

    Args:
        moments: joint Gaussian.
        edges: pairs (i, j), k of them.
        is_used: bool[k, ...], measurements that exist.
        offset_x: f32[k, ...], z, metres.
        offset_y: f32[k, ...].
        variance: f32[k, ...], R > 0, square metres per axis.
    """
    covariance, mean_x, mean_y = moments
    size = covariance.shape[0]
    # The means are two more columns: Σ' and μ' are then one and the same downdate.
    table = jnp.concatenate([covariance, mean_x[:, None], mean_y[:, None]], axis=1)
    to, origin = np.array(edges, np.int32).T
    measurements = (to, origin, is_used, offset_x, offset_y, variance[: len(edges)])

    def update(table: Array, row: tuple[Array, ...]) -> tuple[Array, None]:
        to, origin, is_used, offset_x, offset_y, variance = row
        edge = select_row(table, to) - select_row(table, origin)
        innovation = jnp.maximum(select_row(edge, to) - select_row(edge, origin), 0.0) + variance
        scale = jnp.where(is_used, jax.lax.rsqrt(innovation), 0.0)
        measured = jnp.stack([offset_x, offset_y])
        # Joined, XLA keeps the gain in memory. Written as one elementwise expression it is worked
        # out anew wherever it is used.
        gain = jnp.concatenate([edge[:size], edge[size:] - measured]) * scale[None]
        return table - gain[:size, None] * gain[None], None

    # Unrolled: a loop would read and write the whole table in every round, three times as slow.
    table, _ = jax.lax.scan(update, table, measurements, unroll=True)
    # Much reads the means, and would run through all updates again each time.
    mean_x, mean_y = materialize((table[:, size], table[:, size + 1]))
    return Moments(table[:, :size], mean_x, mean_y)


def log_normal_isotropic(offset_x: Array, offset_y: Array, variance: Array) -> Array:
    """Evaluate an isotropic Gaussian log-density in the plane, f32[...] per square metre.

        log N(ν; 0, s I₂) = −|ν|² / 2s − log 2πs

    Of an offset ν in metres, and s > 0, square metres per axis, f32[...] each.
    """
    squared = offset_x * offset_x + offset_y * offset_y
    return -0.5 * squared / variance - jnp.log(2.0 * jnp.pi * variance)
