"""How old a frozen output is: which engine it was made by, as a fingerprint in ``ages.json``.

Two things change what the engine answers, and a commit that changes neither leaves every frozen
output true: the entries of the changelog marked **results**, and the trained numbers that the
package ships. Their hash is the engine's fingerprint. Beside it a record may say what a page that
is known to be old ``waits`` for (the results page takes an hour); making it anew drops that.
"""

import hashlib
import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RECORD = Path(__file__).resolve().parent / "ages.json"
_MARK = "**results**"
_TRAINED = (".npz", ".npy")


def entries(changelog: str) -> list[str]:
    """List the entries of a changelog that change results, in no order that matters."""
    found = re.findall(r"(?m)^- .*(?:\n +.*)*", changelog)
    return sorted(" ".join(entry.split()) for entry in found if _MARK in entry)


def engine(root: Path = ROOT) -> str:
    """Compute the engine's fingerprint.

    Args:
        root: of the repository.

    Returns:
        Sixteen hexadecimal digits.
    """
    parts = [entry.encode() for entry in entries((root / "CHANGELOG.md").read_text("utf-8"))]
    files = sorted(path for path in (root / "jaxlangnav").rglob("data/*") if _is_trained(path))
    parts += [path.name.encode() + path.read_bytes() for path in files]
    digests = b"".join(hashlib.sha256(part).digest() for part in parts)
    return hashlib.sha256(digests).hexdigest()[:16]


def _is_trained(path: Path) -> bool:
    return path.suffix in _TRAINED


def read() -> dict[str, dict[str, str]]:
    """Read the record: by path from the root, ``engine`` and perhaps ``waits``."""
    return json.loads(RECORD.read_text("utf-8"))


def is_current(path: Path) -> bool:
    """Tell whether a frozen file was made by an engine of today's results."""
    kept = read().get(_name(path), {})
    return kept.get("engine") == engine()


def record(path: Path) -> None:
    """Keep that a frozen file has been made by the engine as it is."""
    kept = {**read(), _name(path): {"engine": engine()}}
    RECORD.write_text(json.dumps(kept, indent=2, sort_keys=True) + "\n", "utf-8")


def _name(path: Path) -> str:
    return str(path.resolve().relative_to(ROOT))
