"""Only regular files of a bounded size are read, and nothing is waited for."""

import os
import socket
from pathlib import Path

import pytest

from jaxlangnav.files.regular import read_file


@pytest.mark.parametrize("size", [0, 1, 99, 100])
def test_a_file_within_the_limit_is_read_whole(tmp_path: Path, size: int) -> None:
    content = bytes(range(size))
    (tmp_path / "file").write_bytes(content)
    (tmp_path / "link").symlink_to(tmp_path / "file")
    assert read_file(tmp_path / "file", at_most=100) == content
    assert read_file(str(tmp_path / "link"), at_most=100) == content


def test_more_than_one_piece_is_read(tmp_path: Path) -> None:
    content = os.urandom(3_000_000)
    (tmp_path / "file").write_bytes(content)
    assert read_file(tmp_path / "file", at_most=len(content)) == content


def test_a_file_beyond_the_limit_is_refused_with_its_name(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"x" * 1001)
    with pytest.raises(ValueError, match=r"file: has more than 1,000 bytes") as caught:
        read_file(tmp_path / "file", at_most=1000)
    assert "\n" not in str(caught.value)


def test_a_file_that_claims_a_terabyte_is_refused_unread(tmp_path: Path) -> None:
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(ValueError, match="more than 10 bytes"):
        read_file(tmp_path / "sparse", at_most=10)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc")
def test_the_size_that_a_file_claims_is_not_believed() -> None:
    assert Path("/proc/self/status").stat().st_size == 0
    assert read_file("/proc/self/status", at_most=1_000_000).startswith(b"Name:")
    with pytest.raises(ValueError, match="more than 10 bytes"):
        read_file("/proc/self/status", at_most=10)


def test_what_is_no_regular_file_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    kinds = {
        tmp_path: "a folder",
        tmp_path / "pipe": "a pipe",
        tmp_path / "link": "a pipe",
        Path("/dev/zero"): "a device",
    }
    for path, kind in kinds.items():
        with pytest.raises(ValueError, match=f"{path}: is {kind}, not a regular file"):
            read_file(path, at_most=10)


def test_what_cannot_be_opened_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_file(tmp_path / "none", at_most=10)
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(tmp_path / "socket"))
        with pytest.raises(OSError, match="socket"):
            read_file(tmp_path / "socket", at_most=10)
