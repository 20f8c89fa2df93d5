"""Persistent cache of compiled programs: skips tracing and lowering as well as compilation.

JAX's own cache is keyed by a program's lowered text, so that it has to be traced and lowered first:
seconds for a decision cycle. Here the key is what determines that text: the source of this package,
versions of its dependencies, the machine, and the shapes and static values of a call. Loaded code
runs as the user: folder and files must be the user's own (``atomic_files``) and each file's digest
must match (``program_serialization``). On any failure the cache warns once, and the program is
compiled as usual.

Only pure functions may be cached: globals that they read must be constant.
"""

import contextlib
import functools
import hashlib
import os
import platform
import threading
import warnings
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import jax
import jax.core
import jaxlib.version

from jaxlangnav.inputs.atomic_files import read_user_file, user_folder, write_bytes
from jaxlangnav.inputs.program_serialization import Call, compile_program, load_program

P = ParamSpec("P")
R = TypeVar("R")
_MAX_PROGRAMS = 24
"""Limit of files, the least recently used of which are deleted; a cycle's has 5 MB."""
_MAX_BYTES = 1 << 28  # size limit of a program's file
_SUFFIX = ".program"
_SETTINGS = (
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_default_prng_impl",
    "jax_numpy_dtype_promotion",
    "jax_threefry_partitionable",
)
"""Settings of JAX that a program depends on."""
_BYPASS_SETTINGS = ("jax_debug_nans", "jax_debug_infs", "jax_disable_jit")
"""Settings of JAX under which the cache is bypassed."""
_folder: Path | None = None
_say: Callable[[str], None] | None = warnings.warn  # None once it has been called


def set_cache_dir(folder: Path | None, *, say: Callable[[str], None] = warnings.warn) -> None:
    """Set the folder of the program cache, for the rest of the process; None disables it.

    Args:
        folder: created if missing; private to the user.
        say: called with the one line that says what could not be loaded or stored, and why.

    Raises:
        OSError: the folder is another user's, others can enter or replace it, or it cannot be
            made; the cache is disabled.
    """
    global _folder, _say
    _folder, _say = None, say
    _folder = None if folder is None else user_folder(folder)


def _warn_once(text: str) -> None:
    global _say
    say, _say = _say, None
    if say is not None:
        say(text)


def cached_jit(
    *, static_argnames: tuple[str, ...] = ()
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Compile a function as ``jax.jit`` does, with a persistent cache (``set_cache_dir``).

    Args:
        static_argnames: keyword arguments that are part of the program, identified by ``repr``.
            With a value that is neither plain nor of this package, nothing is cached.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        jitted = jax.jit(function, static_argnames=static_argnames)
        original: Callable[..., R] = function
        programs: dict[str, Call] = {}
        lock = threading.Lock()

        @functools.wraps(jitted)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            folder = cache_dir()
            static = {name: kwargs[name] for name in static_argnames if name in kwargs}
            if folder is None or not _is_stable(tuple(static.values())):
                return jitted(*args, **kwargs)
            data = args, {name: kwargs[name] for name in kwargs if name not in static}
            leaves, tree = jax.tree.flatten(data)
            if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
                return jitted(*args, **kwargs)
            name = _cache_key(function, static, tree, leaves)

            def flat(*leaves: Any) -> Any:
                args, kwargs = jax.tree.unflatten(tree, leaves)
                return original(*args, **kwargs, **static)

            if name not in programs:
                with lock:  # concurrent callers wait for one compilation
                    if name not in programs:
                        path = folder / name
                        programs[name] = _load(path, leaves) or _compile(path, flat, leaves)
            return programs[name](leaves)

        return call

    return decorate


def cache_dir() -> Path | None:
    """Return the folder of the cache; None unless it is set and the only device is one CPU."""
    is_single_cpu = jax.default_backend() == "cpu" and jax.device_count() == 1
    is_bypassed = any(getattr(jax.config, name) for name in _BYPASS_SETTINGS)
    return _folder if is_single_cpu and not is_bypassed else None


def _is_stable(value: object) -> bool:
    """Tell whether ``repr`` identifies a static value: it is plain or of this package."""
    # It does not identify a custom policy, whose code may have changed.
    if isinstance(value, tuple):
        return all(map(_is_stable, value))
    if value is None or isinstance(value, str | int | float):
        return True
    if type(value).__module__.partition(".")[0] != __name__.partition(".")[0]:
        return False
    return is_dataclass(value) and all(_is_stable(getattr(value, f.name)) for f in fields(value))


def _cache_key(function: Callable[..., Any], static: Any, tree: Any, leaves: list[Any]) -> str:
    """Compute the file name of a program: a hash of everything that determines it."""
    avals = [jax.typeof(leaf) for leaf in leaves]
    parts = (
        # Environment of the call; JAX's settings can change between calls.
        *_fingerprint(),
        *(getattr(jax.config, name) for name in _SETTINGS),
        jax.config.read("jax_disable_most_optimizations"),
        os.environ.get("XLA_FLAGS", ""),
        function.__module__,
        function.__qualname__,
        static,
        tree,
        [(aval.shape, str(aval.dtype), getattr(aval, "weak_type", False)) for aval in avals],
    )
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:32] + _SUFFIX


@functools.cache
def _fingerprint() -> tuple[str, ...]:
    """Fingerprint this package's source, versions of its dependencies, and the machine."""
    digest = hashlib.sha256()
    package = Path(__file__).parent.parent
    for path in sorted(package.rglob("*")):
        if path.is_file() and path.suffix != ".pyc":
            digest.update(str(path.relative_to(package)).encode() + path.read_bytes())
    features = ""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
        features = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    versions = jax.__version__, jaxlib.version.__version__, platform.python_version()
    return digest.hexdigest(), *versions, platform.platform(), platform.processor(), features


def _load(path: Path, leaves: list[Any]) -> Call | None:
    """Load a cached program; None if it is missing or invalid."""
    try:
        call = load_program(read_user_file(path, max_bytes=_MAX_BYTES), name=path.name)
        # Run it once: XLA reports some faults only at run time.
        jax.block_until_ready(call(leaves))
        os.utime(path)
    except FileNotFoundError:
        return None
    except Exception as error:  # any fault of the file: it is written again
        reason = " ".join(str(error).removeprefix(f"{path}: ").split()) or type(error).__name__
        _warn_once(f"compiling anew what was kept in {path}: {reason}")
        return None
    return call


def _compile(path: Path, flat: Callable[..., Any], leaves: list[Any]) -> Call:
    """Compile a program of flat arguments, and store it if it is serializable."""
    call, content = compile_program(flat, leaves, name=path.name)
    if content is not None:
        try:
            write_bytes(content, path, is_private=True)
            # Least recently used files are deleted, maybe by another process at the same time.
            with contextlib.suppress(FileNotFoundError):
                cached = path.parent.glob(f"*{_SUFFIX}")
                for stale in sorted(cached, key=lambda file: file.stat().st_mtime)[:-_MAX_PROGRAMS]:
                    stale.unlink()
        except OSError as error:
            _warn_once(f"compiled programs are not kept: {error}")
    return call
