"""Spatial relations by their equations: distance log-normal, direction von Mises (section 3.2)."""

import math

import numpy as np


def density(offset: np.ndarray, sight: float, *, median, spread, axis, concentration):
    """Density per square metre of a figure at ``offset`` f64[..., 2] from its landmark.

    ``sight`` is the direction, radians in map axes, from which ``axis`` turns to the left.
    """
    distance = np.hypot(offset[..., 0], offset[..., 1])
    turn = np.arctan2(offset[..., 1], offset[..., 0]) - sight - axis
    radial = np.exp(-0.5 * (np.log(distance / median) / spread) ** 2)
    radial = radial / (distance * spread * math.sqrt(2 * math.pi))
    angular = np.exp(concentration * np.cos(turn)) / (2 * math.pi * np.i0(concentration))
    return radial * angular / distance
