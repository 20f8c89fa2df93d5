"""What a command sets up before JAX computes: the kept programs, and progress on the terminal."""

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from jaxlangnav.commands.output import Output

Advance = Callable[[int], None]
"""Called with the number of pieces of work just done."""


def cache_directory() -> Path:
    """Find the user's cache folder: XDG_CACHE_HOME, or .cache in the home folder."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "jaxlangnav"


def keep_compiled_programs() -> None:
    """Let JAX keep what it compiles, so that the next run of a command answers fast.

    A folder named by JAX_COMPILATION_CACHE_DIR is respected; where the folder cannot be written,
    programs are compiled anew each time and nothing else changes.
    """
    import jax

    from jaxlangnav.kept import keep_in

    if getattr(jax.config, "jax_compilation_cache_dir", None) is None:
        directory = cache_directory() / "compiled"
        with contextlib.suppress(OSError):
            directory.mkdir(parents=True, exist_ok=True)
        if not os.access(directory, os.W_OK):
            return
        jax.config.update("jax_compilation_cache_dir", str(directory))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    folder = str(getattr(jax.config, "jax_compilation_cache_dir", None))
    keep_in(None if "://" in folder else Path(folder) / "whole")


@contextlib.contextmanager
def waiting(what: str, output: Output, *, seconds: float = 5.0) -> Iterator[None]:
    """Show that something is under way that has no steps to count, and for how long.

    Args:
        what: is being done.
        output: where a note goes if nobody watches a terminal.
        seconds: after which it is noted.

    Yields:
        Nothing; do the work inside.
    """
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
        with Progress(*columns, console=Console(file=sys.stderr), transient=True) as bar:
            bar.add_task(what, total=None)
            yield
        return
    timer = threading.Timer(seconds, output.note, [what])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextlib.contextmanager
def progress_bar(what: str, total: int) -> Iterator[Advance]:
    """Show work done, rate and time left on standard error, where a person is watching.

    Args:
        what: is being done, for example "episodes".
        total: pieces of work.

    Yields:
        A function to call with the number of pieces just done.
    """
    if not sys.stderr.isatty():
        yield lambda _done: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(file=sys.stderr), transient=True) as bar:
        task = bar.add_task(what, total=total, rate="")

        def advance(done: int) -> None:
            bar.advance(task, done)
            speed = bar.tasks[0].speed
            bar.update(task, rate=f"{speed:.0f}/s" if speed else "")

        yield advance
