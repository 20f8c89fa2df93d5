"""Resampling and the effective sample size (section 3.2, last paragraph)."""

import math
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

Record = TypeVar("Record")


def effective_sample_size(weight: Array) -> Array:
    """Count how many equal particles the weights are worth: 1 / Σ wᵢ².

    Limits: P for equal weights, 1 for a single survivor.

    Args:
        weight: f32[P], normalised.

    Returns:
        f32[].
    """
    return 1.0 / jnp.sum(weight * weight)


def systematic(weight: Array, uniform: Array) -> Array:
    """Choose ancestors so that particle i has P wᵢ offspring to within one.

    Args:
        weight: f32[P], normalised.
        uniform: f32[], in [0, 1).

    Returns:
        i32[P], ancestor of each slot, in ascending order.
    """
    size = weight.shape[0]
    cumulative = jnp.cumsum(weight)
    cumulative = cumulative / cumulative[-1]
    # Number of comb teeth at or below each cumulative weight. Tooth j belongs to the particle
    # after all those that end at or before it: a histogram and its running sum, linear in P.
    teeth = jnp.clip(jnp.ceil(cumulative * size - uniform), 0, size).astype(jnp.int32)
    ending = jnp.zeros(size + 1, jnp.int32).at[teeth].add(1)
    return jnp.minimum(jnp.cumsum(ending[:size]), size - 1)


def independent(weight: Array, uniform: Array) -> Array:
    """Choose an ancestor for each slot by a draw of its own.

    Args:
        weight: f32[P], in proportion to the probabilities.
        uniform: f32[P], in [0, 1).

    Returns:
        i32[P], ancestors.
    """
    cumulative = jnp.cumsum(weight)
    # A binary search: comparing all with all is quadratic in P.
    ancestors = jnp.searchsorted(cumulative, uniform * cumulative[-1], side="right")
    return jnp.minimum(ancestors, weight.shape[0] - 1).astype(jnp.int32)


def take(particles: Record, ancestors: Array) -> Record:
    """Copy the ancestors' particles: all leaves as rows of one table, in one gather.

    Leaf by leaf, XLA on CPU either picks numbers one by one or turns every leaf around so that a
    particle lies in one piece, and the whole filter step then reads it with strides. From one
    table a gather copies whole particles, at a fifth of the cost.

    The table is of floats, so that gradients pass through it.

    Args:
        particles: leaves [..., P] of f32, bool, or integers below 2²⁴, which floats hold exactly.
        ancestors: i32[P].

    Returns:
        The same records, leaves [..., P].
    """
    return unpack(pack(particles)[:, ancestors], particles)


def pack(particles: Any) -> Array:
    """Write records as one table, f32[rows, P], from leaves [..., P] as ``take`` can hold them."""
    leaves = jax.tree.leaves(particles)
    return jnp.concatenate(
        [leaf.astype(jnp.float32).reshape(-1, leaf.shape[-1]) for leaf in leaves]
    )


def unpack(table: Array, form: Record) -> Record:
    """Read records from a table, f32[rows, n], that ``pack`` has written and columns picked from.

    Args:
        table: of ``pack``.
        form: the records that were packed, or others of their shapes and types; [..., P].

    Returns:
        Leaves [..., n].
    """
    leaves, tree = jax.tree.flatten(form)
    taken, start = [], 0
    for leaf in leaves:
        size = math.prod(leaf.shape[:-1])
        own = jax.lax.slice_in_dim(table, start, start + size)
        taken.append(own.reshape(*leaf.shape[:-1], table.shape[-1]).astype(leaf.dtype))
        start += size
    return jax.tree.unflatten(tree, taken)
