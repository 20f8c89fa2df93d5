"""Compiled programs kept in files: a later run neither traces nor lowers nor compiles them.

JAX's own cache keeps what has been compiled, but finds it by the program's text, which has to be
traced and lowered first: seconds for a decision cycle. Here a program is found by what the text
follows from: the source of this package, the versions below it, this machine, and the shapes and
static values of a call. What is loaded runs as the user: folder and files must be the user's own
(``whole_files``) and each file's digest right (``program_serialization``). Whatever does not pass
is said once and compiled as if nothing had been kept.

Only functions of their arguments alone may be kept: what they read of modules must be constant.
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

from jaxlangnav.inputs.program_serialization import Call, compile_program, load_program
from jaxlangnav.inputs.whole_files import own_folder, read_own_file, write_own_file

P = ParamSpec("P")
R = TypeVar("R")
_MAX_PROGRAMS = 24
"""Files that stay; the cycle's has 5 MB. Those used last are kept."""
_MAX_BYTES = 1 << 28
"""A larger file is no program of ours."""
_SUFFIX = ".program"
_SETTINGS = (
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_default_prng_impl",
    "jax_numpy_dtype_promotion",
    "jax_threefry_partitionable",
)
"""What a program depends on of JAX's settings."""
_WATCHING = ("jax_debug_nans", "jax_debug_infs", "jax_disable_jit")
"""Settings under which JAX must run a program itself."""
_folder: Path | None = None
_say: Callable[[str], None] = warnings.warn
_has_said = False


def set_cache_dir(folder: Path | None, *, say: Callable[[str], None] = warnings.warn) -> None:
    """Name the folder of kept programs, for the rest of the process; None keeps none.

    Args:
        folder: existing or not; made, closed to others.
        say: takes the one line that tells what could not be used or kept, and why.

    Raises:
        OSError: the folder is another user's, others can enter or exchange it, or it cannot be
            made; no programs are kept.
    """
    global _folder, _say, _has_said
    _folder, _say, _has_said = None, say, False
    _folder = None if folder is None else own_folder(folder)


def _tell_once(text: str) -> None:
    global _has_said
    if not _has_said:
        _has_said = True
        _say(text)


def cached_jit(
    *, static_argnames: tuple[str, ...] = ()
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Compile a function as ``jax.jit`` does, and keep its programs where ``set_cache_dir`` says.

    Args:
        static_argnames: keyword arguments that are part of the program; told apart by ``repr``.
            With a value that is neither plain nor of this package nothing is kept.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        jitted = jax.jit(function, static_argnames=static_argnames)
        whole: Callable[..., R] = function
        programs: dict[str, Call] = {}
        lock = threading.Lock()

        @functools.wraps(jitted)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            folder = cache_dir()
            static = {name: kwargs[name] for name in static_argnames if name in kwargs}
            if folder is None or not _is_ours(tuple(static.values())):
                return jitted(*args, **kwargs)
            data = args, {name: kwargs[name] for name in kwargs if name not in static}
            leaves, tree = jax.tree.flatten(data)
            if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
                return jitted(*args, **kwargs)
            name = _name(function, static, tree, leaves)

            def flat(*leaves: Any) -> Any:
                args, kwargs = jax.tree.unflatten(tree, leaves)
                return whole(*args, **kwargs, **static)

            if name not in programs:
                with lock:  # threads that ask for it at the same time wait for one of them
                    if name not in programs:
                        path = folder / name
                        programs[name] = _load(path, leaves) or _compile(path, flat, leaves)
            return programs[name](leaves)

        return call

    return decorate


def cache_dir() -> Path | None:
    """Tell in which folder programs are kept; None unless it is named and one CPU all there is."""
    is_plain = jax.default_backend() == "cpu" and jax.device_count() == 1
    is_watched = any(getattr(jax.config, name) for name in _WATCHING)
    return _folder if is_plain and not is_watched else None


def _is_ours(value: object) -> bool:
    """Tell whether a static value is plain or of this package, and so told by its ``repr``."""
    # Of somebody's own policy it does not tell: its code may have changed meanwhile.
    if isinstance(value, tuple):
        return all(map(_is_ours, value))
    if value is None or isinstance(value, str | int | float):
        return True
    if type(value).__module__.partition(".")[0] != __name__.partition(".")[0]:
        return False
    return is_dataclass(value) and all(_is_ours(getattr(value, one.name)) for one in fields(value))


def _name(function: Callable[..., Any], static: Any, tree: Any, leaves: list[Any]) -> str:
    """Name a program by all that it follows from."""
    types = [jax.typeof(leaf) for leaf in leaves]
    parts = (
        # What programs depend on besides their call; JAX's settings can change in between.
        *_machine(),
        *(getattr(jax.config, name) for name in _SETTINGS),
        jax.config.read("jax_disable_most_optimizations"),
        os.environ.get("XLA_FLAGS", ""),
        function.__module__,
        function.__qualname__,
        static,
        tree,
        [(one.shape, str(one.dtype), getattr(one, "weak_type", False)) for one in types],
    )
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:32] + _SUFFIX


@functools.cache
def _machine() -> tuple[str, ...]:
    """Tell this package's source, the versions below it, and this machine."""
    digest = hashlib.sha256()
    package = Path(__file__).parent.parent
    for path in sorted(package.rglob("*")):
        if path.is_file() and path.suffix != ".pyc":
            digest.update(str(path.relative_to(package)).encode() + path.read_bytes())
    features = ""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
        features = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return (
        digest.hexdigest(),
        jax.__version__,
        jaxlib.version.__version__,
        platform.python_version(),
        platform.platform(),
        platform.processor(),
        features,
    )


def _load(path: Path, leaves: list[Any]) -> Call | None:
    """Load a kept program; None if there is none, or none that may be used."""
    try:
        call = load_program(read_own_file(path, at_most=_MAX_BYTES), name=path.name)
        # Some faults show only here: XLA links when it runs.
        jax.block_until_ready(call(leaves))
        os.utime(path)
    except FileNotFoundError:
        return None
    except Exception as error:  # whatever is wrong with a file: it is written anew
        why = " ".join(str(error).removeprefix(f"{path}: ").split()) or type(error).__name__
        _tell_once(f"compiling anew what was kept in {path}: {why}")
        return None
    return call


def _compile(path: Path, flat: Callable[..., Any], leaves: list[Any]) -> Call:
    """Compile a program of flat arguments, and keep it if it can be kept."""
    call, content = compile_program(flat, leaves, name=path.name)
    if content is not None:
        try:
            write_own_file(path, content)
            # Those used longest ago go; another process may drop the same ones.
            with contextlib.suppress(FileNotFoundError):
                kept = path.parent.glob(f"*{_SUFFIX}")
                for old in sorted(kept, key=lambda one: one.stat().st_mtime)[:-_MAX_PROGRAMS]:
                    old.unlink()
        except OSError as error:
            _tell_once(f"compiled programs are not kept: {error}")
    return call
