"""Numbers with units, as people write them in a sweep's configuration.

A bare number is in the key's own unit: metres, radians, or a share of one. With a unit,
"30 cm", "360 deg" or "2 %", it is converted; a unit of another kind is refused.
"""

import dataclasses
import math
import re
from typing import Any

from jax import Array

from jaxlangnav.files.limits import FARTHEST, LARGEST, SMALLEST
from jaxlangnav.messages import MotionParams, SensorParams
from jaxlangnav.plain_text import cut, shown
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.sensing import MOST_FALSE, VIEWS

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
        """Read a value.

        Args:
            value: a number, or a text with a unit.
            name: of the key, for messages.

        Returns:
            The value in the key's own unit.

        Raises:
            ValueError: no number, a unit of another kind, or out of limits; one line.
        """
        number = self._convert(value, name)
        is_low = number <= self.low if self.is_low_open else number < self.low
        if not math.isfinite(number) or is_low or number > self.high:
            raise ValueError(
                f"{name} is {_said(value)}, but must be {self._limits()}{self._remedy(value)}"
            )
        is_lost = number != 0.0 and not SMALLEST <= abs(number) <= LARGEST
        if is_lost or (self.kind == "length" and number > FARTHEST):
            most = FARTHEST if self.kind == "length" else LARGEST
            raise ValueError(
                f"{name} is {_said(value)}, but single precision serves for {SMALLEST:g} to "
                f"{most:g} only"
            )
        return number

    def _convert(self, value: Any, name: str) -> float:
        """Turn a number or a text with a unit into the key's own unit."""
        if isinstance(value, int | float) and not isinstance(value, bool):
            try:
                return float(value)
            except OverflowError:
                fault = f"{name} is {shown(value)}, but must be {self._limits()}"
                raise ValueError(fault) from None
        match = _TEXT.match(value) if isinstance(value, str) else None
        if match is None:
            raise ValueError(
                f"{name} is {shown(value)}, but must be {_NAMES[self.kind]}{self._example()}"
            )
        number, unit = float(match[1]), match[2]
        if not unit or unit in _UNITS[self.kind]:
            return number * _UNITS[self.kind].get(unit, 1.0)
        meant = next((kind for kind, units in _UNITS.items() if unit in units), None)
        what = f"is {_NAMES[meant]}" if meant else f'has the unknown unit "{cut(unit)}"'
        raise ValueError(
            f'{name} = "{_said(value)}" {what}, but {_NAMES[self.kind]} is needed{self._example()}'
        )

    def _example(self) -> str:
        """Say which units there are."""
        units = list(_UNITS[self.kind])
        return f" ({', '.join(units)})" if units else ""

    def _limits(self) -> str:
        """Say between which values it must lie."""
        unit = {"length": " m", "angle": " rad"}.get(self.kind, "")
        above = f"above {self.low:g}" if self.is_low_open else f"at least {self.low:g}"
        below = "" if math.isinf(self.high) else f" and at most {self.high:.6g}"
        return f"{above}{below}{unit}"

    def _remedy(self, value: Any) -> str:
        """Guess at a forgotten unit."""
        if isinstance(value, str) or value <= self.high:
            return ""
        if self.kind == "angle":
            return f'; write "{value:g} deg" if degrees are meant'
        if self.kind == "share":
            return f'; write "{value:g} %" if percent is meant'
        return ""


LENGTH = Quantity(kind="length", is_low_open=True)
SHARE = Quantity(kind="share", high=1.0)
_KNOWN: dict[str, dict[str, Quantity]] = {
    "sensor": {
        "field_of_view": Quantity(kind="angle", low=VIEWS[0], high=2.0 * math.pi + 1e-6),
        "detection_probability": Quantity(kind="share", high=1.0, is_low_open=True),
        "noise": Quantity(kind="length"),
        "false_detections": Quantity(high=MOST_FALSE),
        "mislabelled": Quantity(kind="share", high=0.99),
    },
    "motion": {
        "step_length": LENGTH,
        "odometry_noise": SHARE,
        "heading_bias": Quantity(kind="angle"),
        "heading_noise": Quantity(kind="angle"),
        "turn_noise": Quantity(kind="angle"),
    },
    "map": {
        "concentration": Quantity(is_low_open=True),
        "clumping": Quantity(),
        "kernel": LENGTH,
        "superlative_softness": LENGTH,
        "misleading": SHARE,
        "resample_threshold": SHARE,
    },
    "planner": {
        "discount": Quantity(kind="share", high=1.0, is_low_open=True),
        "stop_probability": Quantity(kind="share", high=1.0, is_low_open=True),
        "reach": LENGTH,
        "frontier_miss": Quantity(kind="share", high=1.0, is_low_open=True),
        "visit_spacing": LENGTH,
        "rival_share": Quantity(),
        "rest_share": Quantity(),
        "prior_share": SHARE,
        "ahead": Quantity(),
        "give_up": SHARE,
        "absent": SHARE,
        "constraint_cost": Quantity(),
        "question_cost": Quantity(),
        "look_cost": Quantity(),
    },
}
_RECORDS = {
    "sensor": SensorParams,
    "motion": MotionParams,
    "map": MapParams,
    "planner": PlannerParams,
}


def _said(value: Any) -> str:
    """Repeat a value in a message."""
    return cut(value) if isinstance(value, str) else shown(value)


def _fields(table: str) -> dict[str, Quantity]:
    """List the single numbers of a record; one whose unit is not known here is a plain number."""
    known = _KNOWN[table]
    names = [
        field.name
        for field in dataclasses.fields(_RECORDS[table])
        if field.type in (Array, "Array") and field.name != "range_max"
    ]
    return {name: known.get(name, Quantity(low=-math.inf)) for name in names}


FIELDS: dict[str, dict[str, Quantity]] = {table: _fields(table) for table in _RECORDS}
"""The keys of the four tables of Params in a sweep's configuration: the records' own fields."""
