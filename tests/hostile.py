"""Observations that cannot be: every field in turn, and several at once, drawn from a seed."""

from collections.abc import Callable

import numpy as np

from jaxlangnav.messages import Fault, Observation
from jaxlangnav.pytree import replace

NOT_FINITE = (np.nan, np.inf, -np.inf)
HUGE = (1e20, -1e20, 3e38)
TINY = 1e-40  # A subnormal number
INTEGERS = (-1, -2, -7, 15, 99, 2**31 - 1, -(2**31))
"""Type indices that are none: NONE and ROBOT among them."""
SPECIFICATIONS = {
    "range_max": (*NOT_FINITE, *HUGE, -1.0, 0.0, TINY),
    "field_of_view": (*NOT_FINITE, *HUGE, -1.0, 0.0, TINY, 90.0),
    "detection_probability": (*NOT_FINITE, *HUGE, -1.0, 2.0, 95.0),
    "noise": (*NOT_FINITE, *HUGE, -1.0, 50.0),
}
"""What each number of a detector cannot be."""

Draw = np.random.Generator
Mutation = Callable[[Draw, Observation], Observation]


def _with(look: Observation, field: str, slot: int, value: float) -> Observation:
    """Put one value into one slot of a field, quietly."""
    values = np.array(getattr(look, field))
    with np.errstate(over="ignore", invalid="ignore"):
        values[slot] = value
    return replace(look, **{field: values})


def _seen(draw: Draw, look: Observation) -> tuple[Observation, int]:
    """Choose a detection; where there is none, an empty slot becomes one."""
    slot = int(draw.integers(look.is_detection.size))
    return _with(look, "is_detection", slot, True), slot


def one_of(field: str, values: tuple, slots: tuple[int, ...] = ()) -> Mutation:
    """Put one of some values into a field: into one of some slots, or into a detection."""

    def mutate(draw: Draw, look: Observation) -> Observation:
        if slots:
            return _with(look, field, int(draw.choice(slots)), draw.choice(values))
        look, slot = _seen(draw, look)
        return _with(look, field, slot, draw.choice(values))

    return mutate


def mask(draw: Draw, look: Observation) -> Observation:
    """Call every empty slot a detection."""
    del draw
    types = np.where(look.is_detection, look.detection_type, -1).astype(np.int32)
    types[-1] = -1
    return replace(look, detection_type=types, is_detection=np.ones_like(look.is_detection))


def contradiction(draw: Draw, look: Observation) -> Observation:
    """See two things, of one type or of two, at one place."""
    one, other = draw.permutation(look.is_detection.size)[:2]
    metres, angle = draw.uniform(0.2, 2.0), draw.uniform(-3.0, 3.0)
    for slot in (one, other):
        look = _with(look, "is_detection", slot, True)
        look = _with(look, "detection_type", slot, int(draw.integers(3)))
        look = _with(look, "detection_range", slot, metres)
        look = _with(look, "detection_bearing", slot, angle)
    return look


def specification(field: str) -> Mutation:
    """Break one number of the detector's specification."""

    def mutate(draw: Draw, look: Observation) -> Observation:
        value = np.float32(draw.choice(SPECIFICATIONS[field]))
        return replace(look, sensor=replace(look.sensor, **{field: value}))

    return mutate


MUTATIONS: dict[str, tuple[Mutation, Fault]] = {
    "pose": (one_of("pose", (*NOT_FINITE, *HUGE, 500.0, -500.0), slots=(0, 1)), Fault.POSE),
    "heading": (one_of("pose", (*NOT_FINITE, *HUGE), slots=(2,)), Fault.POSE),
    "detection_type": (one_of("detection_type", INTEGERS), Fault.DETECTION),
    "detection_range": (
        one_of("detection_range", (*NOT_FINITE, *HUGE, -1.0, 20.0)), Fault.DETECTION,
    ),
    "detection_bearing": (
        one_of("detection_bearing", (*NOT_FINITE, *HUGE, 90.0, -720.0)), Fault.DETECTION,
    ),
    "is_detection": (mask, Fault.DETECTION),
    "contradiction": (contradiction, Fault.CONTRADICTION),
    **{name: (specification(name), Fault.SENSOR) for name in SPECIFICATIONS},
}  # fmt: skip
"""Every field of an observation, how it is broken, and what has to be said of it."""


def looks(good: Observation, number: int, seed: int = 0) -> list[tuple[Observation, Fault]]:
    """Draw looks, each with a flag to be raised: each field by itself, and two to four at once."""
    draw, names, found = np.random.default_rng(seed), list(MUTATIONS), []
    for index in range(number):
        chosen = [names[index // 2 % len(names)]]
        if index % 2:
            chosen = list(draw.permutation(names)[: draw.integers(2, 5)])
        look = good
        for name in chosen:
            look = MUTATIONS[name][0](draw, look)
        flags = [MUTATIONS[name][1] for name in chosen]
        # What a detector that cannot be would have seen is not judged.
        found.append((look, Fault.SENSOR if Fault.SENSOR in flags else flags[-1]))
    return found
