"""Files that somebody names are read whole, with a limit, and only if they are files.

A path from outside may lead to a pipe that never ends or never begins, to ``/dev/zero``, to a
folder, or to more than the memory holds. Whoever reads one says how much is enough for any honest
file of its kind.
"""

import os
import stat
from pathlib import Path

_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}
_PIECE = 1 << 20
OPEN_FLAGS = (
    os.O_RDONLY
    | getattr(os, "O_NONBLOCK", 0)
    | getattr(os, "O_NOCTTY", 0)
    | getattr(os, "O_BINARY", 0)
)
"""With which a path is opened: a pipe is not waited for, a terminal does not become ours."""


def read_file(path: str | Path, *, at_most: int) -> bytes:
    """Read a regular file whole; links are followed.

    Limits: a file of exactly ``at_most`` bytes is read; neither time nor memory grows with one
    that is larger, whatever size it claims.

    Args:
        path: of the file.
        at_most: bytes, the limit.

    Returns:
        Its bytes.

    Raises:
        ValueError: it is no regular file, or has more bytes; the message begins with the path.
        OSError: it cannot be opened or read.
    """
    descriptor = os.open(path, OPEN_FLAGS)
    try:
        return read_opened(descriptor, path, at_most=at_most)
    finally:
        os.close(descriptor)


def read_opened(descriptor: int, path: str | Path, *, at_most: int) -> bytes:
    """Read what has been opened, as ``read_file`` does.

    Args:
        descriptor: opened for reading; it stays open.
        path: what it is called in a refusal.
        at_most: bytes, the limit.

    Returns:
        Its bytes.

    Raises:
        ValueError: as ``read_file``.
        OSError: it cannot be read.
    """
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
