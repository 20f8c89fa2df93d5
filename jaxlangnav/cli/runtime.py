"""CLI runtime support: compilation cache, progress display, duration estimates."""

import contextlib
import functools
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from jaxlangnav.cli.output import Output, one_line

Advance = Callable[[int], None]  # called with the number of items just completed
_INTERVAL = 60.0  # seconds between lines of progress where there is no terminal
_FIRST_LINE_DELAY = 5.0  # seconds before the first line of a task of unknown duration
_DURATIONS = "durations.json"  # file of the last duration of each task: [number of items, seconds]


def _cache_path(name: str) -> Path:
    """Return a path in the user's cache directory; it need not exist."""
    from platformdirs import user_cache_path

    path = user_cache_path("jaxlangnav") / name
    if not path.is_absolute():
        raise FileNotFoundError("there is no home folder; XDG_CACHE_HOME can name another")
    return path


def keep_compiled_programs() -> None:
    """Enable the persistent caches of compiled programs, so that later runs start fast.

    The first run compiles faster too (``compile_fast``).
    A folder named by JAX_COMPILATION_CACHE_DIR stays JAX's own; our programs lie below it if it is
    the user's alone to write, else in the user's cache folder, as JAX's do where none is named.
    Where no folder can be used, one line says so. JAX_ENABLE_COMPILATION_CACHE=false keeps none.
    """
    import jax

    from jaxlangnav.inputs.atomic_files import check_ownership, user_folder
    from jaxlangnav.inputs.program_cache import set_cache_dir

    compile_fast()
    if not getattr(jax.config, "jax_enable_compilation_cache", True):
        return
    note = Output(is_json=False).note
    jax_folder = getattr(jax.config, "jax_compilation_cache_dir", None)
    try:
        if jax_folder is None:
            # JAX executes what it loads, so other users must not write there.
            folder = user_folder(_cache_path("xla"))
            check_ownership(folder)
            jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
        program_dir = None
        if jax_folder and "://" not in jax_folder:
            with contextlib.suppress(OSError):
                program_dir = user_folder(Path(jax_folder) / "programs")
        set_cache_dir(program_dir or user_folder(_cache_path("programs")), say=note)
    except OSError as error:
        note(f"compiled programs are not kept: {one_line(error)}")


def compile_fast() -> None:
    """Switch XLA's fusion emitters off on the CPU, unless JAX has run something before.

    A decision cycle compiles in 2/3 of the CPU time and half the memory, and runs as fast.
    """
    import jax

    flag, given = "--xla_cpu_use_fusion_emitters=", os.environ.get("XLA_FLAGS", "")
    # Later versions lack the flag, and XLA ends the process on flags that it does not know.
    if jax.__version_info__ < (0, 11) and flag not in given:
        os.environ["XLA_FLAGS"] = f"{given} {flag}false".strip()


def duration_text(seconds: float) -> str:
    """Format an estimate for people: "20 s", "6 min"."""
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.0f} min"


def expected_duration(task: str, num_items: int = 1, *, default: tuple[int, float]) -> float:
    """Estimate the seconds of a task from its last run on this machine; ``default`` if none.

    ``default``: number of items, and seconds on two cores; from it are the seconds of each further
    item after a smaller run, which has mostly compiled. Fewer items take as long as the last time.
    """
    last_num_items, seconds = default
    with contextlib.suppress(OSError, ValueError, TypeError, LookupError):
        last_num_items, seconds = map(float, json.loads(_cache_path(_DURATIONS).read_text())[task])
    count, total = max(default, (last_num_items, seconds))
    return seconds + max(0.0, num_items - last_num_items) * total / max(1.0, count)


def save_duration(task: str, seconds: float, num_items: int = 1) -> None:
    """Store the duration of a task for ``expected_duration``, if there is a cache folder."""
    from jaxlangnav.inputs.atomic_files import write_text

    with contextlib.suppress(OSError):
        path, durations = _cache_path(_DURATIONS), {}
        with contextlib.suppress(OSError, ValueError, TypeError):
            durations = dict(json.loads(path.read_text()))
        write_text(json.dumps({**durations, task: (num_items, round(seconds, 1))}), path)


@contextlib.contextmanager
def spinner(label: str, task: str | None = None, *, default_seconds: float = 0.0) -> Iterator[None]:
    """Show a spinner on a terminal; elsewhere print a line after five seconds, then each minute.

    If a ``task`` is named, the label tells how many seconds it took when it last took more than
    five, or ``default_seconds``: what is kept from an earlier run takes less.
    """
    begin = time.monotonic()
    if task is not None:
        label += f"; about {duration_text(expected_duration(task, default=(1, default_seconds)))}"
    with progress_bar(label, None, delay=_FIRST_LINE_DELAY):
        yield
    seconds = time.monotonic() - begin
    if task is not None and seconds > _FIRST_LINE_DELAY:
        save_duration(task, seconds)


@contextlib.contextmanager
def progress_bar(label: str, total: int | None, delay: float = _INTERVAL) -> Iterator[Advance]:
    """Show a progress bar on a terminal, a spinner without total; yields its advance function.

    Where there is no terminal it prints a line after ``delay`` seconds, then one a minute.
    """
    if not sys.stderr.isatty():
        with _progress_lines(label, total, delay) as advance:
            yield advance
        return
    from rich import progress as rich
    from rich.console import Console

    text, elapsed = "{task.description}", rich.TimeElapsedColumn()
    columns = [rich.SpinnerColumn(), text, elapsed]
    if total is not None:
        columns = [text, rich.BarColumn(), rich.MofNCompleteColumn(), elapsed]
        columns += ["left", rich.TimeRemainingColumn()]
    with rich.Progress(*columns, console=Console(file=sys.stderr), transient=True) as bar:
        yield functools.partial(bar.advance, bar.add_task(label, total=total))


@contextlib.contextmanager
def _progress_lines(label: str, total: int | None, delay: float) -> Iterator[Advance]:
    """Print the progress as lines, from a thread, until the context ends."""
    is_done, begin, counts = threading.Event(), time.monotonic(), list[int]()

    def report() -> None:
        wait = delay
        while not is_done.wait(wait):
            elapsed, wait = time.monotonic() - begin, _INTERVAL
            progress = "" if total is None else f": {sum(counts)} of {total}"
            since = "" if elapsed < _INTERVAL else f", for {duration_text(elapsed)}"
            Output(is_json=False).note(f"{label}{progress}{since}")

    threading.Thread(target=report, daemon=True).start()
    try:
        yield counts.append
    finally:
        is_done.set()
