"""Batching helpers for fast XLA programs on CPU; the mathematics elsewhere is for one item.

The engine runs the same few hundred small loops for every particle of every batch member and step.
XLA on CPU is good at long elementwise loops and at little else, so what counts is which axis is
last, what is computed again, and how many loops there are to compile: 70 % of the compilation of a
cycle is spent loop by loop. ``benchmarks/batching.py`` measures each trick against plain JAX; one
that no longer pays there is to be deleted, with its callers made plain.

*Batch axes last* (``append_axes``, ``prepend_axes``, ``insert_axes``). What runs for every particle
is written for one, with its own axes leading, and takes any batch axes behind them. ``vmap`` moves
the batch axis to the front of most results, where loops over nine entries are not vectorised.

*Rows and short tables* (``select_row``, ``lookup``). ``leaf[index]`` allows for negative indices,
at five operations to trace for two; a gather from a short table goes entry by entry and puts the
batch axes in another order, where selects are one vectorised loop.

*Materialization* (``materialize``). Cheap operations are fused into each of their readers, so a
chain of steps with many readers is computed, and compiled, many times over. Optimisation barriers
are dropped before fusion; a conditional is not crossed.

*One table for a record* (``pack``, ``unpack``, ``take``). Leaf by leaf, a gather of particles picks
numbers one by one; from one table it copies whole particles.

*One draw for several keys* (``uniforms``). Each use of JAX's generator becomes loops of its own: 25
uses took 15 of 68 CPU seconds of compilation (``benchmarks/NOTES.md``).
"""

import math
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_batching import custom_vmap

T = TypeVar("T")


def append_axes(values: Array, ndim: int) -> Array:
    """Append axes of length one to [n, ...], up to ``ndim``: the same for the whole batch."""
    return values.reshape(values.shape + (1,) * (ndim - values.ndim))


def prepend_axes(values: Array, ndim: int) -> Array:
    """Prepend axes of length one to [..., P], up to ``ndim``: the same for every entry."""
    return values.reshape((1,) * (ndim - values.ndim) + values.shape)


def insert_axes(values: Array, ndim: int) -> Array:
    """Insert axes of length one after the first of [n, ..., P], up to ``ndim``."""
    return values.reshape(values.shape[0], *(1,) * (ndim - values.ndim), *values.shape[1:])


def select_row(records: T, index: Array) -> T:
    """Take one row of every leaf, in fewer operations than ``leaf[index]``, which may be negative.

    Of leaves [n, ...] those [...] at i32[] from 0 to n − 1, or the nearest of these.
    """

    def row(leaf: Array) -> Array:
        start, sizes = (index, *(0,) * (leaf.ndim - 1)), (1, *leaf.shape[1:])
        block = jax.lax.dynamic_slice(leaf, start, sizes, allow_negative_indices=False)
        return jax.lax.squeeze(block, (0,))

    return jax.tree.map(row, records)


def lookup(values: Array, index: Array) -> Array:
    """Look up a short table by selects: a gather would put the batch axes in another order.

    Args:
        values: [n, ...], a table, or one for each member of the batch.
        index: i32[...].

    Returns:
        [...], ``values[index]``; 0 where the index is out of bounds.
    """
    size = values.shape[0]
    table = jnp.broadcast_to(insert_axes(values, index.ndim + 1), (size, *index.shape))
    rows = *jnp.unstack(table), jnp.zeros(index.shape, values.dtype)
    clipped = jnp.minimum(index.astype(jnp.uint32), size).astype(jnp.int32)  # −1 is very large
    # One operation to trace; it becomes a tree of selects.
    return jax.lax.select_n(clipped, *rows)


def materialize(values: T) -> T:
    """Materialize arrays, so that no reader recomputes them; derivatives pass in both modes.

    Under ``vmap`` they are kept for the whole batch.
    """
    return _materialize(values)


def skip_unless_any(
    is_needed: Array, evaluate: Callable[[T], Array], records: T, default: Array
) -> Array:
    """Call ``evaluate`` only if any batch member needs it, also under ``vmap``.

    Args:
        is_needed: bool[...], by batch member.
        evaluate: computes f32[n, ...] from ``records``.
        records: leaves of any shapes.
        default: f32[n, ...], the result of members that do not need it.
    """
    dtypes = dict.fromkeys(leaf.dtype for leaf in jax.tree.leaves(records))

    # The index, always 0, enters all that is read, or XLA would hoist what it can.
    def body(index: Array, result: Array) -> Array:
        zero = {dtype: index.astype(dtype) for dtype in dtypes}
        needed = evaluate(jax.tree.map(lambda leaf: leaf + zero[leaf.dtype], records))
        return jnp.where(is_needed[None], needed, result)

    num_rounds = jnp.any(is_needed).astype(jnp.int32)
    return jax.lax.fori_loop(0, num_rounds, body, default)


@jax.custom_jvp
def _materialize(values: Any) -> Any:
    return _barrier(values)


@_materialize.defjvp
def _materialize_jvp(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    return _materialize(*primals), *tangents


@custom_vmap
def _barrier(values: Any) -> Any:
    return jax.lax.platform_dependent(values, cpu=_conditionally, default=lambda same: same)


@_barrier.def_vmap
def _keep_batch(axis_size: int, in_batched: list[Any], values: Any) -> tuple[Any, Any]:
    return _barrier(values), in_batched[0]


def _conditionally(values: Any) -> Any:
    """Pass values through a conditional whose condition holds, which the compiler cannot know."""
    first = jax.tree.leaves(values)[0].reshape(-1)[0].astype(jnp.float32)
    return jax.lax.cond(
        (first < jnp.inf) | ~(first < jnp.inf),
        lambda same: same,
        lambda same: jax.tree.map(jnp.zeros_like, same),
        values,
    )


def take(particles: T, ancestors: Array) -> T:
    """Copy the ancestors' particles i32[P]: all leaves as rows of one table, in one gather.

    The table is of floats, so gradients pass; leaves [..., P] are f32, bool, or integers below 2²⁴,
    which floats hold exactly.
    """
    return unpack(pack(particles)[:, ancestors], particles)


def pack(particles: Any) -> Array:
    """Pack records into one table, f32[rows, P], from leaves [..., P] exact in float32."""
    leaves = jax.tree.leaves(particles)
    return jnp.concatenate([x.astype(jnp.float32).reshape(-1, x.shape[-1]) for x in leaves])


def unpack(table: Array, template: T) -> T:
    """Unpack records from a table, f32[rows, n], of ``pack``, with any selection of columns.

    ``template``: the packed records, or others of their shapes and types, leaves [..., P]; leaves
    of the result are [..., n].
    """
    leaves, tree = jax.tree.flatten(template)
    unpacked, start = [], 0
    for leaf in leaves:
        size = math.prod(leaf.shape[:-1])
        part = jax.lax.slice_in_dim(table, start, start + size)
        unpacked.append(part.reshape(*leaf.shape[:-1], table.shape[-1]).astype(leaf.dtype))
        start += size
    return jax.tree.unflatten(tree, unpacked)


def uniforms(keys: Array, size: int) -> Array:
    """Draw uniform numbers for each key[n]: rows as ``jax.random.uniform(key, (size,))``.

    The first numbers do not depend on ``size`` (``jax_threefry_partitionable``, JAX's default), so
    keys that need fewer share the draw of the one that needs most.
    """
    # Flat: LLVM unrolls short loops over a second axis, to many times the code.
    return jax.vmap(lambda key: jax.random.uniform(key, (size,)))(keys)


def to_interval(uniform: Array, low: float, high: float) -> Array:
    """Scale uniform numbers in [0, 1) to [low, high), as ``jax.random.uniform`` does."""
    lower, upper = np.float32(low), np.float32(high)
    return jnp.maximum(lower, uniform * (upper - lower) + lower)


def normal(uniform: Array) -> Array:
    """Transform uniform numbers in [0, 1) to standard normals, as ``jax.random.normal`` does."""
    low = np.nextafter(np.float32(-1.0), np.float32(0.0))
    return np.float32(np.sqrt(2)) * jax.lax.erf_inv(to_interval(uniform, float(low), 1.0))
