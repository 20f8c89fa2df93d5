"""Spatial relations (section 3.1).

``table`` is their registry, ``density`` their densities (eq. 7a), ``strength`` truth and ranks.
"""

from jaxlangnav.relations.density import (
    Density as Density,
    RelationModel as RelationModel,
    density_of as density_of,
    log_density as log_density,
    log_density_in_frame as log_density_in_frame,
    prepare as prepare,
    sample_pdf as sample_pdf,
    without_range as without_range,
)
from jaxlangnav.relations.strength import (
    degree as degree,
    holds as holds,
    holds_at as holds_at,
    is_on_side as is_on_side,
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
