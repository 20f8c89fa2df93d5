"""What motion planners need to know of a body that drives: its size and its limits."""

import dataclasses


@dataclasses.dataclass(frozen=True, kw_only=True)
class BodyLimits:
    """A body that drives ahead and turns about its middle."""

    name: str
    radius: float
    """Metres, of the circle about the middle that holds all of it."""
    speed: float
    """Metres a second ahead at normal speed (factor 1)."""
    top_speed: float
    """Metres a second that it never exceeds, whatever is asked for."""
    turn_rate: float
    """Radians a second at most."""
    acceleration: float
    """Metres a second squared, speeding up and braking."""
    turn_acceleration: float
    """Radians a second squared."""
