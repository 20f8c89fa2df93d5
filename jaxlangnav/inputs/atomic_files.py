"""Atomic, durable file writes, and files and folders that only their user can modify.

Content is written to a temporary file of unique name in the same folder, synced to disk (fsync) and
moved to its path in one rename, which is synced too. Readers see the old file or the new one; a
kill, a full disk or a power cut leaves at most a hidden temporary file, whose name begins with a
dot.

A user's folders and files must not be modifiable by others, since whoever writes a file that is
loaded as code runs programs as its reader. Ownership and permissions are checked on the whole real
path from the root down, and links are rejected below it: where nobody else may write, nobody else
can replace a file. Permissions are those of POSIX; on other systems (Windows) every check fails.
"""

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path

_FILE_TYPES = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_OTHERS_ACCESS = stat.S_IRWXG | stat.S_IRWXO
_OPEN_FLAGS = (
    os.O_RDONLY
    | getattr(os, "O_NONBLOCK", 0)
    | getattr(os, "O_NOCTTY", 0)
    | getattr(os, "O_BINARY", 0)
)
"""Flags of ``open``: do not block on a pipe, do not acquire a controlling terminal."""


def read_file(path: str | Path, *, max_bytes: int) -> bytes:
    """Read a whole regular file of at most ``max_bytes`` bytes; links are followed.

    Time and memory are bounded for larger files too, whatever size they claim.

    Raises:
        ValueError: it is no regular file, or has more bytes; the message begins with the path.
        OSError: it cannot be opened or read.
    """
    descriptor = os.open(path, _OPEN_FLAGS)
    try:
        return _read_descriptor(descriptor, path, max_bytes=max_bytes)
    finally:
        os.close(descriptor)


def _read_descriptor(descriptor: int, path: str | Path, *, max_bytes: int) -> bytes:
    """Read an open descriptor as ``read_file`` does; it stays open."""
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        file_type = _FILE_TYPES.get(stat.S_IFMT(mode), "something else")
        raise ValueError(f"{path}: is {file_type}, not a regular file")
    content = bytearray()  # in pieces: growing files and /proc report no true size
    while len(content) <= max_bytes and (piece := os.read(descriptor, 1 << 16)):
        content += piece
    if len(content) > max_bytes:
        limit = f"{max_bytes:,} bytes, the most that such a file may have"
        raise ValueError(f"{path}: has more than {limit}: shorten it")
    return bytes(content)


_MAX_STEM = 100
"""Characters of a file's name that its temporary file repeats; name lengths are limited."""
_SYNC_UNSUPPORTED = (errno.EINVAL, errno.EBADF, errno.ENOTSUP, errno.EACCES)
"""Errors of file systems that do not support syncing a folder."""


@contextlib.contextmanager
def replacing(path: Path, *, is_private: bool = False) -> Iterator[Path]:
    """Replace a file atomically through a temporary file; creates folders.

    Yields the temporary path to write to, with the ending of ``path``; removed if writing fails.
    If ``is_private`` nobody else may read it, whatever the umask (0600).

    Raises:
        OSError: the disk is full, or the folder cannot be written to.
    """
    with _temporary_file(path, is_private=is_private) as temporary:
        yield temporary
        _fsync(temporary)
        temporary.replace(path)
    _fsync(path.parent)


def write_bytes(content: bytes, path: Path, *, is_private: bool = False) -> Path:
    """Write a file atomically, as ``replacing``, and return its path."""
    with replacing(path, is_private=is_private) as temporary:
        temporary.write_bytes(content)
    return path


def write_text(text: str, path: Path) -> Path:
    """Write a text file in UTF-8 atomically and return its path; creates its folder."""
    return write_bytes(text.encode(), path)


def write_once(content: bytes, path: Path) -> bool:
    """Write a file atomically unless it exists; return whether it was written."""
    with _temporary_file(path) as temporary:
        temporary.write_bytes(content)
        _fsync(temporary)
        try:
            os.link(temporary, path)
        except FileExistsError:
            return False
        except OSError:
            # No hard links on this file system: the last writer wins.
            temporary.replace(path)
    _fsync(path.parent)
    return True


def _fsync(path: Path) -> None:
    """Sync a file or folder to disk (fsync)."""
    is_folder = path.is_dir()
    descriptor = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if not is_folder or error.errno not in _SYNC_UNSUPPORTED:
            raise
    finally:
        os.close(descriptor)


def make_folder(folder: Path) -> None:
    """Create a folder and its parents, and sync them to disk."""
    if folder.is_dir():
        return
    make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    _fsync(folder.parent)


@contextlib.contextmanager
def _temporary_file(path: Path, *, is_private: bool = False) -> Iterator[Path]:
    """Create an empty file of unique name in the folder of ``path``; remove it at the end."""
    make_folder(path.parent)
    name = f".{path.stem[:_MAX_STEM]}.partial-{os.getpid()}-{secrets.token_hex(6)}{path.suffix}"
    temporary = path.with_name(name)
    # With the default permissions of a new file, unless it is private.
    mode = 0o600 if is_private else 0o666
    os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode))
    try:
        if is_private:
            temporary.chmod(mode)
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)


# ---------------------------------------------------------------- files of the user alone


def user_folder(path: Path) -> Path:
    """Find or create a folder private to this user (0700), below folders nobody can replace.

    Every folder above must belong to this user or to root and be writable by nobody else, unless it
    is sticky, as ``/tmp`` is. Missing folders are created, 0700 whatever the umask. Returns the
    real path, free of links.

    Raises:
        OSError: it cannot be created, or a check fails; the message names the folder, the reason
            and the remedy.
    """
    if os.name != "posix":
        raise PermissionError(f"{path}: this system does not tell whose it is")
    real = Path(os.path.realpath(path))
    for folder in (*reversed(real.parents), real):
        try:
            os.mkdir(folder, 0o700)
            os.chmod(folder, 0o700)
        except OSError:
            # On a read-only root the error is another one than that the folder exists.
            if not os.path.lexists(folder):
                raise
        status = os.lstat(folder)
        if not stat.S_ISDIR(status.st_mode):
            raise NotADirectoryError(f"{folder}: is no folder")
        if status.st_uid != os.geteuid() and (status.st_uid != 0 or folder == real):
            raise PermissionError(f"{folder}: belongs to another user")
        if folder == real and status.st_mode & _OTHERS_ACCESS:
            raise PermissionError(f"{real}: others can enter it; remedy: chmod 700")
        if status.st_mode & _OTHERS_WRITE and not status.st_mode & stat.S_ISVTX:
            raise PermissionError(f"{folder}: others can write in it; remedy: chmod go-w")
    return real


def check_ownership(folder: Path) -> None:
    """Raise ``OSError`` if a file in a folder from ``user_folder`` belongs to another user.

    The owner of a file may have made it writable for others, such as for a group.

    Raises:
        OSError: a file belongs to another user; the message says which.
    """
    for path in folder.iterdir():
        if os.lstat(path).st_uid != os.geteuid():
            raise PermissionError(f"{path}: belongs to another user; remedy: remove it")


def read_user_file(path: Path, *, max_bytes: int) -> bytes:
    """Read a file of at most ``max_bytes`` bytes that only this user may write; links are rejected.

    Its folder is one from ``user_folder``.

    Raises:
        ValueError: it is no regular file, or has more bytes.
        OSError: a check fails, or it cannot be read.
    """
    descriptor = os.open(path, _OPEN_FLAGS | os.O_NOFOLLOW)
    try:
        status = os.fstat(descriptor)
        if status.st_uid != os.geteuid():
            raise PermissionError(f"{path}: belongs to another user")
        if status.st_mode & _OTHERS_WRITE:
            raise PermissionError(f"{path}: others can write it")
        return _read_descriptor(descriptor, path, max_bytes=max_bytes)
    finally:
        os.close(descriptor)
