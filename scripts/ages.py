"""Staleness of generated files: the fingerprint of the engine that made each, in ``ages.json``.

Two things change the engine's results, and a commit that changes neither leaves every generated
file valid: the entries of the changelog marked **results**, and the trained weights that the
package ships. Their hash is the engine's fingerprint. A record may also say what a stale page
``waits`` for (the results page takes an hour); regenerating it drops that entry.
"""

import hashlib
import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RECORD = Path(__file__).resolve().parent / "ages.json"
_RESULTS_MARK = "**results**"
_WEIGHT_SUFFIXES = (".npz", ".npy")


def entries(changelog: str) -> list[str]:
    """List the changelog entries marked as changing results, sorted."""
    items = re.findall(r"(?m)^- .*(?:\n +.*)*", changelog)
    return sorted(" ".join(entry.split()) for entry in items if _RESULTS_MARK in entry)


def engine(root: Path = ROOT) -> str:
    """Compute the engine's fingerprint.

    Args:
        root: of the repository.

    Returns:
        Sixteen hexadecimal digits.
    """
    parts = [entry.encode() for entry in entries((root / "CHANGELOG.md").read_text("utf-8"))]
    files = sorted(path for path in (root / "jaxlangnav").rglob("data/*") if _is_weights(path))
    parts += [path.name.encode() + path.read_bytes() for path in files]
    digests = b"".join(hashlib.sha256(part).digest() for part in parts)
    return hashlib.sha256(digests).hexdigest()[:16]


def _is_weights(path: Path) -> bool:
    return path.suffix in _WEIGHT_SUFFIXES


def read() -> dict[str, dict[str, str]]:
    """Read the records: by path from the root, ``engine`` and optionally ``waits``."""
    return json.loads(RECORD.read_text("utf-8"))


def is_current(path: Path) -> bool:
    """Test whether a generated file was made by an engine with the current fingerprint."""
    entry = read().get(_name(path), {})
    return entry.get("engine") == engine()


def record(path: Path) -> None:
    """Record that a generated file was made by the current engine."""
    records = {**read(), _name(path): {"engine": engine()}}
    RECORD.write_text(json.dumps(records, indent=2, sort_keys=True) + "\n", "utf-8")


def _name(path: Path) -> str:
    return str(path.resolve().relative_to(ROOT))
