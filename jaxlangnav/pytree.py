"""The ``pytree`` decorator of all records.

A record is a frozen, keyword-only dataclass registered as a JAX pytree: its fields are
leaves (arrays or further records) unless marked ``static``, which makes them part of the
tree structure (hashable, compared at trace time).
"""

import dataclasses
from typing import Any, TypeVar, dataclass_transform

import jax
import jax.numpy as jnp

_T = TypeVar("_T")
RECORDS: dict[str, type] = {}
"""Records without static fields by qualified name, for serialization."""


def static(**kwargs: Any) -> Any:
    """Declare a static dataclass field: hashable metadata, not a leaf; changing it recompiles."""
    return dataclasses.field(metadata={"static": True}, **kwargs)


def field(help: str, *, default: float | None = None) -> Any:
    """Declare a parameter with its description and unit (the command line's help) and default.

    Args:
        help: one sentence; units first where it is a quantity.
        default: a float is that of a scalar f32[], an int stays one; None: there is no default.

    Returns:
        The field.
    """
    kwargs: dict[str, Any] = {} if default is None else {"default": default}
    if isinstance(default, float):  # built lazily: an import touches no device
        kwargs = {"default_factory": lambda: jnp.float32(default)}
    return dataclasses.field(metadata={"help": help}, **kwargs)


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
    for item in dataclasses.fields(record):
        (meta if item.metadata.get("static", False) else data).append(item.name)
    jax.tree_util.register_dataclass(record, data_fields=data, meta_fields=meta)
    if not meta:
        RECORDS[f"{record.__module__}.{record.__qualname__}"] = record
    return record


def replace(record: _T, **changes: Any) -> _T:
    """Copy a record with some fields replaced (a typed ``dataclasses.replace``)."""
    source: Any = record  # a record is a dataclass, which the type T cannot say
    return dataclasses.replace(source, **changes)


def strong_types(tree: _T) -> _T:
    """Convert all leaves to strongly typed arrays.

    JAX recompiles a function for weakly typed arrays (``jnp.full(8, 2.0)``), even with the same
    values.

    Args:
        tree: any pytree of arrays and numbers.

    Returns:
        The same values without weak types; PRNG keys are unchanged.
    """

    def convert(leaf: Any) -> jax.Array:
        value = jnp.asarray(leaf)
        is_key = jnp.issubdtype(value.dtype, jax.dtypes.prng_key)
        return value if is_key else jnp.asarray(value, value.dtype)

    return jax.tree.map(convert, tree)
