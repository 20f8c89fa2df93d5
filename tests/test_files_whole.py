"""Files are written whole or not at all: beside their place, forced to the disk, then moved."""

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from jaxlangnav.files import whole as whole_files

WRITER = """
import sys
from pathlib import Path
from jaxlangnav.files.whole import replacing
with replacing(Path(sys.argv[1])) as temporary:
    temporary.write_text("half")
    print("writing", flush=True)
    sys.stdin.read()
"""


def fail(path: Path) -> None:
    with whole_files.replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError("the disk is full")


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = whole_files.write_text("old", tmp_path / "new" / "folder" / "table.md")
    with pytest.raises(RuntimeError, match="full"):
        fail(path)
    assert path.read_text() == "old"
    assert list(path.parent.iterdir()) == [path]


def test_file_and_folder_are_forced_to_the_disk_before_the_rename_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    events: list[tuple[str, str]] = []
    fsync, move = os.fsync, Path.replace

    def forced(handle: int) -> None:
        events.append(("force", Path(os.readlink(f"/proc/self/fd/{handle}")).name))
        fsync(handle)

    def moved(self: Path, target: Path) -> Path:
        events.append(("move", self.name))
        return move(self, target)

    monkeypatch.setattr(whole_files.os, "fsync", forced)
    monkeypatch.setattr(Path, "replace", moved)
    whole_files.write_text("new", tmp_path / "out" / "table.md")
    made, (first, temporary), (second, same), (third, folder) = events
    assert made == ("force", tmp_path.name)
    assert (first, second, third) == ("force", "move", "force")
    assert temporary == same
    assert temporary.startswith(".table.partial-")
    assert folder == "out"


def test_a_killed_writer_leaves_the_old_file_and_a_hidden_one(tmp_path: Path) -> None:
    path = whole_files.write_text("old", tmp_path / "table.md")
    writer = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert writer.stdout is not None
    assert writer.stdout.readline() == "writing\n"
    writer.send_signal(signal.SIGKILL)
    writer.communicate()
    assert path.read_text() == "old"
    (left,) = whole_files.leftovers(path)
    assert left.name.startswith(".")
    assert left.read_text() == "half"
    assert {one.name for one in tmp_path.iterdir()} == {path.name, left.name}


def test_of_two_writers_one_wins(tmp_path: Path) -> None:
    path = tmp_path / "manifest.json"
    assert whole_files.write_once(b"mine", path)
    assert not whole_files.write_once(b"theirs", path)
    assert path.read_bytes() == b"mine"
    assert list(tmp_path.iterdir()) == [path]


def test_names_and_rights(tmp_path: Path) -> None:
    path = tmp_path / f"{'n' * 240}.md"
    before = os.umask(0o027)
    try:
        whole_files.write_text("long", path)
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert list(tmp_path.iterdir()) == [path]
    names = []
    for _ in range(2):
        with whole_files.replacing(path) as temporary:
            names.append(temporary.name)
    assert names[0] != names[1]
