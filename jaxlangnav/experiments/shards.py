"""Shards: the files of a sweep, each with a record of what it must be; and who works on which.

A shard is a Parquet file of the episodes of one chunk of the plan. Its own footer says of which
sweep it is, which of its files, how many rows it has, and the SHA-256 of its bytes (with zeros
where the digits stand). One file holds rows and record, so one rename makes both count, and no kill
can leave one without the other.
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

from jaxlangnav.inputs.whole_files import make_folder, write_bytes

_KEY = "jaxlangnav.shard"
_UNKNOWN = "0" * 64
_DIGITS = b'"sha256": "'  # what stands before the digits, last of all in the footer


class ShardError(ValueError):
    """A file is not the shard that it should be; the message says in what."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Shard:
    """What a file of a sweep must be."""

    sweep: str  # SHA-256 of what all files of a sweep share, see ``sweep.identity``
    index: int
    rows: int


def write_shard(columns: Mapping[str, Any], path: Path, shard: Shard) -> Path:
    """Write a chunk's episodes, columns [E], all or nothing; ``ValueError`` for other lengths."""
    table = pa.table(dict(columns))
    if table.num_rows != shard.rows:
        raise ValueError(f"{path} would have {table.num_rows} rows, but must have {shard.rows}")
    record = json.dumps(dataclasses.asdict(shard) | {"sha256": _UNKNOWN})
    sink = pa.BufferOutputStream()
    options: dict[str, Any] = {"compression": "zstd", "write_page_checksum": True}
    with pq.ParquetWriter(sink, table.schema, **options) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({_KEY: record})
    content = sink.getvalue().to_pybytes()
    place = content.rindex(_DIGITS) + len(_DIGITS)
    digits = hashlib.sha256(content).hexdigest().encode()
    return write_bytes(content[:place] + digits + content[place + len(digits) :], path)


def check_shard(path: Path, shard: Shard) -> None:
    """Raise ``ShardError`` where a file is not the shard it should be, or not what was written."""
    _compare(_record(_read(path)), shard)


def read_shard(path: Path, *, sweep: str, index: int) -> pa.Table:
    """Read the rows of the file ``index`` of a sweep, verified as ``check_shard`` does."""
    content = _read(path)
    found = _record(content)
    _compare(found, Shard(sweep=sweep, index=index, rows=found.rows))
    # To the last byte what ``write_shard`` has written, so it can be read and has those rows.
    return pq.read_table(pa.BufferReader(content))


def _read(path: Path) -> bytes:
    """Read a file; what is no file is no shard."""
    if not path.is_file():
        raise ShardError("is no file")
    try:
        return path.read_bytes()
    except OSError as error:
        raise ShardError(f"cannot be read: {error.strerror}") from None


def _record(content: bytes) -> Shard:
    """Hold bytes against the record in them, and say what it tells."""
    if not content:
        raise ShardError("is empty")
    place = content.rfind(_DIGITS) + len(_DIGITS)
    end = place + len(_UNKNOWN)
    if place < len(_DIGITS) or not content.endswith(b"PAR1"):
        raise ShardError("has no record of what was written: it is cut short, or of another origin")
    blank = content[:place] + _UNKNOWN.encode() + content[end:]
    if hashlib.sha256(blank).hexdigest().encode() != content[place:end]:
        raise ShardError("is damaged: its bytes are not those that were written (SHA-256)")
    record = json.loads(content[content.rfind(b"{", 0, place) : end + len(b'"}')])
    return Shard(sweep=record["sweep"], index=record["index"], rows=record["rows"])


def _compare(found: Shard, shard: Shard) -> None:
    """Refuse a sound file that is another one."""
    if found.sweep != shard.sweep:
        raise ShardError("is of another sweep, or of another version")
    if found.index != shard.index:
        raise ShardError(f"stands in the place of another: it is file {found.index} of the sweep")
    if found.rows != shard.rows:
        raise ShardError(f"has {found.rows} rows, but must have {shard.rows}")


# A part i/n of a folder is held by a lock on the file ``.held-i-of-n.json``, which names host,
# process and time. The lock is the kernel's (``flock``): it ends with its holder, however that
# dies, so a dead holder's part is simply taken over. Parts that share files (1/1 and 2/8, or 1/2
# and 3/4) exclude each other; parts that share none run side by side, on any number of hosts.
#
# On NFS Linux carries the lock to the server, where it ends when the host's lease does. A file
# system without locks is used without one, and that is said: results do not depend on the lock,
# since every file is written whole, under a temporary name of its own, with the same bytes whoever
# writes it. Two processes at one part then only do the same work twice.

Note = Callable[[str], None]  # called with a line for people
PartOf = tuple[int, int]  # i and n, 1 ≤ i ≤ n: the files i, i + n, i + 2n, …
_NAME = re.compile(r"\.held-(\d+)-of-(\d+)\.json")
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)


@contextlib.contextmanager
def lock(folder: Path, part: PartOf, *, on_note: Note) -> Iterator[bool]:
    """Hold a part i/n of a folder, made if need be: no second process works on the same files.

    ``on_note`` is told whose lock was taken over, and where there are no locks. Yields whether the
    part is held: not where the file system has no locks. ``ValueError``: a living process holds it,
    or a part that shares files with it.
    """
    make_folder(folder)
    path = folder / f".held-{part[0]}-of-{part[1]}.json"
    try:
        handle = _lock(path, on_note)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        path.unlink(missing_ok=True)
        on_note(
            f"note: {folder} cannot be locked ({error.strerror}): see that nobody else is at it"
        )
        yield False
        return
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    name = {"host": socket.gethostname(), "pid": os.getpid(), "since": now}
    try:
        os.truncate(handle, os.pwrite(handle, json.dumps(name).encode(), 0))
        _refuse_overlaps(folder, part, on_note)
        yield True
    finally:
        path.unlink(missing_ok=True)
        os.close(handle)


def _lock(path: Path, on_note: Note, *, flags: int = os.O_RDWR | os.O_CREAT) -> int:
    """Take the lock of a file, as its only holder, or say who has it."""
    while True:
        handle = os.open(path, flags, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(handle), path.stat()):
                    break
        except BlockingIOError:
            os.close(handle)
            part = path.name.removeprefix(".held-").removesuffix(".json").replace("-of-", "/")
            raise ValueError(
                f"{path.parent}: {_holder(path)} is at work on part {part}: let it end, or end "
                "it; parts that share no files with it (--shard) can run beside it"
            ) from None
        except BaseException:
            os.close(handle)
            raise
        # Its last holder has removed it between opening and locking: what is locked is gone.
        os.close(handle)
    if os.fstat(handle).st_size:
        on_note(f"note: {path.parent}: took over from {_holder(path)}, which is gone")
    return handle


def _refuse_overlaps(folder: Path, part: PartOf, on_note: Note) -> None:
    """Refuse where a living process holds files of this part; clear away what dead ones left."""
    for path in folder.iterdir():
        match = _NAME.fullmatch(path.name)
        if match is None:
            continue
        place, number = int(match[1]), int(match[2])
        if (place, number) == part or (place - part[0]) % math.gcd(part[1], number):
            continue
        with contextlib.suppress(FileNotFoundError):
            handle = _lock(path, on_note, flags=os.O_RDWR)
            path.unlink()
            os.close(handle)


def _holder(path: Path) -> str:
    """Name who wrote a lock's file, for people."""
    try:
        who = json.loads(path.read_text("utf-8"))
        return f"process {who['pid']} on {who['host']} since {who['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "a process that has not said its name"
