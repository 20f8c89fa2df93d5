"""Input checks of the API on the host: states of this navigator, observations in known shapes."""

import zlib
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from jaxlangnav.inputs.limits import is_complex
from jaxlangnav.inputs.observations import SLOTS, padded
from jaxlangnav.inputs.sanitize import quote, shorten
from jaxlangnav.messages import NONE, Observation, SensorParams
from jaxlangnav.navigator.records import NavigatorState
from jaxlangnav.pytree import replace

MAX_BITS = 31
"""Maximum number of slots and mentions of a bit set."""
_FILLERS: dict[str, tuple[Any, Any]] = {
    "detection_type": (np.int32, NONE),
    "detection_range": (np.float32, 0),
    "detection_bearing": (np.float32, 0),
    "is_detection": (bool, False),
    "detection_attribute": (np.int32, 0),
}
"""Fields with one entry per detection: dtype and padding value."""


def check_state(state: NavigatorState, type_names: Sequence[str], policy: str) -> NavigatorState:
    """Refuse, with a ValueError, what is no state or one of other labels or another policy.

    A state of the engine's own ``start`` is signed with both; one that is traced is not looked at.
    """
    if not isinstance(state, NavigatorState):
        raise ValueError(
            f"state is {quote(state)}, but must be what navigator.start, wait, step or hear gave"
        )
    names = [repr(one).encode() for one in (tuple(type_names), policy)]
    own = np.array([zlib.crc32(one) for one in names], np.uint32)
    if state.signature is None:  # of the engine's own ``start``
        return replace(state, signature=jax.device_put(own))
    if isinstance(state.signature, Tracer):
        return state
    is_other = (np.asarray(state.signature) != own).reshape(-1, 2).any(axis=0)
    if is_other.any():
        labels = shorten(", ".join(type_names))
        what = f"other labels than {labels}" if is_other[0] else f"another policy than {policy}"
        raise ValueError(
            f"state is of a navigator with {what}: go on with the navigator that began it, or "
            "start anew"
        )
    return state


def canonicalize(observation: Observation) -> Observation:
    """Give an observation of the host the shapes and dtypes that have been compiled already.

    Detections are padded as ``Observation.of`` pads them; a detector that reports no attributes is
    one to which none are known, so that one program serves both. One that is being traced is left
    as it is.

    Raises:
        ValueError: it is none, or its parts are of shapes that cannot be; one line.
    """
    is_one = isinstance(observation, Observation)
    if not is_one or not isinstance(observation.sensor, SensorParams):
        what = "observation's sensor" if is_one else "observation"
        given = observation.sensor if is_one else observation
        raise ValueError(
            f"{what} is {quote(given)}, but must be made by navigator.observation(pose, "
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
    rows, sensor = dict[str, np.ndarray](), dict[str, np.ndarray]()
    for name, (dtype, filler) in _FILLERS.items():
        row = _cast(getattr(observation, name), name, dtype, slots)
        rows[name] = np.pad(row, (0, spare), constant_values=filler)
    for name, leaf in vars(observation.sensor).items():
        sensor[name] = _cast(leaf, f"sensor.{name}", np.float32, ())
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
        raise ValueError(f"observation's {name} is {quote(leaf)}, but must be numbers") from None


def _odd(name: str, shape: tuple[int, ...], wanted: str) -> ValueError:
    """Say which part of an observation has a shape that cannot be."""
    return ValueError(
        f"observation's {name} has the shape {shape}, but must have {wanted}: "
        "navigator.observation makes all of them fit"
    )
