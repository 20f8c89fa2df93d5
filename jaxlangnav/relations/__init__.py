"""What is said of where things are: the six relations of section 3.1.

``table`` holds their axes and parameters, ``frames`` in whose eyes they are meant, ``density`` how
likely they place a thing (eq. 7a), ``strength`` whether one holds, and which thing is the nearest.
"""

from jaxlangnav.relations.density import (
    MAX_NORMAL,
    NUM_QUANTILES,
    SIDE_CONCENTRATION,
    Law,
    RelationModel,
    anywhere,
    law_of,
    log_density,
    log_density_in_frame,
    log_density_of,
    prepare,
    sample_law,
    sample_polar,
)
from jaxlangnav.relations.frames import ReferenceFrame, robot_frame, to_map, viewer_frame
from jaxlangnav.relations.strength import degree, holds, is_on_side
from jaxlangnav.relations.table import SIDES, RelationParams, default_params

__all__ = [
    "MAX_NORMAL",
    "NUM_QUANTILES",
    "SIDES",
    "SIDE_CONCENTRATION",
    "Law",
    "ReferenceFrame",
    "RelationModel",
    "RelationParams",
    "anywhere",
    "default_params",
    "degree",
    "holds",
    "is_on_side",
    "law_of",
    "log_density",
    "log_density_in_frame",
    "log_density_of",
    "prepare",
    "robot_frame",
    "sample_law",
    "sample_polar",
    "to_map",
    "viewer_frame",
]
