"""Self-verifying Parquet files of a sweep's episodes, and locks on the parts of its folder.

A file has the episodes of one chunk of the plan. Its footer (Parquet metadata) contains the hash
of the sweep, the index of the file, the number of rows, and the SHA-256 of its bytes (with zeros in
place of the digits). Rows and record are in one file, so one rename publishes both, and a killed
process cannot leave one without the other.
"""

import contextlib
import dataclasses
import datetime
import errno
import fcntl
import hashlib
import json
import math
import os
import re
import socket
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from jaxlangnav.inputs.atomic_files import make_folder, write_bytes

_METADATA_KEY = "jaxlangnav.shard"
_ZERO_HASH = "0" * 64
_HASH_PREFIX = b'"sha256": "'  # precedes the digits, which end the footer


class FileError(ValueError):
    """Raised if a file is not the expected one; the message says how it differs."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class FileId:
    """Identity of an episode file: its sweep, index and number of rows."""

    sweep: str  # SHA-256 that all files of a sweep share, see ``sweep.identity``
    index: int
    rows: int


def write_rows(columns: Mapping[str, Any], path: Path, identity: FileId) -> Path:
    """Write a chunk's episodes, columns [E], atomically; ``ValueError`` for a wrong length."""
    table = pa.table(dict(columns))
    if table.num_rows != identity.rows:
        raise ValueError(f"{path} would have {table.num_rows} rows, but must have {identity.rows}")
    record = json.dumps(dataclasses.asdict(identity) | {"sha256": _ZERO_HASH})
    sink = pa.BufferOutputStream()
    options: dict[str, Any] = {"compression": "zstd", "write_page_checksum": True}
    with pq.ParquetWriter(sink, table.schema, **options) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({_METADATA_KEY: record})
    content = sink.getvalue().to_pybytes()
    start = content.rindex(_HASH_PREFIX) + len(_HASH_PREFIX)
    digits = hashlib.sha256(content).hexdigest().encode()
    return write_bytes(content[:start] + digits + content[start + len(digits) :], path)


def check_rows(path: Path, identity: FileId) -> None:
    """Raise ``FileError`` if a file is not the expected one, or is damaged."""
    _compare(_record(_read(path)), identity)


def read_rows(path: Path, *, sweep: str, index: int) -> pa.Table:
    """Read the rows of the file ``index`` of a sweep, verified as in ``check_rows``."""
    content = _read(path)
    record = _record(content)
    _compare(record, FileId(sweep=sweep, index=index, rows=record.rows))
    # The hash has verified every byte, so the file can be read and has those rows.
    return pq.read_table(pa.BufferReader(content))


def _read(path: Path) -> bytes:
    """Read the bytes of a file; ``FileError`` if there is none."""
    if not path.is_file():
        raise FileError("is no file")
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError(f"cannot be read: {error.strerror}") from None


def _record(content: bytes) -> FileId:
    """Verify the hash of a file's bytes, and parse its record."""
    if not content:
        raise FileError("is empty")
    start = content.rfind(_HASH_PREFIX) + len(_HASH_PREFIX)
    end = start + len(_ZERO_HASH)
    if start < len(_HASH_PREFIX) or not content.endswith(b"PAR1"):
        raise FileError("has no record of what was written: it is cut short, or of another origin")
    zeroed = content[:start] + _ZERO_HASH.encode() + content[end:]
    if hashlib.sha256(zeroed).hexdigest().encode() != content[start:end]:
        raise FileError("is damaged: its bytes are not those that were written (SHA-256)")
    record = json.loads(content[content.rfind(b"{", 0, start) : end + len(b'"}')])
    return FileId(sweep=record["sweep"], index=record["index"], rows=record["rows"])


def _compare(actual: FileId, expected: FileId) -> None:
    """Raise ``FileError`` if a valid file is not the expected one."""
    if actual.sweep != expected.sweep:
        raise FileError("is of another sweep, or of another version")
    if actual.index != expected.index:
        raise FileError(f"stands in the place of another: it is file {actual.index} of the sweep")
    if actual.rows != expected.rows:
        raise FileError(f"has {actual.rows} rows, but must have {expected.rows}")


# A part i/n of a folder is locked by the file ``.held-i-of-n.json``, which names host, process and
# time. The lock is the kernel's (``flock``): it ends with its process, however that dies, so the
# part of a dead process is simply taken over. Parts that share files (1/1 and 2/8, or 1/2
# and 3/4) exclude each other; parts that share none run side by side, on any number of hosts.
#
# On NFS Linux carries the lock to the server, where it ends when the host's lease does. A file
# system without locks is used without one, with a note: results do not depend on the lock, since
# every file is written atomically, under a unique temporary name, with the same bytes whoever
# writes it. Two processes on one part then only do the same work twice.

OnNote = Callable[[str], None]  # called with a line for people
Part = tuple[int, int]  # i and n, 1 ≤ i ≤ n: the files i, i + n, i + 2n, …
_LOCK_NAME = re.compile(r"\.held-(\d+)-of-(\d+)\.json")
_UNSUPPORTED = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)


@contextlib.contextmanager
def lock(folder: Path, part: Part, *, on_note: OnNote) -> Iterator[bool]:
    """Lock a part i/n of a folder, created if missing, against other processes.

    ``on_note`` is called where a dead process's lock was taken over or locks are not supported.
    Yields whether the part is locked: not where the file system has no locks. ``ValueError``: a
    running process has locked it, or a part that shares files with it.
    """
    make_folder(folder)
    path = folder / f".held-{part[0]}-of-{part[1]}.json"
    try:
        handle = _acquire(path, on_note)
    except OSError as error:
        if error.errno not in _UNSUPPORTED:
            raise
        path.unlink(missing_ok=True)
        on_note(
            f"note: {folder} cannot be locked ({error.strerror}): see that nobody else is at it"
        )
        yield False
        return
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    owner = {"host": socket.gethostname(), "pid": os.getpid(), "since": now}
    try:
        os.truncate(handle, os.pwrite(handle, json.dumps(owner).encode(), 0))
        _check_overlaps(folder, part, on_note)
        yield True
    finally:
        path.unlink(missing_ok=True)
        os.close(handle)


def _acquire(path: Path, on_note: OnNote, *, flags: int = os.O_RDWR | os.O_CREAT) -> int:
    """Lock a file exclusively; ``ValueError`` names the process that holds the lock."""
    while True:
        handle = os.open(path, flags, 0o666)
        with contextlib.ExitStack() as on_failure:
            on_failure.callback(os.close, handle)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                part = path.name.removeprefix(".held-").removesuffix(".json").replace("-of-", "/")
                raise ValueError(
                    f"{path.parent}: {_owner(path)} is at work on part {part}: let it end, or end "
                    "it; parts that share no files with it (--shard) can run beside it"
                ) from None
            # If another process removed the file between opening and locking: try again.
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(handle), path.stat()):
                    on_failure.pop_all()
                    break
    if os.fstat(handle).st_size:
        on_note(f"note: {path.parent}: took over from {_owner(path)}, which is gone")
    return handle


def _check_overlaps(folder: Path, part: Part, on_note: OnNote) -> None:
    """Raise if a running process holds an overlapping part; remove stale locks."""
    for path in folder.iterdir():
        if (match := _LOCK_NAME.fullmatch(path.name)) is None:
            continue
        index, total = int(match[1]), int(match[2])
        if (index, total) == part or (index - part[0]) % math.gcd(part[1], total):
            continue
        with contextlib.suppress(FileNotFoundError):
            handle = _acquire(path, on_note, flags=os.O_RDWR)
            path.unlink(missing_ok=True)
            os.close(handle)


def _owner(path: Path) -> str:
    """Describe the process that wrote a lock file."""
    try:
        owner = json.loads(path.read_text("utf-8"))
        return f"process {owner['pid']} on {owner['host']} since {owner['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "a process that has not said its name"
