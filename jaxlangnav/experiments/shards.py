"""Shards: the files of a sweep, each with a record of what it must be.

A shard is a Parquet file of the episodes of one chunk of the plan. Its own footer says of which
sweep it is, which of its files, how many rows it has, and the SHA-256 of its bytes (with zeros
where the digits stand). One file holds rows and record, so one rename makes both count: there is
no moment at which a kill could leave one without the other, and no list that several hosts would
have to share. Parquet's own page checksums are written and verified too.
"""

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from jaxlangnav.files.whole import write_bytes

_KEY = "jaxlangnav.shard"
_UNKNOWN = "0" * 64
_DIGITS = b'"sha256": "'
"""What stands before the digits, last of all in the footer."""


class ShardError(ValueError):
    """A file is not the shard that it should be; the message says in what."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Shard:
    """What a file of a sweep must be."""

    sweep: str
    """SHA-256 of what all files of a sweep share, see ``sweep.identity``."""
    index: int
    rows: int


def write_shard(columns: Mapping[str, Any], path: Path, shard: Shard) -> Path:
    """Write the episodes of a chunk, all or nothing.

    Args:
        columns: by name, arrays [E] or lists of E.
        path: of the file; its folder is made.
        shard: which it is.

    Returns:
        The path.

    Raises:
        ValueError: columns of different lengths, or not of the shard's.
        OSError: the disk is full, or the folder cannot be written to.
    """
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
    """See that a file is the shard that it should be.

    Args:
        path: of the file.
        shard: which it should be.

    Raises:
        ShardError: it is another one, or its bytes are not those that were written.
    """
    _compare(_record(_read(path)), shard)


def read_shard(path: Path, *, sweep: str, index: int) -> pa.Table:
    """Read a shard, verified.

    Args:
        path: of the file.
        sweep: of which it should be.
        index: which of its files it should be.

    Returns:
        Its rows.

    Raises:
        ShardError: it is another one, or its bytes are not those that were written.
    """
    content = _read(path)
    found = _record(content)
    _compare(found, Shard(sweep=sweep, index=index, rows=found.rows))
    try:
        table = pq.read_table(pa.BufferReader(content), page_checksum_verification=True)
    except (pa.ArrowException, OSError) as error:
        raise ShardError(f"cannot be read: {' '.join(str(error).split())}") from None
    if table.num_rows != found.rows:
        raise ShardError(f"has {table.num_rows} rows, but {found.rows} were written")
    return table


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
    try:
        record = json.loads(content[content.rfind(b"{", 0, place) : end + len(b'"}')])
        return Shard(sweep=record["sweep"], index=record["index"], rows=record["rows"])
    except (ValueError, KeyError, TypeError):
        raise ShardError("has a record that no sweep has written") from None


def _compare(found: Shard, shard: Shard) -> None:
    """Refuse a sound file that is another one."""
    if found.sweep != shard.sweep:
        raise ShardError("is of another sweep, or of another version")
    if found.index != shard.index:
        raise ShardError(f"stands in the place of another: it is file {found.index} of the sweep")
    if found.rows != shard.rows:
        raise ShardError(f"has {found.rows} rows, but must have {shard.rows}")
