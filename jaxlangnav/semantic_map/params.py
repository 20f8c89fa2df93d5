"""Parameters (traced) and configuration (static) of the semantic map's filter."""

import dataclasses

from jax import Array

from jaxlangnav.inputs.limits import check_minimum
from jaxlangnav.messages import MotionParams, default_motion
from jaxlangnav.pytree import field, pytree
from jaxlangnav.relations import RelationModel, default_params, prepare


@pytree
class MapParams:
    """Parameters of the filter, scalars f32[]; traced, so that new values never recompile."""

    concentration: Array = field(
        "α, expected number of further objects of a type in the area", default=0.3
    )
    clumping: Array = field(
        "κ, overdispersion of the number of objects of a type; 0: Poisson", default=0.0
    )
    kernel: Array = field("metres, standard deviation of a sampled metric constraint", default=0.1)
    superlative_softness: Array = field(
        "metres within which two distances count as equal", default=0.3
    )
    misleading: Array = field(
        "ε, probability that a stated relation is false; the policy "
        "``faithful`` assumes that all are true",
        default=0.05,
    )
    resample_threshold: Array = field("resample where ESS / P falls below this", default=0.5)
    relations: RelationModel  # densities of the six relations
    motion: MotionParams  # odometry as the belief assumes it


@dataclasses.dataclass(frozen=True, kw_only=True)
class MapConfig:
    """Configuration of the filter; hashable, a change recompiles."""

    num_particles: int = 64  # P
    num_objects: int = 8  # O, slots for observed objects in each particle
    num_cells: int = 36  # G, cells per side of the coverage map
    num_bystanders: int = 0
    """Capacity for objects of types not mentioned; 0: every observed object takes a slot."""

    has_doubts: bool = False
    """Whether objects have existence probabilities, with the clutter of ``SensorParams``."""

    has_drift: bool = False
    """Whether the heading drifts, by ``MotionParams``; else a compass measures it."""

    pools_counts: bool = False
    """Whether object types share one rate of their number (``counts``)."""

    def __post_init__(self) -> None:
        """Raise a ValueError for sizes below their minimum."""
        min_sizes = {"num_particles": 2, "num_objects": 1, "num_cells": 4, "num_bystanders": 0}
        for name, min_size in min_sizes.items():
            check_minimum(min_size, **{name: getattr(self, name)})


def default_map_params() -> MapParams:
    """Build the default parameters, those of the results tables."""
    return MapParams(relations=prepare(default_params()), motion=default_motion())
