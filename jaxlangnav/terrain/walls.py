"""Walls as straight segments that occlude what is behind them.

Seen from an eye a wall throws a shadow: the wedge between the lines of sight past its two ends,
from the wall on. It is convex, so the distance of a point outside it is the maximum of its
distances to three lines.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.numerics.batching import append_axes, prepend_axes
from jaxlangnav.pytree import pytree
from jaxlangnav.terrain.view import LARGE, Eye, OpenField, Segment

NUM_SAMPLES = 9
"""Points along a segment, both ends included, at which visibility past walls is tested."""
_NO_WALLS = 1e6  # metres: distance to a shadow if there are no walls


@pytree
class Walls:
    """Visibility among W walls; traced, so other walls need no compilation."""

    ends: Array  # f32[W, 4] x, y of one end and of the other, metres, map frame

    def share(self, eye: Eye, x: Array, y: Array, softness: Array) -> Array:
        """Compute the fraction in view of a blurred point, not occluded by walls.

        Limits: without walls, or with none in between, what ``OpenField.share`` gives.
        """
        past = self._past_shadows(eye, x, y)
        return OpenField().share(eye, x, y, softness) * jnp.clip(past / softness + 0.5, 0.0, 1.0)

    def sees(self, eye: Eye, x: Array, y: Array) -> Array:
        """Test whether a point is within the eye's view and not occluded, bool[...]."""
        return OpenField().sees(eye, x, y) & (self._past_shadows(eye, x, y) >= 0.0)

    def first_sight(
        self, segment: Segment, x: Array, y: Array, radius: Array, fov: Array | None = None
    ) -> Array:
        """Compute the distance along segments after which points are in view past the walls.

        Visibility is tested at ``NUM_SAMPLES`` points of the segment, so that views in between are
        missed, and the distance may be too large by the spacing of the points. Arguments are those
        of ``OpenField.first_sight``.
        """
        first = OpenField().first_sight(segment, x, y, radius, fov)
        segment = Segment(*(end[..., None] for end in segment))
        x, y = prepend_axes(x, first.ndim), prepend_axes(y, first.ndim)
        span_x, span_y = segment.to_x - segment.from_x, segment.to_y - segment.from_y
        length = jnp.sqrt(span_x * span_x + span_y * span_y + 1e-12)
        sight = jnp.full_like(first, LARGE)
        angles = (None, None) if fov is None else (jnp.arctan2(span_y, span_x), fov)
        for t in np.linspace(1.0, 0.0, NUM_SAMPLES):
            eye = Eye(segment.from_x + t * span_x, segment.from_y + t * span_y, radius, *angles)
            sight = jnp.where(self.sees(eye, x, y), t * length, sight)
        # If a point is not occluded where it comes into range, that position counts.
        t0 = first / length
        entry = Eye(segment.from_x + t0 * span_x, segment.from_y + t0 * span_y, radius)
        is_clear = (first < LARGE) & (self._past_shadows(entry, x, y) >= 0.0)
        return jnp.where(is_clear, first, sight)

    def free_fraction(self, segment: Segment, clearance: float) -> Array:
        """Compute the fraction of straight segments that is free before a wall, f32[...].

            p + t (q − p) = a + u (b − a),   share = min_t (t − c / |q − p|) over 0 ≤ t, u ≤ 1

        Limits: 1 where no wall is crossed; 0 for a start within ``clearance`` c, metres, of the
        wall ahead.
        """
        from_x, from_y, to_x, to_y = (end[None] for end in segment)
        length = jnp.sqrt((to_x - from_x) ** 2 + (to_y - from_y) ** 2 + 1e-12)
        # It also stops before a wall within the clearance behind the end.
        reach = (length + clearance) / length
        span_x, span_y = reach * (to_x - from_x), reach * (to_y - from_y)
        start_x, start_y, end_x, end_y = (append_axes(end, span_x.ndim) for end in self.ends.T)
        wall_x, wall_y = end_x - start_x, end_y - start_y
        off_x, off_y = start_x - from_x, start_y - from_y
        across = span_x * wall_y - span_y * wall_x
        across = jnp.where(jnp.abs(across) < 1e-9, 1e-9, across)
        along = (off_x * wall_y - off_y * wall_x) / across
        at_wall = (off_x * span_y - off_y * span_x) / across
        is_hit = (along >= 0.0) & (along <= 1.0) & (at_wall >= 0.0) & (at_wall <= 1.0)
        free = jnp.where(is_hit, reach * along - clearance / length, 1.0)
        return jnp.clip(jnp.min(free, axis=0), 0.0, 1.0)

    def is_between(self, from_x: Array, from_y: Array, to_x: Array, to_y: Array) -> Array:
        """Test whether a wall is between two points, bool[...]."""
        return self._past_shadows(Eye(from_x, from_y, jnp.float32(0.0)), to_x, to_y) < 0.0

    def _past_shadows(self, eye: Eye, x: Array, y: Array) -> Array:
        """Compute the signed distance of a point to all shadows, metres; negative inside of one."""
        off_x, off_y = (x - eye.x)[None], (y - eye.y)[None]
        eye_x, eye_y = jnp.broadcast_to(eye.x, off_x.shape), jnp.broadcast_to(eye.y, off_x.shape)
        start_x, start_y, end_x, end_y = (append_axes(end, off_x.ndim) for end in self.ends.T)
        a_x, a_y, b_x, b_y = start_x - eye_x, start_y - eye_y, end_x - eye_x, end_y - eye_y
        # Left of the line to the start and right of that to the end, if the wall runs
        # counter-clockwise about the eye.
        turn = jnp.where(a_x * b_y - a_y * b_x >= 0.0, 1.0, -1.0)
        past_start = turn * _left_of(a_x, a_y, off_x, off_y)
        past_end = -turn * _left_of(b_x, b_y, off_x, off_y)
        behind = -turn * _left_of(b_x - a_x, b_y - a_y, off_x - a_x, off_y - a_y)
        inside = jnp.minimum(jnp.minimum(past_start, past_end), behind)
        return jnp.min(-inside, axis=0, initial=_NO_WALLS)


def _left_of(line_x: Array, line_y: Array, x: Array, y: Array) -> Array:
    """Compute the signed distance of a point to the left of a line through the origin, f32[...]."""
    return (line_x * y - line_y * x) / jnp.sqrt(line_x * line_x + line_y * line_y + 1e-12)


def walls(*ends: tuple[float, float, float, float]) -> Walls:
    """Build walls, each from x, y of one end and of the other, metres, map frame (host only).

    Raises a ValueError if a wall is not four finite numbers.
    """
    if not all(len(wall) == 4 and np.isfinite(wall).all() for wall in ends):
        raise ValueError(f"walls are {ends}, but each must be x, y, x, y, finite, in metres")
    return Walls(ends=jnp.asarray(np.array(ends, np.float32).reshape(-1, 4)))
