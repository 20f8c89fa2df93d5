"""Compiled programs kept whole: a later run neither traces nor lowers nor compiles them.

JAX's own cache keeps what has been compiled, but finds it by the program's text, which has to be
traced and lowered first: seconds for a decision cycle. Here a program is found by what the text
follows from: the source of this package, the versions below it, this machine, and the shapes and
static values of a call. Whatever does not fit, or cannot be read, is compiled as if nothing had
been kept.

Only functions of their arguments alone may be kept: what they read of modules must be constant.
"""

import contextlib
import functools
import hashlib
import os
import pickle
import platform
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import jax
import jax.core
import jaxlib.version
from jax.experimental import serialize_executable

P = ParamSpec("P")
R = TypeVar("R")
_MAX_PROGRAMS = 24
"""Files that stay; the cycle's has 8 MB. Those used last are kept."""
_SUFFIX = ".program"
_SETTINGS = (
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_debug_nans",
    "jax_threefry_partitionable",
)
_folder: Path | None = None
_outside = threading.Lock()
_num_outside, _least_seconds = 0, 0.0
"""How many threads compile outside of JAX's cache, and the setting that the last one restores."""


def keep_in(folder: Path | None) -> None:
    """Name the folder of kept programs, for the rest of the process; None keeps none.

    Args:
        folder: existing or not. Programs are loaded from it as code: it must be the user's own.
    """
    global _folder
    _folder = folder


def kept(*, static_argnames: tuple[str, ...] = ()) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Compile a function as ``jax.jit`` does, and keep its programs where ``keep_in`` says.

    Args:
        static_argnames: keyword arguments that are part of the program; told apart by ``repr``.

    Returns:
        A decorator.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        jitted = jax.jit(function, static_argnames=static_argnames)
        whole: Callable[..., R] = function
        programs: dict[str, _Program] = {}

        @functools.wraps(jitted)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            folder = kept_in()
            if folder is None:
                return jitted(*args, **kwargs)
            static = {name: kwargs[name] for name in static_argnames if name in kwargs}
            data = args, {name: kwargs[name] for name in kwargs if name not in static}
            leaves, tree = jax.tree.flatten(data)
            if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
                return jitted(*args, **kwargs)
            name = _name(function, static, tree, leaves)

            def flat(*leaves: Any) -> Any:
                args, kwargs = jax.tree.unflatten(tree, leaves)
                return whole(*args, **kwargs, **static)

            return programs.setdefault(name, _Program()).run(folder / name, flat, leaves)

        return call

    return decorate


class _Program:
    """One compiled program; threads that ask for it at the same time wait for one of them."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._made: Callable[[list[Any]], Any] | None = None

    def run(self, path: Path, flat: Callable[..., Any], leaves: list[Any]) -> Any:
        """Run it; load or compile it first if nobody has."""
        with self._lock:
            self._made = self._made or _load(path, leaves) or _compile(path, flat, leaves)
        return self._made(leaves)


def kept_in() -> Path | None:
    """Tell in which folder programs are kept; None unless it is named and one CPU all there is."""
    is_plain = jax.default_backend() == "cpu" and jax.device_count() == 1
    return _folder if is_plain else None


def _name(function: Callable[..., Any], static: Any, tree: Any, leaves: list[Any]) -> str:
    """Name a program by all that it follows from."""
    types = [jax.typeof(leaf) for leaf in leaves]
    parts = (
        _setting(),
        function.__module__,
        function.__qualname__,
        static,
        tree,
        [(one.shape, str(one.dtype), getattr(one, "weak_type", False)) for one in types],
    )
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:32] + _SUFFIX


def _setting() -> tuple[Any, ...]:
    """List what programs depend on besides their call; JAX's settings can change in between."""
    return (
        *_machine(),
        *(getattr(jax.config, name) for name in _SETTINGS),
        os.environ.get("XLA_FLAGS", ""),
    )


@functools.cache
def _machine() -> tuple[str, ...]:
    """Tell this package's source, the versions below it, and this machine."""
    digest = hashlib.sha256()
    package = Path(__file__).parent
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


def _load(path: Path, leaves: list[Any]) -> Callable[[list[Any]], Any] | None:
    """Load a kept program; None if there is none, or none that can be read and run."""
    try:
        payload, number, skeleton = pickle.loads(path.read_bytes())
        found, tree = jax.tree.flatten(skeleton)
        in_tree = jax.tree.structure((tuple(range(number)), {}))
        out_tree = jax.tree.structure(found)
        compiled = serialize_executable.deserialize_and_load(payload, in_tree, out_tree)
        # Some faults of a file show only here: XLA links when it runs.
        jax.block_until_ready(compiled(*leaves))
        os.utime(path)
    except Exception:  # whatever is wrong with a file: it is written anew
        return None
    return lambda values: jax.tree.unflatten(tree, compiled(*values))


def _compile(path: Path, flat: Callable[..., Any], leaves: list[Any]) -> Callable[[list[Any]], Any]:
    """Compile a program of flat arguments, and keep it if it can be kept."""
    trees: list[Any] = []

    def kept_whole(*values: Any) -> list[Any]:
        found, tree = jax.tree.flatten(flat(*values))
        trees.append(tree)
        return found

    lowered = jax.jit(kept_whole).lower(*leaves)
    with _outside_of_the_cache():
        compiled = lowered.compile()
    tree = trees[0]
    # A record with numbers for leaves tells the structure; JAX's own description has no file form.
    skeleton = jax.tree.unflatten(tree, range(tree.num_leaves))
    # A full or read-only disk, a program that has no file form: it is only not kept.
    with contextlib.suppress(Exception):
        payload, _, _ = serialize_executable.serialize(compiled)
        _write(path, pickle.dumps((payload, len(leaves), skeleton)))
    return lambda values: jax.tree.unflatten(tree, compiled(*values))


@contextlib.contextmanager
def _outside_of_the_cache() -> Iterator[None]:
    """Have JAX's own cache take nothing of what is compiled inside.

    A CPU program that JAX has loaded from its cache is written without its functions (JAX 0.10),
    so programs to be kept must never be found there.
    """
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


def _write(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, and drop those used longest ago."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
        file.write(content)
    Path(file.name).replace(path)
    programs = sorted(path.parent.glob(f"*{_SUFFIX}"), key=lambda one: one.stat().st_mtime)
    for old in programs[:-_MAX_PROGRAMS]:
        old.unlink(missing_ok=True)
