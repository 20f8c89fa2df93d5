"""What a place does to sight and to walking: which share of it is in view, and how far it is.

World and belief stand on this floor alike: the one senses by it, the other reckons with it. Both
doors are records that go with the data, so a batch of worlds with walls of their own is one
program; the open field has no numbers at all, and costs nothing.
"""

from jaxlangnav.pytree import pytree
from jaxlangnav.terrain.sensor_model import POSITIONS, SensorModel
from jaxlangnav.terrain.view import Eye, OpenField, StraightLines, Travel, View

__all__ = [
    "OPEN",
    "POSITIONS",
    "Eye",
    "OpenField",
    "SensorModel",
    "StraightLines",
    "Terrain",
    "Travel",
    "View",
]


@pytree
class Terrain:
    """How far one sees in a place, and how far it is to walk there."""

    view: View
    travel: Travel


OPEN = Terrain(view=OpenField(), travel=StraightLines())
"""The open field: nothing hides anything, and every way is straight."""
