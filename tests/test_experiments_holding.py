"""The lock of a sweep's part: one living holder, named; a dead one's lock is taken over."""

import contextlib
import errno
import fcntl
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from jaxlangnav.experiments.holding import PartOf, held

HOLDER = """
import sys
from pathlib import Path
from jaxlangnav.experiments.holding import held
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
def test_parts_that_share_files_exclude_each_other(
    first: PartOf, second: PartOf, is_shared: bool, tmp_path: Path
) -> None:
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
