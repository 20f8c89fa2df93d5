"""The one decorator behind every public record.

A record is a frozen, keyword-only dataclass that JAX knows as a pytree: its fields are
leaves (arrays or further records) unless marked ``static``, which makes them part of the
tree structure (hashable, compared at trace time).
"""

import dataclasses
from typing import Any, TypeVar, dataclass_transform

import jax
import jax.numpy as jnp

_T = TypeVar("_T")
RECORDS: dict[str, type] = {}
"""Every record whose fields are all leaves, by its module and name: what a file may name."""


def static(**kwargs: Any) -> Any:
    """Mark a dataclass field as static: hashable metadata, no leaf; changing it recompiles."""
    return dataclasses.field(metadata={"static": True}, **kwargs)


def field(help: str, *, default: float | None = None) -> Any:
    """Describe a parameter: what it is and in which unit (the command line's help), its default.

    Args:
        help: one sentence; units first where it is a quantity.
        default: a float is that of a scalar f32[], an int stays one; None: there is no default.

    Returns:
        The field.
    """
    given: dict[str, Any] = {} if default is None else {"default": default}
    if isinstance(default, float):  # built when it is asked for: an import touches no device
        given = {"default_factory": lambda: jnp.float32(default)}
    return dataclasses.field(metadata={"help": help}, **given)


@dataclass_transform(
    kw_only_default=True, frozen_default=True, field_specifiers=(static, field, dataclasses.field)
)
def pytree(cls: type[_T]) -> type[_T]:
    """Turn a class of annotated fields into a frozen, keyword-only, JAX-registered dataclass.

    Args:
        cls: class with annotated fields; ``static()`` fields become metadata.

    Returns:
        The class, registered with ``jax.tree_util.register_dataclass``.
    """
    record: Any = dataclasses.dataclass(frozen=True, kw_only=True)(cls)
    data, meta = [], []
    for one in dataclasses.fields(record):
        (meta if one.metadata.get("static", False) else data).append(one.name)
    jax.tree_util.register_dataclass(record, data_fields=data, meta_fields=meta)
    if not meta:
        RECORDS[f"{record.__module__}.{record.__qualname__}"] = record
    return record


def replace(record: _T, **changes: Any) -> _T:
    """Copy a record with some fields changed (a typed ``dataclasses.replace``)."""
    source: Any = record  # a record is a dataclass, which the type T cannot say
    return dataclasses.replace(source, **changes)


def strong(tree: _T) -> _T:
    """Give every leaf a type of its own: arrays made of Python's numbers have a weak one.

    JAX compiles a function anew for weakly typed arrays (``jnp.full(8, 2.0)``), though they hold
    the same numbers.

    Args:
        tree: any pytree of arrays and numbers.

    Returns:
        The same values, none of them weakly typed; typed keys as they are.
    """

    def harden(leaf: Any) -> jax.Array:
        value = jnp.asarray(leaf)
        is_key = jnp.issubdtype(value.dtype, jax.dtypes.prng_key)
        return value if is_key else jnp.asarray(value, value.dtype)

    return jax.tree.map(harden, tree)
