"""Folders and files that are the user's own, and that nobody else can have changed.

Whoever can write a file that is loaded as code runs programs as its reader. What guards against
people is who owns a file and who may write it, on the whole way from the root; a checksum that
stands in the file itself guards against accidents only. Links are refused below the folder's real
path, which is walked from the root down: what nobody else may write in, nobody else can exchange
behind our back, so no step of the walk can be undone by the next.

Permissions are those of POSIX; an access list shows in them as its mask. Where a system has no
owners of files (Windows), nothing passes.
"""

import os
import stat
from pathlib import Path

from jaxlangnav.inputs.whole_files import OPEN_FLAGS, read_opened, replacing

_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


def own_folder(path: Path) -> Path:
    """Find or make a folder that only this user may enter (0700), below folders nobody can swap.

    Every folder above must belong to this user or to root and be writable by nobody else, but for
    those in which one may rename only what one owns (sticky, as ``/tmp`` is). Folders that are
    missing are made, 0700 whatever the umask.

    Args:
        path: of the folder.

    Returns:
        Its real path, free of links.

    Raises:
        OSError: it cannot be made, or does not pass; the message says which folder, why and what
            to do about it.
    """
    if os.name != "posix":
        raise PermissionError(f"{path}: this system does not tell whose it is")
    real = Path(os.path.realpath(path))
    for one in (*reversed(real.parents), real):
        _make(one)
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
    """Refuse a folder in which a file is another user's, however it came there.

    ``own_folder`` has passed it, so nobody else can enter. Whoever made the files may have let
    others write them, as many do with those of their group.

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
    descriptor = os.open(path, OPEN_FLAGS | os.O_NOFOLLOW)
    try:
        status = os.fstat(descriptor)
        if status.st_uid != os.geteuid():
            raise PermissionError(f"{path}: belongs to another user")
        if status.st_mode & _OTHERS_WRITE:
            raise PermissionError(f"{path}: others can write it")
        return read_opened(descriptor, path, at_most=at_most)
    finally:
        os.close(descriptor)


def write_own_file(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, 0600 whatever the umask; one that is there is replaced.

    Raises:
        OSError: it cannot be written; nothing is left behind.
    """
    with replacing(path, is_private=True) as temporary:
        temporary.write_bytes(content)


def _make(folder: Path) -> None:
    """Make a folder if there is none; those above it are there."""
    try:
        os.mkdir(folder, 0o700)
        os.chmod(folder, 0o700)
    except FileExistsError:
        pass
    except OSError:
        # A root that cannot be written says so in place of saying that it exists.
        if not os.path.lexists(folder):
            raise
