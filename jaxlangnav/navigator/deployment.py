"""Default parameters and capacities for real environments, and parameters set by name.

``Navigator.pretrained`` starts from them; a sweep's configuration has the same keys and units.
"""

import dataclasses
import difflib
import math
from collections.abc import Mapping

import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.limits import LENGTH, MAX_FALSE, MAX_WRONG, SHARE, VIEWS, Quantity, number
from jaxlangnav.messages import MotionParams, SensorParams, is_drifting
from jaxlangnav.navigator.records import NavigatorConfig, NavigatorParams, default_params
from jaxlangnav.planner.config import AnyPolicy, PlannerConfig
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.params import MapConfig, MapParams

NUM_OBJECTS, NUM_BYSTANDERS = 12, 64
"""Things that a sentence may mean, and others, that are remembered: for places as they are."""
_NUMBERS = {
    "concentration": 1.2,
    "clumping": 2.0,
    "prior_share": 0.0,
    "absent": 0.05,
    "give_up": 0.15,
}
"""How many things there are is hardly known, and is taken to be alike for all types spoken of. Of
500 places each (``searching`` of the tests) a false sentence costs 47 m and one whose landmark is
nowhere 81 m (49, 86: 1.35, 0.1)."""
_KINDS = (
    (LENGTH, "step_length kernel superlative_softness reach visit_spacing"),
    (SHARE, "odometry_noise misleading resample_threshold prior_share give_up absent unseen_risk"),
    (
        Quantity(kind="share", high=1.0, is_low_open=True),
        "detection_probability discount stop_probability frontier_miss",
    ),
    (Quantity(kind="angle"), "heading_bias heading_noise turn_noise"),
    (Quantity(kind="angle", low=VIEWS[0], high=2.0 * math.pi + 1e-6), "field_of_view"),
    (Quantity(kind="length"), "noise"),
    (Quantity(kind="share", high=MAX_WRONG), "mislabelled"),
    (Quantity(high=MAX_FALSE), "false_detections"),
    (Quantity(is_low_open=True), "concentration"),
    (Quantity(), "clumping rival_share rest_share ahead constraint_cost question_cost look_cost"),
)
"""What numbers there are of every kind, whose unit and limits they share."""
_KNOWN = {name: kind for kind, names in _KINDS for name in names.split()}
_RECORDS = dict(sensor=SensorParams, motion=MotionParams, map=MapParams, planner=PlannerParams)
FIELDS = {
    table: {
        field.name: _KNOWN.get(field.name, Quantity(low=-math.inf))
        for field in dataclasses.fields(record)
        if field.type in (Array, "Array") and field.name != "range_max"
    }
    for table, record in _RECORDS.items()
}
"""Keys of the four tables of Params in a sweep's configuration: the records' own single numbers.
One whose unit is not known here is a plain number."""


def deployment_params() -> NavigatorParams:
    """Build the default numbers for places that are unlike the planner's training worlds."""
    return set_params(_NUMBERS, params=default_params())


def deployment_config(policy: AnyPolicy, *, params: NavigatorParams) -> NavigatorConfig:
    """Build sizes with room for bystanders and for doubts of what exists.

    The parameters are concrete: a heading that drifts takes a program of its own.
    """
    sizes = MapConfig(
        num_objects=NUM_OBJECTS,
        num_bystanders=NUM_BYSTANDERS,
        has_doubts=True,
        has_drift=is_drifting(params.map.motion),
        pools_counts=True,
    )
    return NavigatorConfig(map=sizes, planner=PlannerConfig(policy=policy))


def set_params(numbers: Mapping[str, float | str], *, params: NavigatorParams) -> NavigatorParams:
    """Set single numbers by their names, wherever among the records they stand (host only).

    Args:
        numbers: by the names of fields of ``MapParams``, ``MotionParams`` or ``PlannerParams``; a
            number, or a text with a unit as on the command line ("50 cm").
        params: of a navigator.

    Raises:
        ValueError: no such number, or one that cannot be.
    """
    records = {"motion": params.map.motion, "map": params.map, "planner": params.planner}
    home = {
        field.name: place
        for place, record in records.items()
        for field in dataclasses.fields(record)
        if isinstance(value := getattr(record, field.name), Array) and value.ndim == 0
    }
    for name, value in numbers.items():
        if name not in home:
            near = difflib.get_close_matches(name, home, 1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(sorted(home))}"
            raise ValueError(f"{name[:40]} is no number of the navigator: {hint}")
        place = home[name]
        given = value if isinstance(value, str) else number(value, name)
        read = FIELDS[place][name].read(given, name)
        records[place] = replace(records[place], **{name: jnp.float32(read)})
    with_motion = replace(records["map"], motion=records["motion"])
    return replace(params, map=with_motion, planner=records["planner"])
