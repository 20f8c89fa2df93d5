"""Files are written whole or not at all, and stay written: the one place that does it.

What is written goes into a temporary file of its own name beside the place, is forced to the
disk, takes the place in one move, and the move is forced to the disk too. Whoever reads meets
the old file or the new one; a kill, a full disk or a power cut leaves at most a hidden temporary
file, whose name begins with a dot.

Own folders and files are the user's, and nobody else can have changed them: whoever can write a
file that is loaded as code runs programs as its reader. What guards against people is who owns a
file and who may write it, on the whole way from the root. The folder's real path is walked from the
root down, and links are refused below it: what nobody else may write in, nobody else can exchange.
Permissions are those of POSIX; where a system has no owners of files (Windows), nothing passes.
"""

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path

_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}
_PIECE = 1 << 20
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_OTHERS = stat.S_IRWXG | stat.S_IRWXO
_OPEN_FLAGS = (
    os.O_RDONLY
    | getattr(os, "O_NONBLOCK", 0)
    | getattr(os, "O_NOCTTY", 0)
    | getattr(os, "O_BINARY", 0)
)
"""With which a path is opened: a pipe is not waited for, a terminal does not become ours."""


def read_file(path: str | Path, *, at_most: int) -> bytes:
    """Read a regular file of ``at_most`` bytes whole; links are followed.

    Neither time nor memory grows with a larger one, whatever size it claims.

    Raises:
        ValueError: it is no regular file, or has more bytes; the message begins with the path.
        OSError: it cannot be opened or read.
    """
    descriptor = os.open(path, _OPEN_FLAGS)
    try:
        return _read_opened(descriptor, path, at_most=at_most)
    finally:
        os.close(descriptor)


def _read_opened(descriptor: int, path: str | Path, *, at_most: int) -> bytes:
    """Read what has been opened, as ``read_file`` does; the descriptor stays open."""
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        kind = _KINDS.get(stat.S_IFMT(status.st_mode), "something else")
        raise ValueError(f"{path}: is {kind}, not a regular file")
    content = bytearray()
    # One byte more tells that there is more; a growing file, or /proc, states no true size.
    while status.st_size <= at_most and len(content) <= at_most:
        piece = os.read(descriptor, min(_PIECE, at_most + 1 - len(content)))
        if not piece:
            return bytes(content)
        content += piece
    raise ValueError(
        f"{path}: has more than {at_most:,} bytes, the most that such a file may have: shorten it"
    )


_KEPT_OF_NAME = 100
"""Characters of a file's name that its temporary one repeats: names may not be endless."""
_CANNOT_SYNC = (errno.EINVAL, errno.EBADF, errno.ENOTSUP, errno.EACCES)
"""What file systems answer that do not know how to force a folder to the disk."""


@contextlib.contextmanager
def replacing(path: Path, *, is_private: bool = False) -> Iterator[Path]:
    """Write a file beside its place and move it there at the end; folders are made.

    Yields the temporary path to write to, with the ending of ``path``; removed if writing fails.
    If ``is_private`` nobody else may read it, whatever the umask (0600).

    Raises:
        OSError: the disk is full, or the folder cannot be written to.
    """
    with _temporary(path, is_private=is_private) as temporary:
        yield temporary
        _force(temporary)
        temporary.replace(path)
    _force(path.parent)


def write_bytes(content: bytes, path: Path) -> Path:
    """Write a file, all or nothing, and return its path; its folder is made."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)
    return path


def write_text(text: str, path: Path) -> Path:
    """Write a text file in UTF-8, all or nothing, and return its path; its folder is made."""
    return write_bytes(text.encode(), path)


def write_once(content: bytes, path: Path) -> bool:
    """Write a file, all or nothing, unless there is one; tell whether this writer has won."""
    with _temporary(path) as temporary:
        temporary.write_bytes(content)
        _force(temporary)
        try:
            os.link(temporary, path)
        except FileExistsError:
            return False
        except OSError:
            # No second names on this file system: the last writer wins.
            temporary.replace(path)
    _force(path.parent)
    return True


def _force(path: Path) -> None:
    """Force to the disk what a file holds, or which files a folder does."""
    is_folder = path.is_dir()
    handle = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR)
    try:
        os.fsync(handle)
    except OSError as error:
        if not is_folder or error.errno not in _CANNOT_SYNC:
            raise
    finally:
        os.close(handle)


def make_folder(folder: Path) -> None:
    """Make a folder and those above it, and force to the disk that they are there."""
    if folder.is_dir():
        return
    make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    _force(folder.parent)


@contextlib.contextmanager
def _temporary(path: Path, *, is_private: bool = False) -> Iterator[Path]:
    """Make an empty file beside a place, of a name that nobody else has; remove what is left."""
    make_folder(path.parent)
    name = f".{path.stem[:_KEPT_OF_NAME]}.partial-{os.getpid()}-{secrets.token_hex(6)}{path.suffix}"
    temporary = path.with_name(name)
    # Made with the rights that any new file would get here, unless it is private.
    mode = 0o600 if is_private else 0o666
    os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode))
    try:
        if is_private:
            temporary.chmod(mode)
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)


# ---------------------------------------------------------------- the user's own


def own_folder(path: Path) -> Path:
    """Find or make a folder that only this user may enter (0700), below folders nobody can swap.

    Every folder above must belong to this user or to root and be writable by nobody else, but for
    those in which one may rename only what one owns (sticky, as ``/tmp`` is). Folders that are
    missing are made, 0700 whatever the umask. Returns the real path, free of links.

    Raises:
        OSError: it cannot be made, or does not pass; the message says which folder, why and what
            to do about it.
    """
    if os.name != "posix":
        raise PermissionError(f"{path}: this system does not tell whose it is")
    real = Path(os.path.realpath(path))
    for one in (*reversed(real.parents), real):
        try:
            os.mkdir(one, 0o700)
            os.chmod(one, 0o700)
        except OSError:
            # A root that cannot be written says so in place of saying that it exists.
            if not os.path.lexists(one):
                raise
        status = os.lstat(one)
        if not stat.S_ISDIR(status.st_mode):
            raise NotADirectoryError(f"{one}: is no folder")
        if status.st_uid != os.geteuid() and (status.st_uid != 0 or one == real):
            raise PermissionError(f"{one}: belongs to another user")
        if one == real and status.st_mode & _OTHERS:
            raise PermissionError(f"{real}: others can enter it; remedy: chmod 700")
        if status.st_mode & _OTHERS_WRITE and not status.st_mode & stat.S_ISVTX:
            raise PermissionError(f"{one}: others can write in it; remedy: chmod go-w")
    return real


def check_own_files(folder: Path) -> None:
    """Refuse a folder that ``own_folder`` has passed in which a file is another user's.

    Whoever made the files may have let others write them, as many do with those of their group.

    Raises:
        OSError: a file belongs to another user; the message says which.
    """
    for path in folder.iterdir():
        if os.lstat(path).st_uid != os.geteuid():
            raise PermissionError(f"{path}: belongs to another user; remedy: remove it")


def read_own_file(path: Path, *, at_most: int) -> bytes:
    """Read a file of this user's that nobody else may write, of so many bytes; no link to one.

    Its folder is one that ``own_folder`` has passed.

    Raises:
        ValueError: it is no regular file, or has more bytes.
        OSError: it does not pass, or cannot be read.
    """
    descriptor = os.open(path, _OPEN_FLAGS | os.O_NOFOLLOW)
    try:
        status = os.fstat(descriptor)
        if status.st_uid != os.geteuid():
            raise PermissionError(f"{path}: belongs to another user")
        if status.st_mode & _OTHERS_WRITE:
            raise PermissionError(f"{path}: others can write it")
        return _read_opened(descriptor, path, at_most=at_most)
    finally:
        os.close(descriptor)


def write_own_file(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, 0600 whatever the umask; one that is there is replaced.

    Raises:
        OSError: it cannot be written; nothing is left behind.
    """
    with replacing(path, is_private=True) as temporary:
        temporary.write_bytes(content)
