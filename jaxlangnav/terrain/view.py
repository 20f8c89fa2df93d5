"""Visibility and travel: interfaces, and the open field, for sensor, belief and planner.

A detector sees within its range and field of view; the occlusion by the environment is a
``View``. The open field has no occlusion; ``walls.Walls`` occlude objects behind them.
"""

from typing import NamedTuple, Protocol

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import SensorParams
from jaxlangnav.numerics.batching import prepend_axes
from jaxlangnav.pytree import pytree

LARGE = 1e9
"""Metres that stand for infinity: a point that never comes into view, a missing path."""
MIN_SIGHT = 0.5
"""Minimum length of path, metres, on which a point stays in a narrow view to count as observed."""
Position = tuple[Array, Array]
"""x and y, metres, map frame unless said otherwise."""


class Eye(NamedTuple):
    """Pose and field of view of a sensor; metres, radians, map frame."""

    x: Array  # f32[...]
    y: Array  # f32[...]
    range_max: Array  # f32[]
    heading: Array | None = None  # f32[]; None: all-round view
    field_of_view: Array | None = None  # f32[] full opening angle about the heading


def eye_of(x: Array, y: Array, heading: Array, sensor: SensorParams) -> Eye:
    """Build the view of a detector at f32[...] metres, map frame, with a heading f32[], radians."""
    return Eye(x, y, sensor.range_max, heading, sensor.field_of_view)


class Segment(NamedTuple):
    """Straight segments of a path, metres, map frame."""

    from_x: Array  # f32[...]
    from_y: Array  # f32[...]
    to_x: Array  # f32[...]
    to_y: Array  # f32[...]


class View(Protocol):
    """Visibility model: which points are in view from a pose; a pytree (``@pytree``).

    ``x`` and ``y`` broadcast against the eye's; ``sees`` is the limit of ``share`` as softness → 0.
    """

    def share(self, eye: Eye, x: Array, y: Array, softness: Array) -> Array:
        """Compute the fraction in view of a point blurred over ``softness`` metres, f32[...]."""
        ...

    def sees(self, eye: Eye, x: Array, y: Array) -> Array:
        """Test whether a point is in view, bounds inclusive, bool[...]."""
        ...

    def first_sight(
        self, segment: Segment, x: Array, y: Array, radius: Array, fov: Array | None = None
    ) -> Array:
        """Compute the distance along straight segments [...] after which points [C] are in view.

        The robot faces its motion, with field of view ``fov``, f32[] radians; None: all round.
        f32[..., C] metres; ``LARGE`` where they do not.
        """
        ...

    def free_fraction(self, segment: Segment, clearance: float) -> Array | None:
        """Compute the collision-free fraction of straight segments, f32[...]; None: all free."""
        ...


@pytree
class OpenField:
    """Visibility without occlusion: range and field of view only."""

    def share(self, eye: Eye, x: Array, y: Array, softness: Array) -> Array:
        """Compute the fraction in view of a point blurred over ``softness`` metres, f32[...].

        Limits: 1 well inside, 0 well outside, and the 0/1 test as softness → 0.
        """
        offset_x, offset_y = x - eye.x, y - eye.y
        distance = jnp.sqrt(offset_x * offset_x + offset_y * offset_y + 1e-9)
        in_range = jnp.clip((eye.range_max - distance) / softness + 0.5, 0.0, 1.0)
        if eye.heading is None or eye.field_of_view is None:
            return in_range
        # Half-angle test by cosine, so that no arc tangent is needed; all-round views always pass.
        half = jnp.minimum(0.5 * eye.field_of_view, jnp.pi)
        ahead = offset_x * jnp.cos(eye.heading) + offset_y * jnp.sin(eye.heading)
        margin = ahead - distance * jnp.cos(half)
        in_angle = jnp.clip(margin / softness + 0.5, 0.0, 1.0)
        return in_range * jnp.where(half >= jnp.pi - 1e-4, 1.0, in_angle)

    def sees(self, eye: Eye, x: Array, y: Array) -> Array:
        """Test whether a point is within range and field of view, both inclusive, bool[...]."""
        offset_x, offset_y = x - eye.x, y - eye.y
        if eye.heading is None or eye.field_of_view is None:
            return offset_x * offset_x + offset_y * offset_y <= eye.range_max * eye.range_max
        cosine, sine = jnp.cos(eye.heading), jnp.sin(eye.heading)
        ahead = cosine * offset_x + sine * offset_y
        left = cosine * offset_y - sine * offset_x
        distance, bearing = jnp.hypot(ahead, left), jnp.arctan2(left, ahead)
        # A microradian of slack: an all-round view must include what is exactly behind.
        return out_of_view(distance, bearing, eye.range_max, eye.field_of_view) <= 1e-6 * distance

    def first_sight(
        self, segment: Segment, x: Array, y: Array, radius: Array, fov: Array | None = None
    ) -> Array:
        """Compute the distance along segments after which points are within a radius and in view.

        A point at lateral distance a leaves a view of half-angle h at ``a / tan h`` before it is
        passed. It counts if it stays in view for ``MIN_SIGHT`` metres: observations are a step
        apart. Limits: 0 if already in view; ``LARGE`` if never; an all-round view is that
        of the radius alone.

        Args:
            segment: straight segments, f32[...].
            x: f32[C], points, metres, map frame.
            y: f32[C], metres.
            radius: f32[], metres.
            fov: f32[], radians, full opening angle about the motion; None: all round.
        """
        span_x, span_y = segment.to_x - segment.from_x, segment.to_y - segment.from_y
        length = jnp.sqrt(span_x * span_x + span_y * span_y + 1e-12)
        offset_x = prepend_axes(x, span_x.ndim + 1) - segment.from_x[..., None]
        offset_y = prepend_axes(y, span_y.ndim + 1) - segment.from_y[..., None]
        unit_x, unit_y = span_x / length, span_y / length
        along = offset_x * unit_x[..., None] + offset_y * unit_y[..., None]
        lateral2 = offset_x * offset_x + offset_y * offset_y - along * along
        half = jnp.sqrt(jnp.maximum(radius * radius - lateral2, 0.0))
        enter = jnp.maximum(along - half, 0.0)
        is_seen = (lateral2 < radius * radius) & (along + half > 0.0) & (enter < length[..., None])
        if fov is not None:
            angle = 0.5 * fov
            cotangent = jnp.cos(angle) / jnp.maximum(jnp.sin(angle), 1e-6)
            leave = along - jnp.sqrt(jnp.maximum(lateral2, 0.0)) * cotangent
            is_seen &= (enter + MIN_SIGHT <= leave) | (angle >= jnp.pi - 1e-3)
        return jnp.where(is_seen, enter, LARGE)

    def free_fraction(self, segment: Segment, clearance: float) -> None:
        """Return None: every segment is free."""


def rotate(x: Array, y: Array, angle: Array) -> Position:
    """Rotate offsets counter-clockwise, radians; exact for the angle zero."""
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    return cosine * x - sine * y, sine * x + cosine * y


def wrapped(angle: Array) -> Array:
    """Wrap an angle to [−π, π], radians."""
    return angle - 2.0 * jnp.pi * jnp.round(angle / (2.0 * jnp.pi))


def out_of_view(distance: Array, bearing: Array, range_max: Array, field_of_view: Array) -> Array:
    """Compute the distance, f32[...] metres, of a point to the range and field of view.

    Limits: 0 inside; more than a right angle past the edge, the distance to the eye; NaN of NaN.

    Args:
        distance: f32[...], metres from the eye.
        bearing: f32[...], radians from the heading, any number of turns.
        range_max: f32[], metres.
        field_of_view: f32[], radians, full opening angle.
    """
    excess = jnp.clip(jnp.abs(wrapped(bearing)) - 0.5 * field_of_view, 0.0, 0.5 * jnp.pi)
    return jnp.maximum(distance - range_max, distance * jnp.sin(excess))


class Travel(Protocol):
    """Travel model: shortest paths of the robot; a pytree (``@pytree``).

    All arguments are metres, map frame, and broadcast against each other.
    """

    def metres(self, from_x: Array, from_y: Array, to_x: Array, to_y: Array) -> Array:
        """Compute the shortest path length, f32[...]; at least that of the straight line."""
        ...

    def next_place(self, from_x: Array, from_y: Array, to_x: Array, to_y: Array) -> Position:
        """Find the next turning point of that path, f32[] x and y of one robot."""
        ...

    def first_sight(
        self, view: View, segment: Segment, x: Array, y: Array, radius: Array, fov: Array | None
    ) -> Array:
        """Compute the distance along paths [...] until points [C] are in view, f32[..., C]."""
        ...


@pytree
class StraightLines:
    """Travel model without obstacles."""

    def metres(self, from_x: Array, from_y: Array, to_x: Array, to_y: Array) -> Array:
        """Compute the straight distance, f32[...]; its gradient is finite at zero, too."""
        span_x, span_y = to_x - from_x, to_y - from_y
        return jnp.sqrt(span_x * span_x + span_y * span_y + 1e-12)

    def next_place(self, from_x: Array, from_y: Array, to_x: Array, to_y: Array) -> Position:
        """Return the end of the path."""
        return to_x, to_y

    def first_sight(
        self, view: View, segment: Segment, x: Array, y: Array, radius: Array, fov: Array | None
    ) -> Array:
        """See ``View.first_sight``."""
        return view.first_sight(segment, x, y, radius, fov)
