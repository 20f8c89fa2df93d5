"""The one decorator behind every public record.

A record is a frozen, keyword-only dataclass that JAX knows as a pytree: its fields are
leaves (arrays or further records) unless marked ``static``, which makes them part of the
tree structure (hashable, compared at trace time).
"""

import dataclasses
from typing import Any, TypeVar, dataclass_transform

import jax

T = TypeVar("T")


def static(**kwargs: Any) -> Any:
    """Mark a dataclass field as static: hashable metadata, no leaf; changing it recompiles."""
    return dataclasses.field(metadata={"static": True}, **kwargs)


@dataclass_transform(
    kw_only_default=True, frozen_default=True, field_specifiers=(static, dataclasses.field)
)
def pytree(cls: type[T]) -> type[T]:
    """Turn a class of annotated fields into a frozen, keyword-only, JAX-registered dataclass.

    Args:
        cls: class with annotated fields; ``static()`` fields become metadata.

    Returns:
        The class, registered with ``jax.tree_util.register_dataclass``.
    """
    record: Any = dataclasses.dataclass(frozen=True, kw_only=True)(cls)
    data, meta = [], []
    for field in dataclasses.fields(record):
        (meta if field.metadata.get("static", False) else data).append(field.name)
    jax.tree_util.register_dataclass(record, data_fields=data, meta_fields=meta)
    return record


def replace(record: T, **changes: Any) -> T:
    """Copy a record with some fields changed (a typed ``dataclasses.replace``)."""
    source: Any = record  # a record is a dataclass, which the type T cannot say
    return dataclasses.replace(source, **changes)
