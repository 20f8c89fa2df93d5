"""Result files: Parquet and JSON with a manifest of their provenance, and a compile timer."""

import contextlib
import dataclasses
import hashlib
import importlib.metadata
import json
import os
import platform
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import jax
import jax.monitoring
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jaxlangnav import __version__
from jaxlangnav.inputs.atomic_files import replacing, write_text

_LIBRARIES = ("jax", "jaxlib", "numpy", "optax", "pyarrow")
_OUTPUTS = ("rows", "paper", "bounds", "variations", "explained", "wall_s", "compile_s", "files")
_REPRODUCIBILITY = (
    "the same episodes on this kind of device with these versions; a program of another number of "
    "lanes, such as jaxlangnav follow, rounds differently and may rarely decide differently"
)
"""States which runs are reproducible, for the manifest."""
_COMPILE_EVENTS = "/jax/core/compile/"


def manifest(settings: Mapping[str, Any], *, models: Any) -> dict[str, Any]:
    """Build a manifest: settings, versions, device, and the hash of the models used."""
    device = jax.devices()[0]
    return {
        "settings": dict(settings),
        "jaxlangnav": __version__,
        "python": platform.python_version(),
        "libraries": {name: importlib.metadata.version(name) for name in _LIBRARIES},
        "models_sha256": pytree_hash(models),
        "device": {
            "platform": device.platform,
            "kind": device.device_kind,
            "count": jax.device_count(),
        },
        "machine": {
            "system": platform.system(),
            "cpu": platform.machine(),
            "cores": os.cpu_count(),
        },
        "repeats": _REPRODUCIBILITY,
    }


def read_part(path: Path | None, origin: list[str]) -> Any:
    """Read what a run of equal origin has finished, None unless all of its files are there."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        part = json.loads(path.read_text("utf-8") if path else "null")
        if part["origin"] == origin and all(map(os.path.isfile, part["document"]["files"])):
            return part
    return None


def write_manifest(document: Mapping[str, Any], path: Path) -> Path:
    """Write a manifest of JSON types; creates its folder."""
    return write_text(json_text(document), path)


def json_text(document: Mapping[str, Any]) -> str:
    """Format a document of JSON types, indented."""
    return json.dumps(document, indent=2, ensure_ascii=False) + "\n"


def write_experiment(
    folder: Path, name: str, document: Mapping[str, Any], columns: pa.Table, text: str, models: Any
) -> list[Path]:
    """Write an experiment's files, whose names begin with ``name``.

    ``columns`` has one row per episode, ``text`` is the Markdown table, ``models`` the trained
    weights, for their hash; the document's settings go into the manifest.
    """
    settings = {key: value for key, value in document.items() if key not in _OUTPUTS}
    results = {key: value for key, value in document.items() if key != "files"}
    episodes = folder / f"{name}_episodes.parquet"
    with replacing(episodes) as temporary:
        pq.write_table(columns, temporary, compression="zstd", write_page_checksum=True)
    return [
        episodes,
        write_text(text, folder / f"{name}.md"),
        write_manifest(results, folder / f"{name}.json"),
        write_manifest(manifest(settings, models=models), folder / f"{name}_manifest.json"),
    ]


def pytree_hash(tree: Any) -> str:
    """Hash the arrays of a pytree: names, shapes, types and bytes; SHA-256 in hexadecimal.

    Dataclasses are traversed even if not registered as pytrees. ``ValueError`` for a leaf whose
    bytes would differ from run to run.
    """
    digest = hashlib.sha256()
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        name = jax.tree_util.keystr(path)
        if dataclasses.is_dataclass(leaf):
            fields = {item.name: getattr(leaf, item.name) for item in dataclasses.fields(leaf)}
            digest.update(f"{name}{pytree_hash(fields)}".encode())
        elif isinstance(leaf, set | frozenset):
            # Sorted: the order of a set differs from run to run.
            digest.update(f"{name}{sorted(repr(item) for item in leaf)}".encode())
        elif (array := np.asarray(leaf)).dtype.hasobject:
            raise ValueError(f"{name or 'the tree'} is a {type(leaf).__name__}: it has no hash")
        else:
            digest.update(f"{name}{array.shape}{array.dtype.str}".encode())
            digest.update(array.tobytes())
    return digest.hexdigest()


class CompileClock:
    """Context manager that measures the time in which any thread traced, lowered or compiled.

    Nested and parallel compilations count once: ``seconds`` is the length of the union of their
    intervals, so it never exceeds the time that passed.
    """

    def __enter__(self) -> Self:
        """Start the clock: register a listener with JAX."""
        self.seconds = 0.0
        self._intervals: list[tuple[float, float]] = []
        jax.monitoring.register_event_duration_secs_listener(self._listen)
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the clock."""
        jax.monitoring.unregister_event_duration_listener(self._listen)
        last_end = float("-inf")
        for begin, end in sorted(self._intervals):
            self.seconds += max(0.0, end - max(begin, last_end))
            last_end = max(last_end, end)

    def _listen(self, event: str, duration_secs: float, **_: str | int) -> None:
        """Record the interval of a trace, a lowering or a compilation."""
        if event.startswith(_COMPILE_EVENTS):
            now = time.perf_counter()
            self._intervals.append((now - duration_secs, now))
