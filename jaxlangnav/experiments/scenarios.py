"""Scenarios of ``reproduce robustness``, outside the distribution of Table 2's worlds, as data.

To add one, add an entry to ``SCENARIOS``. Scenarios with the same ``world`` and distribution use
the same worlds, so sensors are compared in identical worlds.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp

from jaxlangnav.experiments.rows import RowSpec
from jaxlangnav.experiments.table import Row
from jaxlangnav.experiments.tasks import SENTENCES, Cell
from jaxlangnav.messages import SensorParams, default_motion, default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.world.places import world_params

COMMANDS = {
    "behind": SENTENCES["behind"],
    "front": "go to the hydrant in front of the cone",
    "null": SENTENCES["null"],
}
"""Commands by relation; "null" has no spatial relation."""
_Values = Mapping[str, Any]
_AREA = (-2.0, 12.0, -9.0, 9.0)  # metres; default operating area


@dataclasses.dataclass(frozen=True, kw_only=True)
class ScenarioSpec(RowSpec):
    """A scenario: world distribution, command, true sensor models, and those the filter assumes."""

    name: str
    description: str
    world: str = "place"
    range: float = 3.0
    relation: str = "behind"
    layout: _Values = dataclasses.field(default_factory=dict)  # arguments of ``world_params``
    truth: _Values = dataclasses.field(default_factory=dict)
    """Arguments of ``default_sensor`` for the true sensor model."""
    assumed: _Values = dataclasses.field(default_factory=dict)
    """Those of them for which the filter assumes other values."""
    params: _Values = dataclasses.field(default_factory=dict)
    """Parameters of the navigator: the prior over the number of objects."""
    motion: _Values = dataclasses.field(default_factory=dict)
    """Fields of the true motion model; the filter always assumes the default one."""
    target: float | None = None  # required success of ``informed``, percent
    max_distance: float | None = None  # limit of the mean distance, metres
    termination: str = "arrived"  # correct one: "arrived", or "not_found" if there is no goal

    @property
    def is_matched(self) -> bool:
        """Whether the model matches: true sensors, sentence and, if relevant, number of objects.

        The number of objects is relevant where several may fit the sentence.
        """
        is_exact = not (self.assumed or self.motion or self.layout.get("num_clutter"))
        return self._has_true_sentence and is_exact and self._has_counts

    @property
    def _has_counts(self) -> bool:
        """Whether the prior over the number of objects is set, or the sentence is unambiguous."""
        return bool(self.params) or not (self.layout.get("num_pairs") or self.relation == "null")

    @property
    def _has_true_sentence(self) -> bool:
        """Whether the sentence is true in the scenario's worlds."""
        if not (self.layout.get("has_goal", True) and self.layout.get("has_cone", True)):
            return False
        sides = self.layout.get("side", 1.0), self.layout.get("stated_side", 1.0)
        return self.relation == "null" or sides[0] == sides[1]

    def heading(self) -> Row:
        """Return the entries that identify the row."""
        return {"scenario": self.name} | super().heading()

    def described(self) -> Row:
        """Describe the scenario for the report; ``numbers``: its prior over object counts."""
        actual = [_format(name, value) for name, value in {**self.truth, **self.motion}.items()]
        assumed = [_format(name, value) for name, value in self.assumed.items()]
        assumed += ["odometry 2 %"] if self.motion else []
        assumed += ["nothing of the four places"] if self.layout.get("num_clutter") else []
        assumed += [] if self._has_true_sentence else ["a sentence that is not so"]
        assumed += [] if self._has_counts else ["nothing of how many there are"]
        return {
            "scenario": self.name,
            "what": self.description,
            "said": COMMANDS[self.relation],
            "truth": ", ".join([f"range {self.range:g} m", *actual]),
            "told": ", ".join(assumed),
            "numbers": ", ".join(f"{name} {value:g}" for name, value in self.params.items()),
            "is_told": self.is_matched,
        }

    def setting(self, *, seed: int, sensor: SensorParams | None = None) -> Cell:
        """Build the setting of its episodes; ``sensor`` is ignored for the scenario's own."""
        motion = {name: jnp.float32(value) for name, value in self.motion.items()}
        return Cell(
            world=self.world,
            relation=self.relation,
            instruction_index=list(COMMANDS).index(self.relation),
            sensor=default_sensor(self.range, **self.truth),
            motion=replace(default_motion(), **motion),
            seed=seed,
            world_params=world_params(**{"area": _AREA, **self.layout}),
            assumed_sensor=default_sensor(self.range, **{**self.truth, **self.assumed}),
            labels=self.heading() | {"relation": self.relation},
            overrides=self.params,
        )


def _format(name: str, value: float) -> str:
    """Format a sensor parameter for the report."""
    if name == "field_of_view":
        return f"view {math.degrees(value):.0f}°"
    if name == "noise":
        return f"noise {value:g} m"
    verbs = {
        "detection_probability": "detects",
        "false_detections": "false of a type",
        "mislabelled": "wrong labels",
        "odometry_noise": "odometry",
    }
    return f"{verbs[name]} {100.0 * value:g} %"


def _scenario(name: str, description: str, **fields: Any) -> ScenarioSpec:
    return ScenarioSpec(name=name, description=description, **fields)


def _square(half: float) -> _Values:
    return {"area": (-half, half, -half, half)}


def _counts(expected: float) -> _Values:
    """Prior: ``expected`` further objects per type, Poisson; a relation is false with 1 %."""
    return {"concentration": expected, "clumping": 0.0, "misleading": 0.01}  # clumping: of counts


_FP_2, _FP_10 = {"false_detections": 0.01}, {"false_detections": 0.05}
"""Of each of two types, hydrants and cones: one false detection per 50 and per 10 scans."""
_LABELS, _MISSES = {"mislabelled": 0.1}, {"detection_probability": 0.6}
_FRONT, _PAIRS_2, _PAIRS_4 = {"side": -1.0, "stated_side": -1.0}, {"num_pairs": 2}, {"num_pairs": 4}
_FALSE: dict[str, Any] = {
    "description": "the hydrant is in front of the cone", "layout": {"side": -1.0}, "target": 99.0,
    "max_distance": 45.0,
}  # fmt: skip
_EXACTLY_ONE = {**_counts(0.02), "misleading": 0.001, "absent": 0.0}
"""Exactly one such object exists."""
_FIXED = {"num_clutter": 4, "clutter_probability": 0.2}
_CROWD = {"num_bystanders": 56, "num_pairs": 1}
_ALL: dict[str, Any] = {
    "description": "14 bystanders and one more pair",
    "layout": {"num_bystanders": 14, "num_pairs": 1},
    "truth": {"detection_probability": 0.8, "mislabelled": 0.05, **_FP_2},
}
_MORE_2, _MORE_4 = "two more hydrants and cones", "four more hydrants and cones"
_MIDDLE, _SIX, _OTHERS = "the start in the middle", "six bystanders", "things of other types"
_CLUTTER = "false detections, anew each look"

SCENARIOS = (
    _scenario("plain", "one pair, ahead and beside, 14 × 18 m"),
    _scenario("all round", "the start in the middle of 20 × 20 m", layout=_square(10.0)),
    _scenario("in front", "the goal is before its cone", relation="front", layout=_FRONT),
    _scenario("in front, told", "that there is no other is told", relation="front", layout=_FRONT,
          params=_counts(0.02)),
    _scenario("far sight", "a detector of 7 m", range=7.0),
    _scenario("2 more pairs", _MORE_2, layout=_PAIRS_2, target=98.0),
    _scenario("2 more pairs, 5 m", _MORE_2, range=5.0, layout=_PAIRS_2, target=98.0),
    _scenario("4 more pairs", _MORE_4, layout=_PAIRS_4),
    _scenario("2 more pairs, told", "how many is told", layout=_PAIRS_2, params=_counts(2.0)),
    _scenario("2 more pairs, 5 m, told", "how many is told", range=5.0, layout=_PAIRS_2,
          params=_counts(2.0)),
    _scenario("4 more pairs, told", "how many is told", layout=_PAIRS_4, params=_counts(4.0)),
    ScenarioSpec(name="false sentence", **_FALSE),
    ScenarioSpec(name="false sentence, 5 m", range=5.0, **_FALSE),
    _scenario("empty sentence", "nothing is said of where", relation="null"),
    _scenario("empty sentence, told", "that there is one, and no other, is told", relation="null",
          params=_EXACTLY_ONE),
    _scenario("no cone", "the landmark is not there", layout={"has_cone": False}),
    _scenario("no hydrant", "there is no goal: to be told so is right", layout={"has_goal": False},
          termination="not_found"),
    _scenario("14 bystanders", _OTHERS, layout={"num_bystanders": 14}, target=99.5),
    _scenario("30 bystanders", _OTHERS, layout={"num_bystanders": 30}),
    _scenario("crowd of 60", "56 bystanders and one more pair", layout=_CROWD),
    _scenario("crowd of 60, told", "how many is told", layout=_CROWD, params=_counts(1.0)),
    _scenario("ghosts 2 %", _CLUTTER, truth=_FP_2, target=99.0),
    _scenario("ghosts 10 %", _CLUTTER, truth=_FP_10, target=97.0),
    _scenario("ghosts 10 %, not told", _CLUTTER, truth=_FP_10, assumed={"false_detections": 0.0}),
    _scenario("ghosts at 4 places", "seen there in 20 % of looks", truth=_FP_2, layout=_FIXED),
    _scenario("labels 10 % wrong", _SIX, truth=_LABELS, layout={"num_bystanders": 6}, target=96.0),
    _scenario("labels 10 %, not told", _SIX, truth=_LABELS, assumed={"mislabelled": 0.0},
          layout={"num_bystanders": 6}),
    _scenario("misses 20 %", "", truth={"detection_probability": 0.8}),
    _scenario("misses 40 %", "", truth=_MISSES),
    _scenario("misses 40 %, not told", "", truth=_MISSES, assumed={"detection_probability": 0.95}),
    _scenario("misses 40 %, ghosts 10 %", _CLUTTER, truth={**_MISSES, **_FP_10}, target=95.0),
    _scenario("noise 0.3 m", "", truth={"noise": 0.3}),
    _scenario("noise 0.3 m, not told", "", truth={"noise": 0.3}, assumed={"noise": 0.1}),
    _scenario("odometry 5 %", "", motion={"odometry_noise": 0.05}),
    _scenario("odometry 10 %", "", motion={"odometry_noise": 0.1}),
    _scenario("view 120°", "", truth={"field_of_view": math.radians(120.0)}),
    _scenario("view 90°", "", truth={"field_of_view": math.radians(90.0)}),
    _scenario("8 × 8 m", _MIDDLE, layout=_square(4.0)),
    _scenario("25 × 25 m", _MIDDLE, layout=_square(12.5)),
    _scenario("40 × 40 m, 5 m", _MIDDLE, range=5.0, layout=_square(20.0)),
    _scenario("40 × 40 m, 5 m, empty", "nothing is said of where", range=5.0, relation="null",
          layout=_square(20.0)),
    _scenario("60 × 60 m, 5 m", _MIDDLE, range=5.0, layout=_square(30.0)),
    ScenarioSpec(name="all at once", **_ALL),
    ScenarioSpec(name="all at once, told", params=_counts(1.0), **_ALL),
)  # fmt: skip
"""All scenarios, some with target values; of those named "told" the assumed prior is the truth."""
