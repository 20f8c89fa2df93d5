"""Batch axes last: one equation for one particle and for all of them.

What runs for every particle at every step is written for one particle, with its own axes leading,
and takes any batch axes behind them. ``vmap`` would batch it as well, but moves the batch axis to
the front of most results, where XLA on CPU does not vectorise loops over nine entries: written
like this the filter takes about a third of the time.
"""

from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import Array

T = TypeVar("T")


def column(values: Array, ndim: int) -> Array:
    """Append axes of length one: values along the first axes, the same for the whole batch.

    Args:
        values: [n, ...].
        ndim: axes wanted.

    Returns:
        [n, ..., 1, 1] with ``ndim`` axes.
    """
    return values.reshape(values.shape + (1,) * (ndim - values.ndim))


def lead(values: Array, ndim: int) -> Array:
    """Prepend axes of length one: values along the batch axes, the same for every entry.

    Args:
        values: [..., P].
        ndim: axes wanted.

    Returns:
        [1, 1, ..., P] with ``ndim`` axes.
    """
    return values.reshape((1,) * (ndim - values.ndim) + values.shape)


def apart(values: Array, ndim: int) -> Array:
    """Put axes of length one behind the first: every row of values beside all of something.

    Args:
        values: [n, ..., P].
        ndim: axes wanted.

    Returns:
        [n, 1, 1, ..., P] with ``ndim`` axes.
    """
    return values.reshape(values.shape[0], *(1,) * (ndim - values.ndim), *values.shape[1:])


def row_of(records: T, index: Array) -> T:
    """Take one row of every leaf, in fewer operations than ``leaf[index]``, which may be negative.

    Args:
        records: leaves [n, ...].
        index: i32[], from 0 to n − 1; the nearest of these is taken otherwise.

    Returns:
        Leaves [...].
    """
    return jax.tree.map(
        lambda leaf: jax.lax.dynamic_index_in_dim(
            leaf, index, keepdims=False, allow_negative_indices=False
        ),
        records,
    )


def pick(values: Array, index: Array) -> Array:
    """Look up a short table by selects: a gather would put the batch axes in another order.

    Args:
        values: [n, ...], a table, or one for each member of the batch.
        index: i32[...].

    Returns:
        [...], ``values[index]``; 0 where the index is out of bounds.
    """
    size = values.shape[0]
    nothing = jnp.zeros(values.shape[1:], values.dtype)
    rows = [jnp.broadcast_to(row, index.shape) for row in (*jnp.unstack(values), nothing)]
    within = jnp.minimum(index.astype(jnp.uint32), size).astype(jnp.int32)  # −1 is very large
    # One operation to trace; it becomes a tree of selects.
    return jax.lax.select_n(within, *rows)
