"""Central differences of float32 functions, and how far they may be off."""

from collections.abc import Callable

import jax

ROUNDINGS = 32
"""Float32 roundings of a value's size that a value may have gone through."""


def central(value: Callable[[float], jax.Array | float], step: float) -> tuple[float, float]:
    """Difference quotient at 0, and its error.

    A central difference of step h is off by c h² + O(h⁴). Those of h and 2 h differ by 3 c h²,
    three times what the finer one is off, which leaves room for the next order. Roundings of the
    values come on top.
    """
    ends = [float(value(offset * step)) for offset in (1.0, -1.0, 2.0, -2.0)]
    fine, coarse = (ends[0] - ends[1]) / (2 * step), (ends[2] - ends[3]) / (4 * step)
    rounding = ROUNDINGS * 2.0**-24 * max(abs(end) for end in ends) / step
    return fine, abs(coarse - fine) + rounding
