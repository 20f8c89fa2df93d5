"""Results on disk: no changed value passes for what was written; how they were made."""

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

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jaxlangnav.episode import lanes
from jaxlangnav.experiments import archive, shards
from jaxlangnav.experiments.archive import CompileClock
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.shards import FileError, FileId, Part, lock
from jaxlangnav.experiments.tasks import SENTENCES, Cell, ground_sentences, make_tasks
from jaxlangnav.navigator import default_params
from jaxlangnav.pytree import replace

SWEEP, ROWS = "5e" * 32, 300
SHARD = FileId(sweep=SWEEP, index=3, rows=ROWS)
SMALL = FileId(sweep=SWEEP, index=3, rows=1)


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
    return shards.write_rows(columns(), tmp_path / "episodes-000003.parquet", SHARD)


def test_a_shard_comes_back_as_it_was_written(path: Path, tmp_path: Path) -> None:
    shards.check_rows(path, SHARD)
    table = shards.read_rows(path, sweep=SWEEP, index=3)
    assert table.equals(pa.table(columns()))
    assert pq.read_table(path).equals(table)
    again = shards.write_rows(columns(), tmp_path / "again.parquet", SHARD)
    assert again.read_bytes() == path.read_bytes()


def test_no_flipped_bit_passes(path: Path) -> None:
    sound, rng = path.read_bytes(), random.Random(0)
    for bit in rng.sample(range(8 * len(sound)), 300):
        content = bytearray(sound)
        content[bit // 8] ^= 1 << bit % 8
        path.write_bytes(content)
        with pytest.raises(FileError):
            shards.check_rows(path, SHARD)
        with pytest.raises(FileError):
            shards.read_rows(path, sweep=SWEEP, index=3)


def test_no_truncated_file_passes(tmp_path: Path) -> None:
    path = shards.write_rows(columns(1), tmp_path / "episodes-000003.parquet", SMALL)
    sound = path.read_bytes()
    assert len(sound) < 4000
    for length in range(0, len(sound), 7):
        path.write_bytes(sound[:length])
        with pytest.raises(FileError):
            shards.check_rows(path, SMALL)
    # Cut off at the front, and with something behind it.
    for content in (sound[1:], sound + b"\0", sound + b"PAR1", sound + sound):
        path.write_bytes(content)
        with pytest.raises(FileError):
            shards.check_rows(path, SMALL)


def other(number: int = ROWS, **named: Any) -> Callable[[Path], object]:
    shard = dataclasses.replace(SHARD, rows=number, **named)
    return lambda path: shards.write_rows(columns(number), path, shard)


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
    with pytest.raises(FileError, match=message):
        shards.check_rows(path, SHARD)


def test_rows_must_be_as_many_as_said(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="would have 2 rows, but must have 300"):
        shards.write_rows(columns(2), tmp_path / "episodes.parquet", SHARD)
    assert list(tmp_path.iterdir()) == []


# The lock of a sweep's part: one living holder, named; a dead one's lock is taken over.


HOLDER = """
import sys
from pathlib import Path
from jaxlangnav.experiments.shards import lock
with lock(Path(sys.argv[1]), (int(sys.argv[2]), int(sys.argv[3])), on_note=print):
    print("held", flush=True)
    sys.stdin.read()
"""


def ignore(line: str) -> None:
    raise AssertionError(line)


@contextlib.contextmanager
def holder(folder: Path, part: Part) -> Iterator[subprocess.Popen[str]]:
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
        with pytest.raises(ValueError, match=name) as caught, lock(folder, (1, 1), on_note=ignore):
            pass
        assert "is at work on part 1/1" in str(caught.value)
        assert "\n" not in str(caught.value)
        # What it holds stays held.
        with pytest.raises(ValueError, match=name), lock(folder, (1, 1), on_note=ignore):
            pass
        process.communicate("")
    assert list(folder.iterdir()) == []
    with lock(folder, (1, 1), on_note=ignore) as is_filled:
        assert is_filled
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
            with lock(tmp_path, part, on_note=told.append) as is_filled:
                assert is_filled
                (path,) = tmp_path.iterdir()
                assert json.loads(path.read_text())["pid"] == os.getpid()
            assert told == [
                f"note: {tmp_path}: took over from process 7 on a since then, which is gone"
            ]
            assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("first", [(1, 2), (1, 1), (2, 4)])
@pytest.mark.parametrize("second", [(2, 2), (5, 8), (3, 4), (2, 4), (1, 3), (5, 6)])
def test_parts_that_share_files_exclude_each_other(first, second, tmp_path):
    one, other = (set(range(place - 1, 60, number)) for place, number in (first, second))
    refused = pytest.raises(ValueError, match=f"part {first[0]}/{first[1]}")
    with lock(tmp_path, first, on_note=ignore):
        expected = refused if one & other else contextlib.nullcontext()
        with expected, lock(tmp_path, second, on_note=ignore) as is_filled:
            assert is_filled
        assert len(list(tmp_path.iterdir())) == 1


def test_without_locks_it_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flock(_handle: int, _operation: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    told: list[str] = []
    with lock(tmp_path, (1, 1), on_note=told.append) as is_filled:
        assert not is_filled
    assert "cannot be locked (No locks available)" in told[0]
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    given = {"a": [1]}, pa.table({"a": [1]}), "", jnp.ones(2)
    (path, *_) = archive.write_experiment(tmp_path, "x", *given)
    before = path.read_bytes()

    def full_disk(_table: object, where: Path, **_options: object) -> None:
        Path(where).write_bytes(b"torn")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(archive.pq, "write_table", full_disk)
    with pytest.raises(OSError, match="No space left"):
        archive.write_experiment(tmp_path, "x", *given)
    assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 4


def test_the_hash_is_of_what_is_held_and_never_of_where() -> None:
    @dataclasses.dataclass(frozen=True)
    class Model:
        weights: np.ndarray
        name: str = "annotation"

    words = np.arange(6, dtype=np.float32).reshape(2, 3)
    whole = archive.pytree_hash({"words": jnp.asarray(words), "bias": jnp.float32(0.5)})
    assert archive.pytree_hash({"bias": np.float32(0.5), "words": words}) == whole
    model = archive.pytree_hash([Model(np.ones(3))])
    assert archive.pytree_hash([Model(np.ones(3))]) == model
    others = [
        {"words": words, "bias": np.float32(0.25)},
        {"words": words.reshape(3, 2), "bias": np.float32(0.5)},
        {"words": words, "offset": np.float32(0.5)},
        [Model(np.zeros(3))],
        [Model(np.ones(3), "behavior")],
    ]
    assert len({whole, model, *map(archive.pytree_hash, others)}) == 7
    with pytest.raises(ValueError, match="it has no hash"):
        archive.pytree_hash({"thing": object()})


def test_a_manifest_says_how(tmp_path: Path) -> None:
    document = archive.manifest({"seed": 3, "episodes": 100}, models={"w": jnp.ones(2)})
    path = archive.write_manifest(document, tmp_path / "manifest.json")
    read = json.loads(path.read_text("utf-8"))
    assert read == document
    assert read["settings"] == {"seed": 3, "episodes": 100}
    assert len(read["models_sha256"]) == 64
    assert set(read["libraries"]) >= {"jax", "numpy"}


# Compilation is counted once, and does not happen anew for other numbers of the same kind.


@pytest.mark.parametrize(
    ("intervals", "expected"),
    [
        ([], 0.0),
        ([(0.0, 2.0), (5.0, 6.0)], 3.0),
        ([(1.0, 4.0), (0.0, 2.0)], 4.0),
        ([(0.0, 10.0), (2.0, 3.0), (4.0, 11.0)], 11.0),
    ],
)
def test_what_overlaps_is_counted_once(intervals, expected):
    with CompileClock() as clock:
        clock._intervals += intervals
    assert clock.seconds == pytest.approx(expected)


def test_the_clock_counts_compilation_and_not_running() -> None:
    @jax.jit
    def cube(x: jax.Array) -> jax.Array:
        return x * x * x

    given = jnp.arange(3.0)
    with CompileClock() as first:
        cube(given).block_until_ready()
    with CompileClock() as second:
        cube(given).block_until_ready()
    assert first.seconds > 0.0
    assert second.seconds == 0.0, "nothing is compiled a second time"


def test_weak_types_do_not_compile_a_batch_again(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(
        lanes,
        "_run_batch",
        lambda *arrays: seen.append([jax.typeof(leaf) for leaf in jax.tree.leaves(arrays[:4])]),
    )
    tasks = make_tasks(Cell(world="1H1C", relation="null", seed=0), 4)
    instructions = ground_sentences([SENTENCES["null"]]).instructions
    weak = replace(tasks, sensor=replace(tasks.sensor, range_max=jnp.full(4, 2.0)))
    params = default_params()
    other = replace(params, planner=replace(params.planner, discount=0.7))
    for own, numbers, count in ((tasks, params, None), (weak, other, 3)):
        lanes.run_batch(
            own, instructions, params=numbers, config=navigator_config("informed"), count=count
        )
    assert seen[0] == seen[1]
