"""What is refused says why in one line."""

import contextlib
from collections.abc import Iterator

import pytest


@contextlib.contextmanager
def refused(why: str, kind: type[Exception] = ValueError) -> Iterator[pytest.ExceptionInfo]:
    """Expect an error whose message is one line in which a pattern is found."""
    with pytest.raises(kind, match=why) as error:
        yield error
    assert "\n" not in str(error.value)
