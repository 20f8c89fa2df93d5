"""An observation in the shapes and dtypes that have been compiled already (host only)."""

import dataclasses
from typing import Any

import numpy as np
from jax.core import Tracer

from jaxlangnav.inputs.limits import is_complex
from jaxlangnav.inputs.observations import SLOTS, padded
from jaxlangnav.inputs.sanitize import quoted
from jaxlangnav.messages import NONE, Observation, SensorParams
from jaxlangnav.pytree import replace

_FILLERS: dict[str, tuple[Any, Any]] = {
    "detection_type": (np.int32, NONE),
    "detection_range": (np.float32, 0),
    "detection_bearing": (np.float32, 0),
    "is_detection": (bool, False),
    "detection_attribute": (np.int32, 0),
}
"""Of each field with a row a detection: dtype, and what empty slots hold."""


def uniform(observation: Observation) -> Observation:
    """Give an observation of the host the shapes and dtypes that have been compiled already.

    Args:
        observation: of one robot; one that is being traced is left as it is.

    Returns:
        The observation, detections padded as ``Observation.of`` pads them; a detector that reports
        no attributes is one to which none are known, so that one program serves both.

    Raises:
        ValueError: it is none, or its parts are of shapes that cannot be; one line.
    """
    if not isinstance(observation, Observation) or not isinstance(observation.sensor, SensorParams):
        what = "observation's sensor" if isinstance(observation, Observation) else "observation"
        given = observation.sensor if isinstance(observation, Observation) else observation
        raise ValueError(
            f"{what} is {quoted(given)}, but must be made by navigator.observation(pose, "
            "detections, sensor)"
        )
    leaves = (*vars(observation).values(), *vars(observation.sensor).values())
    if any(isinstance(leaf, Tracer) for leaf in leaves):
        return observation
    slots = np.shape(_array(observation.detection_type, "detection_type"))
    if len(slots) != 1:
        raise _odd("detection_type", slots, "(D,), a row of detections")
    if observation.detection_attribute is None:
        observation = replace(observation, detection_attribute=np.zeros(slots, np.int32))
    spare = padded(slots[0]) - slots[0]
    rows = {
        name: np.pad(
            _cast(getattr(observation, name), name, dtype, slots),
            (0, spare),
            constant_values=filler,
        )
        for name, (dtype, filler) in _FILLERS.items()
    }
    sensor = {
        field.name: _cast(
            getattr(observation.sensor, field.name), f"sensor.{field.name}", np.float32, ()
        )
        for field in dataclasses.fields(SensorParams)
    }
    return replace(
        observation,
        pose=_cast(observation.pose, "pose", np.float32, (3,)),
        sensor=replace(observation.sensor, **sensor),
        **rows,
    )


def _cast(leaf: Any, name: str, dtype: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Read a part of an observation as an array of a dtype and a shape."""
    array = _array(leaf, name, dtype)
    if array.shape != shape:
        raise _odd(name, array.shape, str(shape))
    return array


def _array(leaf: Any, name: str, dtype: Any = None) -> np.ndarray:
    """Read numbers; what is longer than any look is not read at all."""
    if not hasattr(leaf, "shape") and hasattr(leaf, "__len__") and len(leaf) > SLOTS[-1]:
        raise _odd(name, (len(leaf),), f"at most {SLOTS[-1]} numbers")
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            if is_complex(leaf):
                raise TypeError
            return np.asarray(leaf, dtype)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"observation's {name} is {quoted(leaf)}, but must be numbers") from None


def _odd(name: str, shape: tuple[int, ...], wanted: str) -> ValueError:
    """Say which part of an observation has a shape that cannot be."""
    return ValueError(
        f"observation's {name} has the shape {shape}, but must have {wanted}: "
        "navigator.observation makes all of them fit"
    )
