"""What numbers from outside may be: single precision computes with them and with their squares."""

from typing import Any

FARTHEST = 1e5
"""Metres that a place or a length may have: float32 is 8 mm coarse there."""
SHORTEST = 1e-3
"""Metres that a step has at least."""
RANGES = (0.01, 1e4)
"""Metres, shortest and longest sensing range."""
LARGEST = 1e15
"""Of a plain number."""
SMALLEST = 1e-15
"""Of a plain number other than zero."""


def refuse_below(least: int, **counts: Any) -> None:
    """Refuse a count that is too small, by its name, with a ValueError of one line."""
    for name, value in counts.items():
        if value < least:
            raise ValueError(f"{name} is {value}, but must be at least {least}")
