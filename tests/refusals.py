"""Refusals: what cannot be is refused in one line that says why."""

from collections.abc import Callable, Iterable

import pytest


def assert_refused(refusals: Iterable[tuple[Callable[[], object], str]]) -> None:
    for number, (call, said) in enumerate(refusals):
        with pytest.raises(ValueError, match=said) as refusal:
            call()
        assert "\n" not in str(refusal.value), number
