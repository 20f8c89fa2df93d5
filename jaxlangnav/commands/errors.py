"""What a person did that cannot be done: one line, exit code 2."""

import difflib
from collections.abc import Iterable


class UsageError(ValueError):
    """Bad input from the command line; the message is one line that names value and remedy."""


def one_line(error: BaseException) -> str:
    """Say an error in one line.

    Args:
        error: any exception.

    Returns:
        Its message with line breaks folded, or its type's name where it says nothing.
    """
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename is not None else ""
        return f"{where}{error.strerror}"
    return " ".join(str(error).split()) or type(error).__name__


def is_refusal(error: BaseException) -> bool:
    """Tell bad input from a fault of ours.

    The package refuses bad input by raising a ``ValueError`` itself; one that comes out of the
    depth of a library is a fault. Files that cannot be read or written are the person's matter.

    Args:
        error: caught at the top.

    Returns:
        Whether it is to be said as bad input.
    """
    if isinstance(error, OSError):
        return True
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    raised_in = trace.tb_frame.f_globals.get("__name__", "") if trace is not None else ""
    is_ours = raised_in.split(".")[0] == "jaxlangnav"
    return isinstance(error, UsageError) or (isinstance(error, ValueError) and is_ours)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Suggest the nearest known name.

    Args:
        name: what was typed.
        known: what would have been understood.

    Returns:
        '; did you mean "follow"?', or the empty string where nothing is near.
    """
    lower = {one.lower(): one for one in known}
    near = difflib.get_close_matches(name.lower(), lower, n=1, cutoff=0.6)
    return f'; did you mean "{lower[near[0]]}"?' if near else ""
