"""Who works on which part of a sweep: a lock that names its holder.

A part i/n of a folder is held by a lock on the file ``.held-i-of-n.json``, which names host,
process and time. The lock is the kernel's (``flock``): it ends with its holder, however that dies,
so a dead holder's part is simply taken over. Parts that share files (1/1 and 2/8, or 1/2 and
3/4) exclude each other; parts that share none run side by side, on any number of hosts.

On NFS Linux carries the lock to the server, where it ends when the host's lease does. A file
system without locks is used without one, and that is said: results do not depend on the lock,
since every file is written whole, under a temporary name of its own, with the same bytes whoever
writes it. Two processes at one part then only do the same work twice.
"""

import contextlib
import datetime
import errno
import fcntl
import json
import math
import os
import re
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

from jaxlangnav.files.whole import make_folder

Note = Callable[[str], None]
"""Called with a line for people."""
PartOf = tuple[int, int]
"""i and n, 1 ≤ i ≤ n: the files i, i + n, i + 2n, …"""
_NAME = re.compile(r"\.held-(\d+)-of-(\d+)\.json")
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)


@contextlib.contextmanager
def held(folder: Path, part: PartOf, *, on_note: Note) -> Iterator[bool]:
    """Hold a part of a folder, so that no second process works on the same files.

    Args:
        folder: of the sweep; made if it is not there.
        part: i and n.
        on_note: told whose lock was taken over, and where there are no locks.

    Yields:
        Whether the part is held; False where the file system has no locks.

    Raises:
        ValueError: a living process holds it, or a part that shares files with it.
    """
    make_folder(folder)
    path = folder / f".held-{part[0]}-of-{part[1]}.json"
    try:
        handle = _lock(path, on_note)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        path.unlink(missing_ok=True)
        on_note(
            f"note: {folder} cannot be locked ({error.strerror}): see that nobody else is at it"
        )
        yield False
        return
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    name = {"host": socket.gethostname(), "pid": os.getpid(), "since": now}
    try:
        os.truncate(handle, os.pwrite(handle, json.dumps(name).encode(), 0))
        _refuse_overlaps(folder, part, on_note)
        yield True
    finally:
        path.unlink(missing_ok=True)
        os.close(handle)


def _lock(path: Path, on_note: Note) -> int:
    """Take the lock of a file, as its only holder."""
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _take(handle, path)
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(handle), path.stat()):
                    break
        except BaseException:
            os.close(handle)
            raise
        # Its last holder has removed it between opening and locking: what is locked is gone.
        os.close(handle)
    if os.fstat(handle).st_size:
        on_note(f"note: {path.parent}: took over from {_holder(path)}, which is gone")
    return handle


def _take(handle: int, path: Path) -> None:
    """Lock an open file, or say who has it."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        part = path.name.removeprefix(".held-").removesuffix(".json").replace("-of-", "/")
        raise ValueError(
            f"{path.parent}: {_holder(path)} is at work on part {part}: let it end, or end it; "
            "parts that share no files with it (--shard) can run beside it"
        ) from None


def _refuse_overlaps(folder: Path, part: PartOf, on_note: Note) -> None:
    """Refuse where a living process holds files of this part; clear away what dead ones left."""
    for path in folder.iterdir():
        match = _NAME.fullmatch(path.name)
        if match is None:
            continue
        place, number = int(match[1]), int(match[2])
        if (place, number) == part or (place - part[0]) % math.gcd(part[1], number):
            continue
        with contextlib.suppress(FileNotFoundError):
            handle = os.open(path, os.O_RDWR)
            try:
                _take(handle, path)
                on_note(f"note: {folder}: took over from {_holder(path)}, which is gone")
                path.unlink()
            finally:
                os.close(handle)


def _holder(path: Path) -> str:
    """Name who wrote a lock's file, for people."""
    try:
        who = json.loads(path.read_text("utf-8"))
        return f"process {who['pid']} on {who['host']} since {who['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "a process that has not said its name"
