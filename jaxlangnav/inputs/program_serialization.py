"""Serialization of compiled programs to bytes, without pickle.

    SHA-256 of the remaining bytes, in hexadecimal
    {"name": the program's key, "result": the structure of its results}
    executable serialized by XLA: machine code

Nothing is parsed or passed to XLA before the digest is verified: XLA aborts the process on some
bytes and runs others. The digest detects damage and is no signature: only the user may have written
the file (``atomic_files``). JAX's own ``serialize_executable`` uses pickle.
"""

import contextlib
import hashlib
import json
import threading
from collections.abc import Callable, Hashable, Iterator
from dataclasses import fields
from typing import Any

import jax
import jax.numpy as jnp

from jaxlangnav.pytree import RECORDS, strong_types

Call = Callable[[list[Any]], Any]
"""Takes a program's flat arguments, returns the function's result."""
_bypass_lock = threading.Lock()
_num_bypassing, _saved_min_seconds = 0, 0.0
"""Number of threads that bypass JAX's cache, and the setting that the last one restores."""


def compile_program(
    flat: Callable[..., Any], leaves: list[Any], *, name: str
) -> tuple[Call, bytes | None]:
    """Compile a function of flat arguments.

    Args:
        flat: takes arrays, returns a pytree; no leaf of the program's result is weakly typed.
        leaves: arguments of the shapes and types to compile for.
        name: key of the program.

    Returns:
        The program, and its serialized bytes. None if it is not serializable: it calls functions
        of this process (LAPACK, Python callbacks), or returns something other than records,
        tuples, lists and dictionaries of arrays.
    """
    structures: list[tuple[Any, list[Hashable]]] = []

    def flat_results(*values: Any) -> list[Any]:
        outputs, tree = jax.tree.flatten(strong_types(flat(*values)))
        # Empty for numbers; for a PRNG key, the name of its implementation.
        key_impls: list[Hashable] = [
            jax.random.key_impl(leaf) if _is_key(leaf) else "" for leaf in outputs
        ]
        structures.append((tree, key_impls))
        return outputs

    # A serialized program takes every argument, used or not.
    lowered = jax.jit(flat_results, keep_unused=True).lower(*leaves)
    with _bypass_jax_cache():
        compiled = lowered.compile()
    tree, key_impls = structures[0]

    def call(values: list[Any]) -> Any:
        return jax.tree.unflatten(tree, compiled(*values))

    executable = compiled.runtime_executable()
    if executable is None or "custom_call" in lowered.as_text():
        return call, None
    try:
        result = _describe(jax.tree.unflatten(tree, key_impls))
    except TypeError:
        return call, None
    header = json.dumps({"name": name, "result": result}).encode()
    body = header + b"\n" + executable.serialize()
    return call, hashlib.sha256(body).hexdigest().encode() + b"\n" + body


def load_program(content: bytes, *, name: str) -> Call:
    """Load a program from the bytes of ``compile_program``.

    Args:
        content: bytes, which only the user may have written.
        name: key of the expected program.

    Raises:
        ValueError: the bytes are damaged, or another program's.
    """
    digest, _, body = content.partition(b"\n")
    if digest != hashlib.sha256(body).hexdigest().encode():
        raise ValueError("is damaged")
    header, _, payload = body.partition(b"\n")
    metadata = json.loads(header)
    if metadata["name"] != name:
        raise ValueError("is another program's")
    device = jax.devices()[0]
    executable = device.client.deserialize_executable(payload, (device,))

    def call(values: list[Any]) -> Any:
        results = executable.execute_sharded([_to_device(value) for value in values])
        arrays = (array for (array,) in results.disassemble_into_single_device_arrays())
        return _build(metadata["result"], arrays)

    return call


def _to_device(value: Any) -> jax.Array:
    """Convert an argument for XLA: an array on the device, a PRNG key as its data."""
    if _is_key(value):
        return jax.random.key_data(value)
    return value if isinstance(value, jax.Array) else jax.device_put(value)


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(jax.typeof(leaf).dtype, jax.dtypes.prng_key)


def _describe(node: Any) -> Any:
    """Describe a result's structure: leaves (key implementations) as is, nodes as [name, parts]."""
    if node is None or isinstance(node, str):
        return node
    name = f"{type(node).__module__}.{type(node).__qualname__}"
    if type(node) in (tuple, list):
        return [name, [_describe(item) for item in node]]
    if type(node) is dict and all(isinstance(key, str) for key in node):
        # In JAX's order of leaves.
        return [name, {key: _describe(node[key]) for key in sorted(node)}]
    record: Any = RECORDS.get(name)
    if record is not type(node):
        raise TypeError(f"{name} has no form in a file")
    return [name, {item.name: _describe(getattr(node, item.name)) for item in fields(record)}]


def _build(node: Any, arrays: Iterator[jax.Array]) -> Any:
    """Build a result from its description and the arrays in its leaves."""
    if node is None:
        return None
    if isinstance(node, str):
        return jax.random.wrap_key_data(next(arrays), impl=node) if node else next(arrays)
    name, parts = node
    if isinstance(parts, list):
        values = [_build(part, arrays) for part in parts]
        return tuple(values) if name == "builtins.tuple" else values
    named = {key: _build(part, arrays) for key, part in parts.items()}
    return named if name == "builtins.dict" else RECORDS[name](**named)


@contextlib.contextmanager
def _bypass_jax_cache() -> Iterator[None]:
    """Context in which compiled programs are not written to JAX's own cache."""
    # A CPU program loaded from JAX's cache serializes without its functions (JAX 0.10).
    global _num_bypassing, _saved_min_seconds
    name = "jax_persistent_cache_min_compile_time_secs"
    with _bypass_lock:
        if _num_bypassing == 0:
            _saved_min_seconds = getattr(jax.config, name)
            jax.config.update(name, float("inf"))
        _num_bypassing += 1
    try:
        yield
    finally:
        with _bypass_lock:
            _num_bypassing -= 1
            if _num_bypassing == 0:
                jax.config.update(name, _saved_min_seconds)
