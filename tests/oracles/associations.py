"""Exact enumeration of which detection is which object, for a robot that stands still.

Objects are Poisson with density λ; a look detects each object in view with probability p_d and
measures its place with variance R. A history assigns every detection to an object seen before or
to a new one; its weight is the product of predictive densities N(z; mean, R + R/k) for an object
seen k times, λ (1 − p_d)^(looks before) for a new one, and 1 − p_d for each object not detected.
NumPy, float64.
"""

import itertools
import math

import numpy as np


def posterior(
    looks: list[list[tuple[float, float]]],
    *,
    intensity: float,
    detection_probability: float,
    variance: float,
) -> tuple[np.ndarray, float]:
    """Compute P(n objects seen), f64[n], and the log-evidence of looks: places always in view."""
    histories = [(0.0, ())]  # log-weight, tuple of (count, sum x, sum y)
    for index, detections in enumerate(looks):
        grown = []
        log_new = math.log(intensity) + index * math.log1p(-detection_probability)
        for log_weight, objects in histories:
            for choice in _assignments(len(objects), len(detections)):
                total, updated = log_weight, list(objects)
                for which, (x, y) in zip(choice, detections, strict=True):
                    if which is None:
                        total += log_new
                        updated.append((1, x, y))
                        continue
                    count, sum_x, sum_y = objects[which]
                    spread = variance * (1 + 1 / count)
                    squared = (x - sum_x / count) ** 2 + (y - sum_y / count) ** 2
                    total += -0.5 * squared / spread - math.log(2 * math.pi * spread)
                    updated[which] = (count + 1, sum_x + x, sum_y + y)
                missed = len(objects) - sum(which is not None for which in choice)
                total += missed * math.log1p(-detection_probability)
                grown.append((total, tuple(updated)))
        top = max(log_weight for log_weight, _ in grown)
        histories = [one for one in grown if one[0] > top - 30.0]
    weights = np.array([log_weight for log_weight, _ in histories])
    top = weights.max()
    share = np.zeros(max(len(objects) for _, objects in histories) + 1)
    for weight, (_, objects) in zip(np.exp(weights - top), histories, strict=True):
        share[len(objects)] += weight
    return share / share.sum(), top + math.log(share.sum())


def _assignments(num_objects: int, num_detections: int):
    """All ways to give detections to different objects, or None for a new one."""
    options = [None, *range(num_objects)]
    for choice in itertools.product(options, repeat=num_detections):
        known = [which for which in choice if which is not None]
        if len(known) == len(set(known)):
            yield choice
