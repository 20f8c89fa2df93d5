"""Sets of objects as bit masks over lanes: the arithmetic under behavior inference (section 3.3).

Two lane axes stand last, episodes E and particles P; N is the axis before them.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array


def iota(size: int, ndim: int) -> np.ndarray:
    """Count along the axis before the two lane axes, i32[1, ..., size, 1, 1], known when traced."""
    return np.arange(size, dtype=np.int32).reshape(*(1,) * (ndim - 3), size, 1, 1)


def bit_of_each(size: int, ndim: int) -> np.ndarray:
    """List the bit of each object along that axis, i32[1, ..., size ≤ 31, 1, 1]."""
    return np.left_shift(np.int32(1), iota(size, ndim))


def is_in(mask: Array, size: int) -> Array:
    """Spread bit masks i32[..., E, P] to bool[..., size, E, P]."""
    return (mask[..., None, :, :] & bit_of_each(size, mask.ndim + 1)) != 0


def to_mask(flags: Array) -> Array:
    """Gather bool[..., N, E, P] to bit masks i32[..., E, P]."""
    return jnp.sum(jnp.where(flags, bit_of_each(flags.shape[-3], flags.ndim), 0), axis=-3)


def smallest(cost: Array, count: int) -> tuple[list[Array], list[Array]]:
    """Find the smallest of nonnegative costs f32[..., n ≤ 64, E, P] and where they stand.

    The index rides in the low bits of the number, so that one minimum finds both.
    """
    size = cost.shape[-3]
    low = (1 << (size - 1).bit_length()) - 1
    bits = jax.lax.bitcast_convert_type(cost, jnp.int32)
    packed = (bits & ~low) | iota(size, cost.ndim)
    least = jnp.min(packed, axis=-3)
    found = [least]
    for _ in range(count - 1):
        rest = jnp.where(packed > least[..., None, :, :], packed, jnp.iinfo(jnp.int32).max)
        least = jnp.min(rest, axis=-3)
        found.append(least)
    values = [jax.lax.bitcast_convert_type(each & ~low, jnp.float32) for each in found]
    return values, [each & low for each in found]


def pick_of_four(values: Array, index: Array) -> Array:
    """Read one of four: values i32[4, ..., E, P], index i32[m, ..., E, P] → i32[m, ..., E, P]."""
    high = index >= 2
    odd = (index & 1) == 1
    low_part = jnp.where(odd, values[1:2], values[0:1])
    return jnp.where(high, jnp.where(odd, values[3:4], values[2:3]), low_part)
