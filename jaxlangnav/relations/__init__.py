"""Spatial relations (section 3.1).

``table`` is their registry, ``density`` eq. 7a, ``strength`` whether one holds, and who is nearest.
"""

from jaxlangnav.relations.density import (
    SIDE_CONCENTRATION as SIDE_CONCENTRATION,
    Law as Law,
    RelationModel as RelationModel,
    anywhere as anywhere,
    law_of as law_of,
    log_density as log_density,
    log_density_in_frame as log_density_in_frame,
    log_density_of as log_density_of,
    prepare as prepare,
    sample_law as sample_law,
    sample_polar as sample_polar,
)
from jaxlangnav.relations.strength import (
    degree as degree,
    holds as holds,
    is_on_side as is_on_side,
    is_so as is_so,
)
from jaxlangnav.relations.table import (
    REGISTRY as REGISTRY,
    SIDES as SIDES,
    ReferenceFrame as ReferenceFrame,
    RelationParams as RelationParams,
    default_params as default_params,
    robot_frame as robot_frame,
    symbol_of as symbol_of,
    to_frame as to_frame,
    to_map as to_map,
    viewer_frame as viewer_frame,
)
