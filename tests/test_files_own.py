"""What runs as the user comes from folders and files that nobody else can have changed."""

import os
import stat
from pathlib import Path

import pytest

from jaxlangnav.files import own as own_files
from jaxlangnav.files.own import check_own_files, own_folder, read_own_file, write_own_file


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.parametrize("umask", [0o000, 0o077, 0o777])
def test_folders_and_files_are_made_for_the_user_alone(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        folder = own_folder(tmp_path / "a" / "b")
        write_own_file(folder / "file", b"content")
    finally:
        os.umask(before)
    assert [mode(one) for one in (tmp_path / "a", folder)] == [0o700, 0o700]
    assert mode(folder / "file") == 0o600
    assert read_own_file(folder / "file", at_most=7) == b"content"
    assert [one.name for one in folder.iterdir()] == ["file"]


def test_a_folder_that_is_there_keeps_what_is_in_it(tmp_path: Path) -> None:
    write_own_file(own_folder(tmp_path / "a") / "file", b"one")
    write_own_file(own_folder(tmp_path / "a") / "file", b"two")
    assert read_own_file(tmp_path / "a" / "file", at_most=9) == b"two"


@pytest.mark.parametrize("bits", [0o710, 0o701, 0o720, 0o702, 0o755, 0o777, 0o1777])
def test_a_folder_that_others_can_enter_is_refused(tmp_path: Path, bits: int) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a").chmod(bits)
    with pytest.raises(PermissionError, match=r"a: others can enter it; remedy: chmod 700"):
        own_folder(tmp_path / "a")


@pytest.mark.parametrize("bits", [0o720, 0o702, 0o777, 0o2775])
def test_a_folder_that_others_can_exchange_is_refused(tmp_path: Path, bits: int) -> None:
    own_folder(tmp_path / "a" / "b" / "c")
    (tmp_path / "a").chmod(bits)
    with pytest.raises(PermissionError, match=r"a: others can write in it; remedy: chmod go-w"):
        own_folder(tmp_path / "a" / "b" / "c")
    with pytest.raises(PermissionError, match="others can write in it"):
        own_folder(tmp_path / "a" / "new" / "c")
    assert not (tmp_path / "a" / "new").exists()


@pytest.mark.parametrize("bits", [0o755, 0o711, 0o1777])
def test_above_it_others_may_read_and_have_their_own(tmp_path: Path, bits: int) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a").chmod(bits)
    assert own_folder(tmp_path / "a" / "b") == tmp_path / "a" / "b"


def test_links_are_followed_once_and_where_they_lead_is_judged(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(tmp_path / "real")
    assert own_folder(tmp_path / "link" / "a") == tmp_path / "real" / "a"
    (tmp_path / "real").chmod(0o777)
    with pytest.raises(PermissionError, match="real: others can write in it"):
        own_folder(tmp_path / "link" / "a")
    with pytest.raises(PermissionError, match="real: others can enter it"):
        own_folder(tmp_path / "link")


def test_what_is_another_users_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = own_folder(tmp_path / "a")
    write_own_file(folder / "file", b"content")
    stranger = os.geteuid() + 1
    monkeypatch.setattr(own_files.os, "geteuid", lambda: stranger)
    with pytest.raises(PermissionError, match="belongs to another user"):
        own_folder(folder)
    with pytest.raises(PermissionError, match="file: belongs to another user"):
        read_own_file(folder / "file", at_most=9)


@pytest.mark.parametrize("bits", [0o620, 0o602, 0o666])
def test_a_file_that_others_can_write_is_refused(tmp_path: Path, bits: int) -> None:
    write_own_file(tmp_path / "file", b"content")
    (tmp_path / "file").chmod(bits)
    with pytest.raises(PermissionError, match="file: others can write it"):
        read_own_file(tmp_path / "file", at_most=9)


def test_what_is_no_file_of_its_own_is_refused(tmp_path: Path) -> None:
    write_own_file(tmp_path / "file", b"content")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(OSError, match="link"):
        read_own_file(tmp_path / "link", at_most=9)
    with pytest.raises(ValueError, match="pipe: is a pipe"):
        read_own_file(tmp_path / "pipe", at_most=9)
    with pytest.raises(ValueError, match="more than 6 bytes"):
        read_own_file(tmp_path / "file", at_most=6)
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(NotADirectoryError, match="is no folder"):
            own_folder(path)


def test_a_file_that_cannot_be_written_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_own_file(tmp_path / "file", b"content")

    def full(*_: object) -> None:
        raise OSError("full")

    monkeypatch.setattr(own_files.os, "replace", full)
    with pytest.raises(OSError, match="full"):
        write_own_file(tmp_path / "file", b"new")
    assert [one.name for one in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_bytes() == b"content"


def test_a_folder_is_refused_for_a_file_of_another_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = own_folder(tmp_path / "own")
    (folder / "one").write_bytes(b"1")
    (folder / "one").chmod(0o664)
    check_own_files(folder)
    mine = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: mine + 1)
    with pytest.raises(PermissionError, match="one: belongs to another user"):
        check_own_files(folder)
