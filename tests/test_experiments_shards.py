"""Shards: whatever happens to a file, no changed value passes for what was written."""

import contextlib
import dataclasses
import errno
import fcntl
import json
import os
import random
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jaxlangnav.experiments import shards
from jaxlangnav.experiments.shards import PartOf, Shard, ShardError, held

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
    assert table.equals(pa.table(columns()))
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


def other(number: int = ROWS, **named: Any) -> Callable[[Path], object]:
    shard = dataclasses.replace(SHARD, rows=number, **named)
    return lambda path: shards.write_shard(columns(number), path, shard)


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda path: path.write_bytes(b""), "is empty"),
        (lambda path: pq.write_table(pa.table({"distance": [1.0]}), path),
         "has no record of what was written"),
        (lambda path: (path.unlink(), path.mkdir()), "is no file"),
        (other(index=4), "stands in the place of another: it is file 4"),
        (other(sweep="00" * 32), "is of another sweep, or of another version"),
        (other(2), "has 2 rows, but must have 300"),
    ],
)  # fmt: skip
def test_another_file_is_told_from_this_one(harm, message, path):
    harm(path)
    with pytest.raises(ShardError, match=message):
        shards.check_shard(path, SHARD)


def test_rows_must_be_as_many_as_said(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="would have 2 rows, but must have 300"):
        shards.write_shard(columns(2), tmp_path / "episodes.parquet", SHARD)
    assert list(tmp_path.iterdir()) == []


# The lock of a sweep's part: one living holder, named; a dead one's lock is taken over.


HOLDER = """
import sys
from pathlib import Path
from jaxlangnav.experiments.shards import held
with held(Path(sys.argv[1]), (int(sys.argv[2]), int(sys.argv[3])), on_note=print):
    print("held", flush=True)
    sys.stdin.read()
"""


def ignore(line: str) -> None:
    raise AssertionError(line)


@contextlib.contextmanager
def holder(folder: Path, part: PartOf) -> Iterator[subprocess.Popen[str]]:
    """Hold a part in a process of its own."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder), *map(str, part)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def test_a_second_holder_is_told_who_the_first_is(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    with holder(folder, (1, 1)) as process:
        name = f"process {process.pid} on {socket.gethostname()} since 20"
        with (
            pytest.raises(ValueError, match=name) as caught,
            held(folder, (1, 1), on_note=ignore),
        ):
            pass
        assert "is at work on part 1/1" in str(caught.value)
        assert "\n" not in str(caught.value)
        # What it holds stays held.
        with pytest.raises(ValueError, match=name), held(folder, (1, 1), on_note=ignore):
            pass
        process.communicate("")
    assert list(folder.iterdir()) == []
    with held(folder, (1, 1), on_note=ignore) as is_held:
        assert is_held
    assert list(folder.iterdir()) == []


def test_a_dead_holder_s_lock_is_taken_over(tmp_path: Path) -> None:
    with holder(tmp_path, (2, 3)) as process:
        process.send_signal(signal.SIGKILL)
        process.wait()
        (left,) = tmp_path.iterdir()
        assert json.loads(left.read_text())["pid"] == process.pid
        for part in ((2, 3), (1, 1)):
            left.write_text(json.dumps({"host": "a", "pid": 7, "since": "then"}))
            told: list[str] = []
            with held(tmp_path, part, on_note=told.append) as is_held:
                assert is_held
                (lock,) = tmp_path.iterdir()
                assert json.loads(lock.read_text())["pid"] == os.getpid()
            assert told == [
                f"note: {tmp_path}: took over from process 7 on a since then, which is gone"
            ]
            assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("first", "second", "is_shared"),
    [
        ((1, 2), (2, 2), False),
        ((1, 1), (5, 8), True),
        ((1, 2), (3, 4), True),
        ((1, 2), (2, 4), False),
        ((1, 2), (1, 3), True),
        ((2, 4), (5, 6), False),
    ],
)
def test_parts_that_share_files_exclude_each_other(first, second, is_shared, tmp_path):
    files = [set(range(place - 1, 60, number)) for place, number in (first, second)]
    assert bool(files[0] & files[1]) == is_shared
    with held(tmp_path, first, on_note=ignore):
        if is_shared:
            with (
                pytest.raises(ValueError, match=f"part {first[0]}/{first[1]}"),
                held(tmp_path, second, on_note=ignore),
            ):
                pass
        else:
            with held(tmp_path, second, on_note=ignore) as is_held:
                assert is_held
        assert len(list(tmp_path.iterdir())) == 1


def test_a_lock_of_no_sense_is_no_obstacle(tmp_path: Path) -> None:
    (tmp_path / ".held-1-of-1.json").write_bytes(b"\xff{")
    told: list[str] = []
    with held(tmp_path, (1, 1), on_note=told.append):
        pass
    assert "a process that has not said its name" in told[0]


def test_without_locks_it_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flock(_handle: int, _operation: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    told: list[str] = []
    with held(tmp_path, (1, 1), on_note=told.append) as is_held:
        assert not is_held
    assert "cannot be locked (No locks available)" in told[0]
    assert list(tmp_path.iterdir()) == []
