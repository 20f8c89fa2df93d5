"""What numbers from outside may be: single precision computes with them and with their squares.

A bare number is in its own unit: metres, radians, or a share of one. With a unit, "30 cm",
"360 deg" or "2 %", it is converted; a unit of another kind is refused.
"""

import dataclasses
import math
import re
from typing import Any

from jaxlangnav.inputs.sanitize import as_text, quote, shorten

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
VIEWS = (1e-3, math.tau + 1e-3)
"""Radians, narrowest and widest field of view."""
MOST_FALSE, MOST_WRONG = 100.0, 0.99
"""False detections of one type expected in a look; share of wrong labels."""


def refuse_below(least: int, **counts: Any) -> None:
    """Refuse a count that is too small, by its name, with a ValueError of one line."""
    for name, value in counts.items():
        if value < least:
            raise ValueError(f"{name} is {value}, but must be at least {least}")


def is_complex(value: Any) -> bool:
    """Tell whether an array is of complex numbers, which NumPy would cut to real ones."""
    return getattr(getattr(value, "dtype", None), "kind", "") == "c"


def number(value: Any, what: str) -> float:
    """Read a finite number, or an array of one, or refuse what it is with a ValueError."""
    try:
        if isinstance(value, str | bytes) or is_complex(value):
            raise TypeError
        read = float(value.reshape(()) if hasattr(value, "reshape") else value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{what} is {quote(value)}, but must be a number") from None
    if not math.isfinite(read):
        raise ValueError(f"{what} is {read}, but must be finite")
    return read


def bounded(value: Any, low: float, high: float, what: str, remedy: str) -> float:
    """Read a number, or an array of one, between two bounds, or refuse it with a ValueError."""
    read = number(value, what)
    if not low <= read <= high:
        raise ValueError(f"{what} is {read:g}, but must lie between {low:g} and {high:g}: {remedy}")
    return read


_UNITS = {
    "length": {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0, "°": math.pi / 180.0},
    "share": {"%": 0.01},
    "number": {},
}
_NAMES = {"length": "a length", "angle": "an angle", "share": "a share", "number": "a plain number"}
_TEXT = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\d\s]*)\s*$")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Quantity:
    """What a key of a configuration takes."""

    kind: str = "number"
    """length (metres), angle (radians), share (of one) or number."""
    low: float = 0.0
    high: float = math.inf
    is_low_open: bool = False
    """Whether ``low`` itself is refused."""

    def read(self, value: Any, name: str) -> float:
        """Read a number, or a text with a unit, in the key's own unit; ``name`` is the key's.

        Raises:
            ValueError: no number, a unit of another kind, or out of limits; one line.
        """
        number = self._convert(value, name)
        is_low = number <= self.low if self.is_low_open else number < self.low
        if not math.isfinite(number) or is_low or number > self.high:
            # A unit may have been forgotten.
            meant = {"angle": ("deg", "degrees are"), "share": ("%", "percent is")}.get(self.kind)
            remedy = ""
            if meant and not (isinstance(value, str) or value <= self.high):
                remedy = f'; write "{value:g} {meant[0]}" if {meant[1]} meant'
            raise ValueError(f"{name} is {_shown(value)}, but must be {self._limits()}{remedy}")
        is_lost = number != 0.0 and not SMALLEST <= abs(number) <= LARGEST
        most = FARTHEST if self.kind == "length" else LARGEST
        if is_lost or number > most:
            reach = f"single precision serves for {SMALLEST:g} to {most:g} only"
            raise ValueError(f"{name} is {_shown(value)}, but {reach}")
        return number

    def _convert(self, value: Any, name: str) -> float:
        """Turn a number or a text with a unit into the key's own unit."""
        if isinstance(value, int | float) and not isinstance(value, bool):
            try:
                return float(value)
            except OverflowError:
                line = f"{name} is {as_text(value)}, but must be {self._limits()}"
                raise ValueError(line) from None
        match = _TEXT.match(value) if isinstance(value, str) else None
        units = ", ".join(_UNITS[self.kind])
        wanted, example = _NAMES[self.kind], f" ({units})" if units else ""
        if match is None:
            raise ValueError(f"{name} is {as_text(value)}, but must be {wanted}{example}")
        number, unit = float(match[1]), match[2]
        if not unit or unit in _UNITS[self.kind]:
            return number * _UNITS[self.kind].get(unit, 1.0)
        meant = next((kind for kind, units in _UNITS.items() if unit in units), None)
        what = f"is {_NAMES[meant]}" if meant else f'has the unknown unit "{shorten(unit)}"'
        raise ValueError(f'{name} = "{shorten(match[0])}" {what}, but {wanted} is needed{example}')

    def _limits(self) -> str:
        unit = {"length": " m", "angle": " rad"}.get(self.kind, "")
        above = f"above {self.low:g}" if self.is_low_open else f"at least {self.low:g}"
        below = "" if math.isinf(self.high) else f" and at most {self.high:.6g}"
        return f"{above}{below}{unit}"


LENGTH = Quantity(kind="length", is_low_open=True)
SHARE = Quantity(kind="share", high=1.0)


def _shown(value: Any) -> str:
    return shorten(value) if isinstance(value, str) else as_text(value)
