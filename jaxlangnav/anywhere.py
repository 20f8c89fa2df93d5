"""Numbers and sizes for places as they are: what ``Navigator.pretrained`` believes of them."""

import dataclasses
import difflib
from collections.abc import Mapping

import jax.numpy as jnp
from jax import Array

from jaxlangnav import navigator, sensing
from jaxlangnav.messages import is_drifting
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams
from jaxlangnav.planner.config import AnyPolicy, PlannerConfig
from jaxlangnav.pytree import replace
from jaxlangnav.quantities import FIELDS
from jaxlangnav.semantic_map.params import MapConfig

OBJECTS, BYSTANDERS = 12, 64
"""Things that a sentence may mean, and others, that are remembered: for places as they are."""
CONCENTRATION, CLUMPING = 1.35, 2.0
"""How many things there are is hardly known, and is taken to be alike for all types spoken of: one
hydrant and one cone that do not stand as is said are rather two of several than a false sentence,
until enough has been looked at to tell that there are no more. With two further pairs 199 of 200
arrive, and a false sentence costs 48 m (191 and 39 m with 0.3 and 1, each type by itself)."""
ABSENT, GIVE_UP = 0.05, 0.1
"""How often what is spoken of is nowhere, and how improbable what is missing must be to give up.
The more likely it is nowhere, the more the way counts until all has been looked at."""


def params_anywhere() -> NavigatorParams:
    """Build the default numbers for places that are unlike the planner's training worlds."""
    params = navigator.default_params()
    believed = replace(
        params.map,
        concentration=jnp.float32(CONCENTRATION),
        clumping=jnp.float32(CLUMPING),
    )
    planner = replace(
        params.planner,
        prior_share=jnp.float32(0.0),
        absent=jnp.float32(ABSENT),
        give_up=jnp.float32(GIVE_UP),
    )
    return replace(params, map=believed, planner=planner)


def config_anywhere(policy: AnyPolicy, *, params: NavigatorParams) -> NavigatorConfig:
    """Build sizes with room for bystanders and for doubts of what exists.

    Args:
        policy: of the planner.
        params: concrete numbers: a heading that drifts takes a program of its own.

    Returns:
        Sizes and policy.
    """
    return NavigatorConfig(
        map=MapConfig(
            num_objects=OBJECTS,
            num_bystanders=BYSTANDERS,
            has_doubts=True,
            has_drift=is_drifting(params.map.motion),
            pools_counts=True,
        ),
        planner=PlannerConfig(policy=policy),
    )


def with_numbers(numbers: Mapping[str, float | str], *, params: NavigatorParams) -> NavigatorParams:
    """Set single numbers by their names, wherever among the records they stand (host only).

    Args:
        numbers: by the names of fields of ``MapParams``, ``MotionParams`` or ``PlannerParams``; a
            number, or a text with a unit as on the command line ("50 cm").
        params: of a navigator.

    Returns:
        The parameters with these numbers.

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
        given = value if isinstance(value, str) else sensing.number(value, name)
        read = FIELDS[place][name].read(given, name)
        records[place] = replace(records[place], **{name: jnp.float32(read)})
    with_motion = replace(records["map"], motion=records["motion"])
    return replace(params, map=with_motion, planner=records["planner"])
