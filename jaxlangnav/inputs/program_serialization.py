"""A compiled program as bytes, and back, without a pickle.

    SHA-256 of all that follows, in hexadecimal
    {"name": which program it is, "result": the structure of what it returns}
    what XLA makes of the program: machine code

Nothing is parsed, let alone handed to XLA, before the digest is right: XLA ends the process on some
bytes and runs others. The digest guards against accidents and is no signature: nobody but the user
may have made the file (``whole_files``). JAX's own ``serialize_executable`` makes a pickle.
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

from jaxlangnav.pytree import RECORDS, strong

Call = Callable[[list[Any]], Any]
"""Takes the flat arguments of a program, returns what its function returns."""
_outside = threading.Lock()
_num_outside, _least_seconds = 0, 0.0
"""How many threads compile outside of JAX's cache, and the setting that the last one restores."""


def compile_program(
    flat: Callable[..., Any], leaves: list[Any], *, name: str
) -> tuple[Call, bytes | None]:
    """Compile a function of flat arguments.

    Args:
        flat: takes arrays, returns a pytree; no leaf of what the program returns is weakly typed.
        leaves: arguments of the shapes and types to compile for.
        name: under which the program is looked for.

    Returns:
        The program, and the bytes to keep it by. No bytes if it has none: it calls what only this
        process has (LAPACK's functions, Python's), or returns something other than records,
        tuples, lists and dictionaries of arrays.
    """
    shapes: list[tuple[Any, list[Hashable]]] = []

    def listed(*values: Any) -> list[Any]:
        found, tree = jax.tree.flatten(strong(flat(*values)))
        # Empty for numbers, for a key its generator, which has a name.
        kinds: list[Hashable] = [
            jax.random.key_impl(leaf) if _is_key(leaf) else "" for leaf in found
        ]
        shapes.append((tree, kinds))
        return found

    # A program in a file takes every argument, used or not.
    lowered = jax.jit(listed, keep_unused=True).lower(*leaves)
    with _outside_of_the_cache():
        compiled = lowered.compile()
    tree, kinds = shapes[0]

    def call(values: list[Any]) -> Any:
        return jax.tree.unflatten(tree, compiled(*values))

    executable = compiled.runtime_executable()
    if executable is None or "custom_call" in lowered.as_text():
        return call, None
    try:
        result = _describe(jax.tree.unflatten(tree, kinds))
    except TypeError:
        return call, None
    header = json.dumps({"name": name, "result": result}).encode()
    body = header + b"\n" + executable.serialize()
    return call, hashlib.sha256(body).hexdigest().encode() + b"\n" + body


def load_program(content: bytes, *, name: str) -> Call:
    """Load what ``compile_program`` gave.

    Args:
        content: bytes that come from nobody but the user.
        name: of the program that is looked for.

    Raises:
        ValueError: the bytes are damaged, or another program's.
    """
    digest, _, body = content.partition(b"\n")
    if digest != hashlib.sha256(body).hexdigest().encode():
        raise ValueError("is damaged")
    header, _, payload = body.partition(b"\n")
    about = json.loads(header)
    if about["name"] != name:
        raise ValueError("is another program's")
    device = jax.devices()[0]
    executable = device.client.deserialize_executable(payload, (device,))

    def call(values: list[Any]) -> Any:
        results = executable.execute_sharded([_plain(value) for value in values])
        arrays = (one for (one,) in results.disassemble_into_single_device_arrays())
        return _build(about["result"], arrays)

    return call


def _plain(value: Any) -> jax.Array:
    """Turn an argument into what XLA takes: an array on the device, a key as its numbers."""
    if _is_key(value):
        return jax.random.key_data(value)
    return value if isinstance(value, jax.Array) else jax.device_put(value)


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(jax.typeof(leaf).dtype, jax.dtypes.prng_key)


def _describe(node: Any) -> Any:
    """Describe a result whose leaves are kinds: a leaf as it is, the rest as [name, parts]."""
    if node is None or isinstance(node, str):
        return node
    name = f"{type(node).__module__}.{type(node).__qualname__}"
    if type(node) in (tuple, list):
        return [name, [_describe(one) for one in node]]
    if type(node) is dict and all(isinstance(key, str) for key in node):
        # In JAX's order of leaves.
        return [name, {key: _describe(node[key]) for key in sorted(node)}]
    record: Any = RECORDS.get(name)
    if record is not type(node):
        raise TypeError(f"{name} has no form in a file")
    return [name, {one.name: _describe(getattr(node, one.name)) for one in fields(record)}]


def _build(node: Any, arrays: Iterator[jax.Array]) -> Any:
    """Build a result from its description and the arrays in its leaves."""
    if node is None:
        return None
    if isinstance(node, str):
        return jax.random.wrap_key_data(next(arrays), impl=node) if node else next(arrays)
    name, parts = node
    if isinstance(parts, list):
        values = [_build(one, arrays) for one in parts]
        return tuple(values) if name == "builtins.tuple" else values
    named = {key: _build(one, arrays) for key, one in parts.items()}
    return named if name == "builtins.dict" else RECORDS[name](**named)


@contextlib.contextmanager
def _outside_of_the_cache() -> Iterator[None]:
    """Have JAX's own cache take nothing of what is compiled inside."""
    # A CPU program that JAX has loaded from its cache is written without its functions (JAX 0.10).
    global _num_outside, _least_seconds
    name = "jax_persistent_cache_min_compile_time_secs"
    with _outside:
        if _num_outside == 0:
            _least_seconds = getattr(jax.config, name)
            jax.config.update(name, float("inf"))
        _num_outside += 1
    try:
        yield
    finally:
        with _outside:
            _num_outside -= 1
            if _num_outside == 0:
                jax.config.update(name, _least_seconds)
