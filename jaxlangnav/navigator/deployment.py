"""Default parameters and capacities for real environments, and parameters set by name.

``Navigator.pretrained`` starts from them; a sweep's configuration has the same keys and units.
"""

import dataclasses
import math
from collections.abc import Mapping

import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.limits import FOV_SPAN, LENGTH, MAX_FALSE, MAX_WRONG, SHARE, Quantity, number
from jaxlangnav.inputs.sanitize import closest
from jaxlangnav.messages import MotionParams, SensorParams, is_drifting
from jaxlangnav.navigator.records import NavigatorConfig, NavigatorParams, default_params
from jaxlangnav.planner.config import AnyPolicy, PlannerConfig
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.params import MapConfig, MapParams

NUM_OBJECTS, NUM_BYSTANDERS = 12, 64
"""Capacities for objects of mentioned types, and of other types, in real environments."""
_DEFAULTS = {
    "concentration": 1.2,  # expected number of further objects of a type
    "clumping": 2.0,  # its overdispersion
    "prior_share": 0.0,  # weight of the search prior learned in training worlds
    "absent": 0.05,  # probability that a mentioned object does not exist
    "give_up": 0.15,  # existence probability below which a search ends
}
"""The number of objects is hardly known, with one rate for all mentioned types. In 500 worlds each
(``searching`` of the tests) a false sentence costs 47 m and one whose landmark does not exist 81 m
(with 1.35 and 0.1: 49 and 86)."""
_QUANTITIES = (
    (LENGTH, "step_length kernel superlative_softness reach visit_spacing"),
    (SHARE, "odometry_noise misleading resample_threshold prior_share give_up absent unseen_risk"),
    (
        Quantity(kind="share", high=1.0, is_low_open=True),
        "detection_probability discount stop_probability frontier_miss",
    ),
    (Quantity(kind="angle"), "heading_bias heading_noise turn_noise"),
    (Quantity(kind="angle", low=FOV_SPAN[0], high=2.0 * math.pi + 1e-6), "field_of_view"),
    (Quantity(kind="length"), "noise"),
    (Quantity(kind="share", high=MAX_WRONG), "mislabelled"),
    (Quantity(high=MAX_FALSE), "false_detections"),
    (Quantity(is_low_open=True), "concentration"),
    (Quantity(), "clumping rival_share rest_share ahead constraint_cost question_cost look_cost"),
)
"""Parameters by quantity, which has their unit and limits."""
_QUANTITY_OF = {name: quantity for quantity, names in _QUANTITIES for name in names.split()}
_RECORDS = dict(sensor=SensorParams, motion=MotionParams, map=MapParams, planner=PlannerParams)
FIELDS = {
    table: {
        field.name: _QUANTITY_OF[field.name]
        for field in dataclasses.fields(record)
        if field.type is Array and field.name != "range_max"
    }
    for table, record in _RECORDS.items()
}
"""Quantities of the scalar parameters, by the four tables of Params in a sweep's configuration."""


def deployment_params() -> NavigatorParams:
    """Build the default parameters for environments unlike the planner's training worlds."""
    return set_params(_DEFAULTS, params=default_params())


def deployment_config(policy: AnyPolicy, *, params: NavigatorParams) -> NavigatorConfig:
    """Build the configuration with unreferenced objects and existence probabilities.

    The parameters are concrete: a drifting heading needs a compiled program of its own.
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
    """Set scalar parameters by name, whichever record has them (host only).

    Args:
        numbers: by the names of fields of ``MapParams``, ``MotionParams`` or ``PlannerParams``; a
            number, or a text with a unit as on the command line ("50 cm").
        params: of a navigator.

    Raises:
        ValueError: no such parameter, or an invalid value.
    """
    records = {"motion": params.map.motion, "map": params.map, "planner": params.planner}
    record_of = {name: key for key in records for name in FIELDS[key]}
    for name, value in numbers.items():
        if name not in record_of:
            near = closest(name, record_of)
            hint = f"did you mean {near}?" if near else f"there are {', '.join(sorted(record_of))}"
            raise ValueError(f"{name[:40]} is no number of the navigator: {hint}")
        key = record_of[name]
        checked = value if isinstance(value, str) else number(value, name)
        scalar = FIELDS[key][name].read(checked, name)
        records[key] = replace(records[key], **{name: jnp.float32(scalar)})
    map_params = replace(records["map"], motion=records["motion"])
    return replace(params, map=map_params, planner=records["planner"])
