"""Shards: whatever happens to a file, no changed value passes for what was written."""

import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jaxlangnav.experiments import shards
from jaxlangnav.experiments.shards import Shard, ShardError

SWEEP, ROWS = "5e" * 32, 300
SHARD = Shard(sweep=SWEEP, index=3, rows=ROWS)
SMALL = Shard(sweep=SWEEP, index=3, rows=1)


def columns(number: int = ROWS) -> dict[str, object]:
    rng = np.random.default_rng(0)
    return {
        # What the record looks like must not be found in a command.
        "command": [f'say "sha256": "{"0" * 64}"'] * number,
        "world": ["1H1C", "yard"] * (number // 2) + ["1H1C"] * (number % 2),
        "distance": rng.normal(size=number).astype(np.float32),
        "is_success": rng.random(number) < 0.5,
        "episode": np.arange(number),
    }


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return shards.write_shard(columns(), tmp_path / "episodes-000003.parquet", SHARD)


def test_a_shard_comes_back_as_it_was_written(path: Path, tmp_path: Path) -> None:
    shards.check_shard(path, SHARD)
    table = shards.read_shard(path, sweep=SWEEP, index=3)
    assert table.equals(shards.to_table(columns()))
    assert pq.read_table(path).equals(table)
    again = shards.write_shard(columns(), tmp_path / "again.parquet", SHARD)
    assert again.read_bytes() == path.read_bytes()


def test_no_flipped_bit_passes(path: Path) -> None:
    sound, rng = path.read_bytes(), random.Random(0)
    for bit in rng.sample(range(8 * len(sound)), 1000):
        content = bytearray(sound)
        content[bit // 8] ^= 1 << bit % 8
        path.write_bytes(content)
        with pytest.raises(ShardError):
            shards.check_shard(path, SHARD)
        with pytest.raises(ShardError):
            shards.read_shard(path, sweep=SWEEP, index=3)


def test_pages_have_checksums_of_their_own(path: Path) -> None:
    """Whoever reads the files with Parquet alone can verify the values too."""
    sound = path.read_bytes()
    chunk = pq.read_metadata(path).row_group(0).column(2)
    end = chunk.dictionary_page_offset + chunk.total_compressed_size
    for place in range(end - 240, end, 24):
        content = bytearray(sound)
        content[place] ^= 16
        path.write_bytes(content)
        with pytest.raises((OSError, pa.ArrowException), match="CRC checksum"):
            pq.read_table(path, page_checksum_verification=True)


def test_no_truncated_file_passes(tmp_path: Path) -> None:
    path = shards.write_shard(columns(1), tmp_path / "episodes-000003.parquet", SMALL)
    sound = path.read_bytes()
    assert len(sound) < 4000
    for length in range(0, len(sound), 3):
        path.write_bytes(sound[:length])
        with pytest.raises(ShardError):
            shards.check_shard(path, SMALL)
    # Cut off at the front, and with something behind it.
    for content in (sound[1:], sound + b"\0", sound + b"PAR1", sound + sound):
        path.write_bytes(content)
        with pytest.raises(ShardError):
            shards.check_shard(path, SMALL)


def empty(path: Path) -> None:
    path.write_bytes(b"")


def foreign(path: Path) -> None:
    pq.write_table(pa.table({"distance": [1.0]}), path)


def folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def other_place(path: Path) -> None:
    shards.write_shard(columns(), path, Shard(sweep=SWEEP, index=4, rows=ROWS))


def other_sweep(path: Path) -> None:
    shards.write_shard(columns(), path, Shard(sweep="00" * 32, index=3, rows=ROWS))


def other_number(path: Path) -> None:
    shards.write_shard(columns(2), path, Shard(sweep=SWEEP, index=3, rows=2))


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (empty, "is empty"),
        (foreign, "has no record of what was written"),
        (folder, "is no file"),
        (other_place, "stands in the place of another: it is file 4"),
        (other_sweep, "is of another sweep, or of another version"),
        (other_number, "has 2 rows, but must have 300"),
    ],
)
def test_another_file_is_told_from_this_one(
    harm: Callable[[Path], None], message: str, path: Path
) -> None:
    harm(path)
    with pytest.raises(ShardError, match=message):
        shards.check_shard(path, SHARD)


def test_rows_must_be_as_many_as_said(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="would have 2 rows, but must have 300"):
        shards.write_shard(columns(2), tmp_path / "episodes.parquet", SHARD)
    assert list(tmp_path.iterdir()) == []
