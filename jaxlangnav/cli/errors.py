"""What a person did that cannot be done: one line, exit code 2."""

import difflib
import os
import sys
from collections.abc import Iterable

from jaxlangnav.inputs.sanitize import cut, printable

_PLATFORMS = "JAX_PLATFORMS"
_ENDING = 200
"""Characters at the end of a longer complaint that stay."""
_NO_BACKEND = "Unable to initialize backend"
"""Environment variable that tells JAX where to compute."""
_LONGEST = 600
"""Characters of the one line: a path or a value may be of any length."""


class UsageError(ValueError):
    """Bad input from the command line; the message is one line that names value and remedy."""


def one_line(error: BaseException) -> str:
    """Say an error in one printable line, cut in its middle; its type's name if it says nothing."""
    message = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, OSError) and error.strerror:
        where = f"{cut(str(error.filename), _LONGEST // 2)}: " if error.filename is not None else ""
        message = f"{where}{error.strerror}"
    message = printable(message)
    if len(message) <= _LONGEST:
        return message
    # What was given stands first, why it is refused last: neither may push the other out.
    return f"{message[: _LONGEST - _ENDING - 1]}…{message[-_ENDING:]}"


def is_refusal(error: BaseException) -> bool:
    """Tell bad input from a fault of ours.

    The package refuses bad input by raising a ``ValueError`` itself; one that comes out of the
    depth of a library is a fault. Files that cannot be read or written are the person's matter.
    """
    if isinstance(error, OSError):
        return True
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    raised_in = trace.tb_frame.f_globals.get("__name__", "") if trace is not None else ""
    is_ours = raised_in.split(".")[0] == "jaxlangnav"
    return isinstance(error, UsageError) or (isinstance(error, ValueError) and is_ours)


def platform_fault(failure: Exception) -> str | None:
    """Find out after a failure whether JAX was told to compute on what is not here; else None.

    Of several platforms one may be here and another not: JAX then fails the first time only.
    """
    jax, named = sys.modules.get("jax"), os.environ.get(_PLATFORMS)
    if jax is None or not named:
        return None
    try:
        is_here = _NO_BACKEND not in str(failure) and bool(jax.devices())
    except (RuntimeError, AssertionError):
        is_here = False
    if is_here:
        return None
    return (
        f'{_PLATFORMS} is "{cut(named)}", but JAX can compute on no such device here: '
        "unset it, or set it to cpu"
    )


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Suggest the nearest known name, '; did you mean "follow"?'; nothing where none is near."""
    lower = {one.lower(): one for one in known}
    near = difflib.get_close_matches(name.lower(), lower, n=1, cutoff=0.6)
    return f'; did you mean "{lower[near[0]]}"?' if near else ""
