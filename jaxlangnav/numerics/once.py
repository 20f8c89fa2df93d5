"""Values worked out once and kept, instead of anew wherever they are read.

XLA on CPU fuses cheap operations into each of their readers. What many later loops read, the
grounding of the detections say, is then worked out in each of them again, for each entry of their
results: a chain of such steps costs many times what it does, and takes as many times longer to
compile. Optimisation barriers do not help, for they are dropped before it fuses; a conditional is
what it does not cross.
"""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

T = TypeVar("T")


def once(values: T) -> T:
    """Have values worked out once: the same values, and derivatives go through in both modes.

    Args:
        values: arrays; under ``vmap`` they are kept for the whole batch.

    Returns:
        The same values.
    """
    return _once(values)


@jax.custom_jvp
def _once(values: Any) -> Any:
    return _keep(values)


@_once.defjvp
def _once_jvp(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    return _once(*primals), *tangents


@custom_vmap
def _keep(values: Any) -> Any:
    return jax.lax.platform_dependent(values, cpu=_conditionally, default=lambda same: same)


@_keep.def_vmap
def _keep_batch(axis_size: int, in_batched: list[Any], values: Any) -> tuple[Any, Any]:
    del axis_size
    return _keep(values), in_batched[0]


def _conditionally(values: Any) -> Any:
    """Pass values through a conditional whose condition holds, which the compiler cannot know."""
    first = jax.tree.leaves(values)[0].reshape(-1)[0].astype(jnp.float32)
    return jax.lax.cond(
        (first < jnp.inf) | ~(first < jnp.inf),
        lambda same: same,
        lambda same: jax.tree.map(jnp.zeros_like, same),
        values,
    )
