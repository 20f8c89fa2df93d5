"""Random numbers for several keys at once.

Each use of JAX's generator becomes loops of its own in XLA on CPU: 25 uses took 15 of 68 CPU
seconds of compilation (``benchmarks/NOTES.md``). Keys share one here; each gives the numbers that
it would give alone.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array


def uniforms(keys: Array, size: int) -> Array:
    """Draw from the unit interval for each key.

    Args:
        keys: key[n].
        size: how many numbers. The first ones do not depend on it (``jax_threefry_partitionable``,
            JAX's default), so keys that need fewer share the draw of the one that needs most.

    Returns:
        f32[n, size], each row as ``jax.random.uniform(key, (size,))``.
    """
    # Flat: LLVM unrolls short loops over a second axis, to many times the code.
    return jax.vmap(lambda key: jax.random.uniform(key, (size,)))(keys)


def between(uniform: Array, low: float, high: float) -> Array:
    """Stretch numbers of the unit interval to [low, high), as ``jax.random.uniform`` does."""
    least, most = np.float32(low), np.float32(high)
    return jnp.maximum(least, uniform * (most - least) + least)


def normal(uniform: Array) -> Array:
    """Turn numbers of the unit interval into normal ones, as ``jax.random.normal`` does."""
    low = np.nextafter(np.float32(-1.0), np.float32(0.0))
    return np.float32(np.sqrt(2)) * jax.lax.erf_inv(between(uniform, float(low), 1.0))
