"""The relation "between": log-density, sampler and truth test (beyond eq. 7a).

"The hydrant between the cone and the car" has two landmarks and no viewer: a Gaussian about their
midpoint, scaled by the distance d from one to the other, so it is scale invariant,

    f(o) = N(u; ½, α) N(v; 0, β) / d²,      u along and v across, in units of d
"""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

_Point = tuple[Array, Array] | tuple[np.ndarray, np.ndarray]

SIGMA = (0.2, 0.15)
"""α and β (ours, not fitted): most of the mass is in the middle four fifths of the segment,
within three tenths of its length from it."""
_MAX_MAHALANOBIS = 2.45
"""Standard deviations from the midpoint: just short of the landmarks."""
_LANDMARK_SD = (0.8, 0.6)
"""Standard deviations of the proposal for a landmark beyond its figure: of the log range ratio, and
of the angle in radians. They are about as wide as ``SIGMA`` there, so that importance weights have
no heavy tail."""


def log_density(figure: _Point, landmark: _Point, other: _Point) -> Array:
    """Evaluate the log-density of a figure that lies between two landmarks.

        log f = −(u − ½)² / 2α² − v² / 2β² − log 2πα β d²

    Limits: symmetric in the landmarks; with both at one position f is that of a point.

    All are f32[...] x and y, metres, map frame: the figure, one landmark, and the other; returned
    is f32[...] per square metre.
    """
    z_along, z_across, d_squared = _standardised_offsets(figure, landmark, other)
    log_constant = math.log(2.0 * math.pi * SIGMA[0] * SIGMA[1])
    return -0.5 * (z_along * z_along + z_across * z_across) - log_constant - jnp.log(d_squared)


def lies_between(figure: _Point, landmark: _Point, other: _Point) -> Any:
    """Test whether a figure lies between two landmarks, bool[...].

    That is within ``_MAX_MAHALANOBIS`` of the density: in an ellipse about their midpoint that ends
    at the landmarks, three quarters as wide as it is long. No object lies between itself and
    another. All are f[...] x and y, metres, map frame; NumPy or JAX.
    """
    z_along, z_across, _ = _standardised_offsets(figure, landmark, other)
    return z_along * z_along + z_across * z_across < _MAX_MAHALANOBIS**2


def _standardised_offsets(figure: _Point, landmark: _Point, other: _Point) -> tuple[Any, Any, Any]:
    """Compute standardised coordinates along and across, and the squared distance d²."""
    sd_along, sd_across = SIGMA
    dx, dy = landmark[0] - other[0], landmark[1] - other[1]
    x, y = figure[0] - other[0], figure[1] - other[1]
    d_squared = dx * dx + dy * dy + 1e-6
    z_along = ((x * dx + y * dy) / d_squared - 0.5) / sd_along
    z_across = ((y * dx - x * dy) / d_squared) / sd_across
    return z_along, z_across, d_squared


def sample(z_first: Array, z_second: Array) -> tuple[Array, Array, Array]:
    """Sample landmark-to-figure offsets for a new figure (row 0) and a new landmark (row 1).

    The figure is from ``log_density``; a landmark is from a proposal of its own, beyond its figure
    at about the range of the other landmark.

    Args:
        z_first: f32[2, ...], standard normal draws, for the figure and for the landmark.
        z_second: f32[2, ...]

    Returns:
        f32[2, ...] along and lateral, from landmark to figure, in the frame of a viewer at the
        other landmark, in units of its distance: to the landmark where the figure is new, to the
        figure where the landmark is; and f32[1, ...], the log proposal density of the landmark, per
        square unit.
    """
    (sd_along, sd_across), (sd_range, sd_angle) = SIGMA, _LANDMARK_SD
    z_range, z_angle = z_first[1:], z_second[1:]
    log_range, angle = sd_range * z_range, sd_angle * z_angle
    range_ratio = jnp.exp(log_range)
    log_constant = math.log(2.0 * math.pi * sd_range * sd_angle)
    return (
        jnp.concatenate([sd_along * z_first[:1] - 0.5, -range_ratio * jnp.cos(angle)]),
        jnp.concatenate([sd_across * z_second[:1], -range_ratio * jnp.sin(angle)]),
        -0.5 * (z_range * z_range + z_angle * z_angle) - log_constant - 2.0 * log_range,
    )
