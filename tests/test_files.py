"""Reading and writing files safely: whole, regular, of one's own; arrays and documents."""

import io
import os
import socket
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from jaxlangnav.inputs import atomic_files
from jaxlangnav.inputs.arrays import as_value_error, parse_floats
from jaxlangnav.inputs.atomic_files import read_file, read_user_file, user_folder, write_bytes
from jaxlangnav.inputs.documents import MAX_NEST, DocumentError, parse_json, parse_toml, read_text
from jaxlangnav.planner import prior


def fail(path: Path) -> None:
    with atomic_files.replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError("the disk is full")


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = atomic_files.write_text("old", tmp_path / "new" / "folder" / "table.md")
    with pytest.raises(RuntimeError, match="full"):
        fail(path)
    assert path.read_text() == "old"
    assert list(path.parent.iterdir()) == [path]


def test_file_and_folder_are_forced_to_the_disk_before_the_rename_counts(tmp_path, monkeypatch):
    events: list[tuple[str, str]] = []
    fsync, move = os.fsync, Path.replace

    def forced(handle: int) -> None:
        events.append(("force", Path(os.readlink(f"/proc/self/fd/{handle}")).name))
        fsync(handle)

    def moved(self: Path, target: Path) -> Path:
        events.append(("move", self.name))
        return move(self, target)

    monkeypatch.setattr(atomic_files.os, "fsync", forced)
    monkeypatch.setattr(Path, "replace", moved)
    atomic_files.write_text("new", tmp_path / "out" / "table.md")
    made, (first, temporary), (second, same), (third, folder) = events
    assert made == ("force", tmp_path.name)
    assert (first, second, third) == ("force", "move", "force")
    assert temporary == same
    assert temporary.startswith(".table.partial-")
    assert folder == "out"


def test_of_two_writers_one_wins(tmp_path: Path) -> None:
    path = tmp_path / "manifest.json"
    assert atomic_files.write_once(b"mine", path)
    assert not atomic_files.write_once(b"theirs", path)
    assert path.read_bytes() == b"mine"
    assert list(tmp_path.iterdir()) == [path]


@contextmanager
def masked(bits: int) -> Iterator[None]:
    before = os.umask(bits)
    try:
        yield
    finally:
        os.umask(before)


def test_names_and_rights(tmp_path: Path) -> None:
    path = tmp_path / f"{'n' * 240}.md"
    with masked(0o027):
        atomic_files.write_text("long", path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert list(tmp_path.iterdir()) == [path]
    names = []
    for _ in range(2):
        with atomic_files.replacing(path) as temporary:
            names.append(temporary.name)
    assert names[0] != names[1]


# Only regular files of a bounded size are read, and nothing is waited for.


# More than one piece, and as much as is claimed by a file that is refused unread.
@pytest.mark.parametrize("size", [0, 1, 1000, 3_000_000, 1 << 40])
@pytest.mark.parametrize("max_bytes", [1000, 3_000_000])
def test_a_file_within_the_limit_is_read_whole(tmp_path: Path, size: int, max_bytes: int) -> None:
    with (tmp_path / "file").open("wb") as file:
        file.write(os.urandom(min(size, 3_000_000)))
        file.truncate(size)
    (tmp_path / "link").symlink_to(tmp_path / "file")
    if size <= max_bytes:
        for path in (tmp_path / "file", str(tmp_path / "link")):
            assert read_file(path, max_bytes=max_bytes) == (tmp_path / "file").read_bytes()
    else:
        with pytest.raises(ValueError, match=rf"^.*file: has more than {max_bytes:,} bytes.*$"):
            read_file(tmp_path / "file", max_bytes=max_bytes)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc")
def test_the_size_that_a_file_claims_is_not_believed() -> None:
    assert Path("/proc/self/status").stat().st_size == 0
    assert read_file("/proc/self/status", max_bytes=1_000_000).startswith(b"Name:")
    with pytest.raises(ValueError, match="more than 10 bytes"):
        read_file("/proc/self/status", max_bytes=10)


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
            read_file(path, max_bytes=10)


def test_what_cannot_be_opened_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_file(tmp_path / "none", max_bytes=10)
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(tmp_path / "socket"))
        with pytest.raises(OSError, match="socket"):
            read_file(tmp_path / "socket", max_bytes=10)


# What runs as the user comes from folders and files that nobody else can have changed.


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.parametrize("umask", [0o000, 0o077, 0o777])
def test_folders_and_files_are_made_for_the_user_alone(tmp_path: Path, umask: int) -> None:
    with masked(umask):
        folder = user_folder(tmp_path / "a" / "b")
        write_bytes(b"content", folder / "file", is_private=True)
    assert [mode(one) for one in (tmp_path / "a", folder)] == [0o700, 0o700]
    assert mode(folder / "file") == 0o600
    assert read_user_file(folder / "file", max_bytes=7) == b"content"
    assert [one.name for one in folder.iterdir()] == ["file"]


@pytest.mark.parametrize("bits", [0o710, 0o701, 0o720, 0o702, 0o777, 0o1777, 0o2775])
def test_others_can_not_enter_a_folder_nor_exchange_it(tmp_path: Path, bits: int) -> None:
    """Above it they may read, and have their own."""
    user_folder(tmp_path / "a" / "b" / "c")
    (tmp_path / "a").chmod(bits)
    with pytest.raises(PermissionError, match=r"a: others can enter it; remedy: chmod 700"):
        user_folder(tmp_path / "a")
    for below in (Path("b", "c"), Path("new", "c")):
        if bits & 0o022 and not bits & 0o1000:
            with pytest.raises(PermissionError, match=r"a: others can write in it; .*chmod go-w"):
                user_folder(tmp_path / "a" / below)
            assert not (tmp_path / "a" / "new").exists()
        else:
            assert user_folder(tmp_path / "a" / below) == tmp_path / "a" / below


def test_links_are_followed_once_and_where_they_lead_is_judged(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(tmp_path / "real")
    assert user_folder(tmp_path / "link" / "a") == tmp_path / "real" / "a"
    (tmp_path / "real").chmod(0o777)
    with pytest.raises(PermissionError, match="real: others can write in it"):
        user_folder(tmp_path / "link" / "a")
    with pytest.raises(PermissionError, match="real: others can enter it"):
        user_folder(tmp_path / "link")


def test_what_is_another_users_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = user_folder(tmp_path / "a")
    write_bytes(b"content", folder / "file", is_private=True)
    # Whom its owner lets write is no matter there: nobody else can enter.
    (folder / "file").chmod(0o664)
    atomic_files.check_ownership(folder)
    stranger = os.geteuid() + 1
    monkeypatch.setattr(atomic_files.os, "geteuid", lambda: stranger)
    with pytest.raises(PermissionError, match="belongs to another user"):
        user_folder(folder)
    for read in (atomic_files.check_ownership, lambda of: read_user_file(of / "file", max_bytes=9)):
        with pytest.raises(PermissionError, match="file: belongs to another user"):
            read(folder)


@pytest.mark.parametrize("bits", [0o620, 0o602, 0o666])
def test_a_file_that_others_can_write_is_refused(tmp_path: Path, bits: int) -> None:
    write_bytes(b"content", tmp_path / "file", is_private=True)
    (tmp_path / "file").chmod(bits)
    with pytest.raises(PermissionError, match="file: others can write it"):
        read_user_file(tmp_path / "file", max_bytes=9)


def test_what_is_no_file_of_its_own_is_refused(tmp_path: Path) -> None:
    write_bytes(b"content", tmp_path / "file", is_private=True)
    (tmp_path / "link").symlink_to(tmp_path / "file")
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(OSError, match="link"):
        read_user_file(tmp_path / "link", max_bytes=9)
    with pytest.raises(ValueError, match="pipe: is a pipe"):
        read_user_file(tmp_path / "pipe", max_bytes=9)
    with pytest.raises(ValueError, match="more than 6 bytes"):
        read_user_file(tmp_path / "file", max_bytes=6)
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(NotADirectoryError, match="is no folder"):
            user_folder(path)


def test_a_file_that_cannot_be_written_leaves_nothing(tmp_path, monkeypatch):
    write_bytes(b"content", tmp_path / "file", is_private=True)

    def full(*_: object) -> None:
        raise OSError("full")

    monkeypatch.setattr(atomic_files.os, "replace", full)
    with pytest.raises(OSError, match="full"):
        write_bytes(b"new", tmp_path / "file", is_private=True)
    assert [one.name for one in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_bytes() == b"content"


# Arrays from files are numbers of the shape that belongs there, or one line of refusal.


def as_npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (0, 4)])
def test_numbers_are_read_as_they_were_written(shape: tuple[int, ...]) -> None:
    array = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    read = parse_floats(as_npy(array))
    np.testing.assert_array_equal(read, array)
    assert read.dtype == array.dtype
    assert read.shape == shape


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x93NUMPY",
        as_npy(np.zeros(3))[:-1],
        as_npy(np.zeros(3, np.float32)) + b"\0",
        as_npy(np.zeros(3)),
        as_npy(np.array([None])),
        as_npy(np.zeros(3, [("a", "f4")])),
        as_npy(np.array(["text"])),
        as_npy(np.array([""])),
        as_npy(np.array([np.inf], np.float32)),
        b"\x93NUMPY\1\0\x10\x27" + b"(" * 10_000,
    ],
)
def test_anything_else_is_refused_in_one_line(content: bytes) -> None:
    with pytest.raises(ValueError, match=r".") as caught:
        parse_floats(content)
    assert str(caught.value).isprintable()


def test_what_a_library_raises_is_said_in_what_can_be_printed() -> None:
    for error in (KeyError("\x1b[31m\n" * 99), RecursionError(), MemoryError()):
        with pytest.raises(ValueError, match=r"^.{1,200}$") as caught, as_value_error():
            raise error
        assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    "table",
    [
        *(np.ones((15, 9)), np.ones((2, 15, 8)), np.ones(270), -np.ones((2, 15, 9))),
        *(np.full((2, 15, 9), np.nan), ".", "none", "/dev/zero"),
    ],
)
def test_a_prior_that_is_no_table_of_densities_is_refused(tmp_path, table, monkeypatch):
    if not isinstance(table, str):
        np.save(tmp_path / "prior.npy", table.astype(np.float32))
    path = tmp_path / (table if isinstance(table, str) else "prior.npy")
    monkeypatch.setattr(prior, "TABLE_FILE", path)
    with pytest.raises(ValueError, match="not a table of densities"):
        prior.load_table.__wrapped__()


# ------------------------------------------- TOML and JSON from outside: deep, huge and broken ones

DEEP = 100_000


@pytest.mark.parametrize(
    ("parse", "text", "says"),
    [
        (parse_toml, "a = " + "[" * DEEP + "]" * DEEP, "nested more than 32 deep"),
        (parse_toml, "a = " + "[" * 40 + "]" * 40, "nested more than 32 deep"),
        (parse_toml, "a = " + "{a = " * DEEP, "nested more than 32 deep"),
        (parse_toml, ".".join("a" * DEEP) + " = 1", "a key of more than 32 parts"),
        (parse_toml, "[" + " . ".join(['"a"'] * 50) + "]", "a key of more than 32 parts"),
        (parse_toml, "a = " + "1" * 5000, "a number of too many digits"),
        (parse_toml, "a = 0x" + "f" * 5000, "a whole number of 20000 bits"),
        (parse_toml, "a = 2021-02-31", "no such date|is no valid TOML"),
        (parse_toml, "a = 'x", "is no valid TOML"),
        (parse_toml, "a = 1\n" * 3, "is no valid TOML"),
        (parse_toml, "\x00", "is no valid TOML"),
        (parse_json, "[" * DEEP + "]" * DEEP, "nested more than 32 deep"),
        (parse_json, '{"a":' * 40 + "1" + "}" * 40, "nested more than 32 deep"),
        (parse_json, "1" * 5000, "a number of too many digits"),
        (parse_json, "[" + "9" * 30 + "]", "a whole number of 100 bits"),
        (parse_json, "{", "is no valid JSON"),
    ],
    ids=range(16),
)
def test_a_bad_document_is_one_line(parse: Callable, text: str, says: str) -> None:
    with pytest.raises(DocumentError, match=says) as caught:
        parse(text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250


def test_honest_documents_are_read() -> None:
    assert parse_toml("[a.b]\nc = 'a.b.c.d'  # 1.2.3\nd = -1\ne = 1e400\n")["a"]["b"]["d"] == -1
    nested = "[" * MAX_NEST + "]" * MAX_NEST
    assert parse_json(nested)
    assert parse_json('{"a": [1, 2.5, null, "x"]}') == {"a": [1, 2.5, None, "x"]}
    sentence = "go to the cone. " * 200 + "v1.2.3"
    assert parse_toml(f'a = "{sentence}"') == {"a": sentence}


@pytest.mark.parametrize("part", ["aaaa", '""', "' '", '"', "a.", ". a", "'a' ", "-_-"])
def test_a_long_run_of_key_parts_does_not_keep_the_reader_busy(part: str) -> None:
    """With the square of its length, or worse, this would take hours."""
    with pytest.raises(DocumentError):
        parse_toml(part * 500_000)


def test_text_that_is_none_is_named(tmp_path: Path) -> None:
    path = tmp_path / "words.toml"
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match=r"words.toml: is no text: save it as UTF-8"):
        read_text(path, max_bytes=10)
