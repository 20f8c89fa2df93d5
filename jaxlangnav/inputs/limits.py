"""Limits and units of input numbers, such that float32 can represent them and their squares.

A number without unit is in metres, radians, or a fraction of one. With a unit, "30 cm",
"360 deg" or "2 %", it is converted; a unit of another quantity is rejected.
"""

import dataclasses
import math
import operator
import re
from typing import Any

from jaxlangnav.inputs.sanitize import as_text, quote, shorten

MAX_METRES = 1e5
"""Limit of coordinates and lengths, metres, where float32 resolves 8 mm."""
MIN_STEP = 1e-3
"""Minimum length of a step, metres."""
RANGES = (0.01, 1e4)
"""Limits of the sensing range, metres."""
MAX_VALUE = 1e15
"""Limit of a dimensionless number."""
MIN_VALUE = 1e-15
"""Lower limit of a dimensionless number other than zero."""
FOV_SPAN = (1e-3, math.tau + 1e-3)
"""Limits of the field of view, radians."""
MAX_SEED = 2**32 - 1
"""Limit of a seed, the root of all random keys."""
MAX_FALSE, MAX_WRONG = 100.0, 0.99
"""Limits of expected false detections per type and scan, and of the mislabelling probability."""


def whole_number(value: Any, what: str) -> int:
    """Convert a whole number, or an array of one; otherwise ``ValueError``."""
    try:
        return operator.index(value)
    except TypeError:
        raise ValueError(f"{what} is {quote(value)}, but must be a whole number") from None


def check_minimum(minimum: int, **counts: Any) -> None:
    """Raise a one-line ``ValueError`` for a count, given by name, below a minimum or no count."""
    for name, value in counts.items():
        if whole_number(value, name) < minimum:
            raise ValueError(f"{name} is {quote(value)}, but must be at least {minimum}")


def check_seed(value: Any, what: str = "seed") -> None:
    """Raise a one-line ``ValueError`` for a seed that is no unsigned 32-bit integer."""
    if not 0 <= whole_number(value, what) <= MAX_SEED:
        raise ValueError(f"{what} is {quote(value)}, but must lie between 0 and {MAX_SEED}")


def is_complex(value: Any) -> bool:
    """Tell whether an array is complex, which NumPy would silently cast to real."""
    return getattr(getattr(value, "dtype", None), "kind", "") == "c"


def number(value: Any, what: str) -> float:
    """Convert a number, or an array of one, to a finite float; otherwise ``ValueError``."""
    try:
        if isinstance(value, str | bytes) or is_complex(value):
            raise TypeError
        x = float(value.reshape(()) if hasattr(value, "reshape") else value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{what} is {quote(value)}, but must be a number") from None
    if not math.isfinite(x):
        raise ValueError(f"{what} is {x}, but must be finite")
    return x


def bounded(value: Any, low: float, high: float, what: str, remedy: str) -> float:
    """Convert a number, or an array of one, between two bounds; otherwise ``ValueError``."""
    x = number(value, what)
    if not low <= x <= high:
        raise ValueError(f"{what} is {x:g}, but must lie between {low:g} and {high:g}: {remedy}")
    return x


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
    """Quantity and limits of a numeric key of a configuration."""

    kind: str = "number"
    """length (metres), angle (radians), share (a fraction) or number."""
    low: float = 0.0
    high: float = math.inf
    is_low_open: bool = False
    """Whether ``low`` itself is excluded."""

    def read(self, value: Any, name: str) -> float:
        """Convert a number, or a text with a unit, to the key's unit; ``name`` is the key's.

        Raises:
            ValueError: no number, a unit of another kind, or out of limits; one line.
        """
        result = self._convert(value, name)
        is_low = result <= self.low if self.is_low_open else result < self.low
        if not math.isfinite(result) or is_low or result > self.high:
            # A unit may have been forgotten.
            hint = {"angle": ("deg", "degrees are"), "share": ("%", "percent is")}.get(self.kind)
            remedy = ""
            if hint and not isinstance(value, str) and value > self.high:
                remedy = f'; write "{value:g} {hint[0]}" if {hint[1]} meant'
            raise ValueError(f"{name} is {_display(value)}, but must be {self._limits()}{remedy}")
        is_out_of_range = result != 0.0 and not MIN_VALUE <= abs(result) <= MAX_VALUE
        max_value = MAX_METRES if self.kind == "length" else MAX_VALUE
        if is_out_of_range or result > max_value:
            supported = f"single precision serves for {MIN_VALUE:g} to {max_value:g} only"
            raise ValueError(f"{name} is {_display(value)}, but {supported}")
        return result

    def _convert(self, value: Any, name: str) -> float:
        """Convert a number or a text with a unit to the key's unit."""
        if isinstance(value, int | float) and not isinstance(value, bool):
            try:
                return float(value)
            except OverflowError:
                line = f"{name} is {as_text(value)}, but must be {self._limits()}"
                raise ValueError(line) from None
        match = _TEXT.match(value) if isinstance(value, str) else None
        units = ", ".join(_UNITS[self.kind])
        expected, hint = _NAMES[self.kind], f" ({units})" if units else ""
        if match is None:
            raise ValueError(f"{name} is {as_text(value)}, but must be {expected}{hint}")
        number, unit = float(match[1]), match[2]
        if not unit or unit in _UNITS[self.kind]:
            return number * _UNITS[self.kind].get(unit, 1.0)
        other = next((kind for kind, units in _UNITS.items() if unit in units), None)
        fault = f"is {_NAMES[other]}" if other else f'has the unknown unit "{shorten(unit)}"'
        raise ValueError(f'{name} = "{shorten(match[0])}" {fault}, but {expected} is needed{hint}')

    def _limits(self) -> str:
        unit = {"length": " m", "angle": " rad"}.get(self.kind, "")
        lower = f"above {self.low:g}" if self.is_low_open else f"at least {self.low:g}"
        upper = "" if math.isinf(self.high) else f" and at most {self.high:.6g}"
        return f"{lower}{upper}{unit}"


LENGTH = Quantity(kind="length", is_low_open=True)
SHARE = Quantity(kind="share", high=1.0)


def _display(value: Any) -> str:
    return shorten(value) if isinstance(value, str) else as_text(value)
