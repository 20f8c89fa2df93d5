"""Terrain: visibility and travel distances of an environment.

World and belief share these models: the world simulates with them, the belief assumes them. Both
are traced records, so a batch of worlds with different walls is one program; the open field has no
arrays, and costs nothing.
"""

from jaxlangnav.pytree import pytree
from jaxlangnav.terrain.sensor_model import RANGING as RANGING, SensorModel as SensorModel
from jaxlangnav.terrain.view import (
    Eye as Eye,
    OpenField as OpenField,
    StraightLines as StraightLines,
    Travel as Travel,
    View as View,
)


@pytree
class Terrain:
    """Visibility and travel distances of an environment."""

    view: View
    travel: Travel


OPEN = Terrain(view=OpenField(), travel=StraightLines())
"""The open field: no occlusion, and every path is straight."""
