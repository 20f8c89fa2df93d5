"""What a sweep may vary (traced) and what fixes the shapes (static) of the semantic map."""

import dataclasses

from jax import Array

from jaxlangnav.inputs.limits import refuse_below
from jaxlangnav.messages import MotionParams, default_motion
from jaxlangnav.pytree import field, pytree
from jaxlangnav.relations import RelationModel, default_params, prepare


@pytree
class MapParams:
    """Numbers of the filter, scalars f32[]; traced, so that new values never recompile."""

    concentration: Array = field(
        "α, expected number of further objects of a type in the area", default=0.3
    )
    clumping: Array = field(
        "κ, how much more of a type each one seen makes probable; 0: not at all", default=0.0
    )
    kernel: Array = field("metres, standard deviation of a sampled metric constraint", default=0.1)
    superlative_softness: Array = field(
        "metres within which two distances count as equal", default=0.3
    )
    misleading: Array = field(
        "ε, probability that a relation said does not hold at all; the policy "
        "``faithful`` takes every word to be true",
        default=0.05,
    )
    resample_threshold: Array = field("resample where ESS / P falls below this", default=0.5)
    relations: RelationModel  # densities of the six relations
    motion: MotionParams  # odometry as the belief assumes it


@dataclasses.dataclass(frozen=True, kw_only=True)
class MapConfig:
    """Sizes of the filter; hashable, a change recompiles."""

    num_particles: int = 64
    num_objects: int = 8
    num_cells: int = 36
    num_bystanders: int = 0
    """Things of types not spoken of that are remembered; 0: all that is seen takes a slot."""

    has_doubts: bool = False
    """Whether what is detected may not exist, as ``SensorParams`` says; else all of it does."""

    has_drift: bool = False
    """Whether the heading drifts, as ``MotionParams`` says; else a compass gives it."""

    pools_counts: bool = False
    """Whether types have one rate in common by which there are things of them (``counts``)."""

    def __post_init__(self) -> None:
        """Refuse sizes the filter cannot work with."""
        least_sizes = {"num_particles": 2, "num_objects": 1, "num_cells": 4, "num_bystanders": 0}
        for name, least in least_sizes.items():
            refuse_below(least, **{name: getattr(self, name)})


def default_map_params() -> MapParams:
    """Build the parameters used in all tables unless they say otherwise."""
    return MapParams(relations=prepare(default_params()), motion=default_motion())
