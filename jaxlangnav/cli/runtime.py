"""Set-up of a command: the persistent compilation cache and progress bars."""

import contextlib
import functools
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from jaxlangnav.cli.output import Output, one_line

Advance = Callable[[int], None]  # called with the number of items just completed


def _cache_folder(name: str) -> Path:
    """Return the path of a folder in the user's cache directory, which need not exist."""
    from platformdirs import user_cache_path

    path = user_cache_path("jaxlangnav") / name
    if not path.is_absolute():
        raise FileNotFoundError("there is no home folder; XDG_CACHE_HOME can name another")
    return path


def keep_compiled_programs() -> None:
    """Enable the persistent caches of compiled programs, so that later runs start fast.

    A folder named by JAX_COMPILATION_CACHE_DIR stays JAX's own; our programs lie below it if it is
    the user's alone to write, else in the user's cache folder, as JAX's do where none is named.
    Where no folder can be used, one line says so. JAX_ENABLE_COMPILATION_CACHE=false keeps none.
    """
    import jax

    from jaxlangnav.inputs.program_cache import set_cache_dir
    from jaxlangnav.inputs.whole_files import check_user_files, user_folder

    if not getattr(jax.config, "jax_enable_compilation_cache", True):
        return
    note = Output(is_json=False).note
    jax_folder = getattr(jax.config, "jax_compilation_cache_dir", None)
    try:
        if jax_folder is None:
            # JAX executes what it loads, so other users must not write there.
            folder = user_folder(_cache_folder("xla"))
            check_user_files(folder)
            jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
        programs = None
        if jax_folder and "://" not in jax_folder:
            with contextlib.suppress(OSError):
                programs = user_folder(Path(jax_folder) / "programs")
        set_cache_dir(programs or user_folder(_cache_folder("programs")), say=note)
    except OSError as error:
        note(f"compiled programs are not kept: {one_line(error)}")


@contextlib.contextmanager
def spinner(label: str, output: Output) -> Iterator[None]:
    """Show a spinner on a terminal; elsewhere print a note after five seconds."""
    timer = threading.Timer(5.0, output.note, [label])
    timer.daemon = True
    if not sys.stderr.isatty():
        timer.start()
    try:
        with progress_bar(label, None):
            yield
    finally:
        timer.cancel()


@contextlib.contextmanager
def progress_bar(label: str, total: int | None) -> Iterator[Advance]:
    """Show a progress bar on a terminal, a spinner without total; yields its advance function."""
    if not sys.stderr.isatty():
        yield lambda _done: None
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
