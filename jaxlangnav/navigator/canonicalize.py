"""Input validation of the API (host only): navigator states, and observations in fixed shapes."""

import zlib
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from jaxlangnav.inputs.limits import is_complex
from jaxlangnav.inputs.observations import SLOTS, padded_size
from jaxlangnav.inputs.sanitize import quote, shorten
from jaxlangnav.messages import NONE, Observation, SensorParams
from jaxlangnav.navigator.records import NavigatorState
from jaxlangnav.pytree import replace

MAX_BITS = 31
"""Maximum number of slots and mentions of a bit set."""
_PADDING: dict[str, tuple[Any, Any]] = {
    "detection_type": (np.int32, NONE),
    "detection_range": (np.float32, 0),
    "detection_bearing": (np.float32, 0),
    "is_detection": (bool, False),
    "detection_attribute": (np.int32, 0),
}
"""Fields with one entry per detection: dtype and padding value."""


def check_state(state: NavigatorState, type_names: Sequence[str], policy: str) -> NavigatorState:
    """Raise a ValueError unless it is a state of a navigator with these labels and policy.

    An unsigned state, of ``navigator.start``, is signed with both; a traced one is not checked.
    """
    is_state = isinstance(state, NavigatorState)
    if not is_state or np.ndim(state.status):
        given = f"a batch of the shape {np.shape(state.status)}" if is_state else quote(state)
        raise ValueError(
            f"state is {given}, but must be what navigator.start, wait, step or hear gave"
            + ": batches are for jax.vmap of jaxlangnav.navigator.step" * is_state
        )
    names = [repr(part).encode() for part in (tuple(type_names), policy)]
    expected = np.array([zlib.crc32(name) for name in names], np.uint32)
    if state.signature is None:  # of ``navigator.start``
        return replace(state, signature=jax.device_put(expected))
    if isinstance(state.signature, Tracer):
        return state
    is_other = (np.asarray(state.signature) != expected).reshape(-1, 2).any(axis=0)
    if is_other.any():
        labels = shorten(", ".join(type_names))
        what = f"other labels than {labels}" if is_other[0] else f"another policy than {policy}"
        raise ValueError(
            f"state is of a navigator with {what}: go on with the navigator that began it, or "
            "start anew"
        )
    return state


def check_key(key: Any) -> None:
    """Raise a ValueError unless it is one random key, typed or of the old kind."""
    is_array = isinstance(key, jax.Array | np.ndarray)
    is_typed = is_array and jax.numpy.issubdtype(key.dtype, jax.dtypes.prng_key)
    is_old = is_array and key.dtype == np.uint32
    if not (is_typed or is_old) or key.ndim != int(is_old):
        raise ValueError(f"key is {quote(key)}, but must be one random key: jax.random.key(0)")


def canonicalize(observation: Observation) -> Observation:
    """Cast and pad an observation of the host to shapes and dtypes that are compiled already.

    Detections are padded as by ``Observation.of``; missing attributes become unknown ones, so that
    one program serves both. A traced observation is returned unchanged.

    Raises:
        ValueError: no observation, or fields of invalid shapes; one line.
    """
    is_observation = isinstance(observation, Observation)
    if not is_observation or not isinstance(observation.sensor, SensorParams):
        name = "observation's sensor" if is_observation else "observation"
        value = observation.sensor if is_observation else observation
        raise ValueError(
            f"{name} is {quote(value)}, but must be made by navigator.observation(pose, "
            "detections, sensor)"
        )
    leaves = (*vars(observation).values(), *vars(observation.sensor).values())
    if any(isinstance(leaf, Tracer) for leaf in leaves):
        return observation
    shape = np.shape(_array(observation.detection_type, "detection_type"))
    if len(shape) != 1:
        raise _shape_error("detection_type", shape, "(D,), a row of detections")
    if observation.detection_attribute is None:
        observation = replace(observation, detection_attribute=np.zeros(shape, np.int32))
    padding = padded_size(shape[0]) - shape[0]
    fields, sensor = dict[str, np.ndarray](), dict[str, np.ndarray]()
    for name, (dtype, fill_value) in _PADDING.items():
        values = _cast(getattr(observation, name), name, dtype, shape)
        fields[name] = np.pad(values, (0, padding), constant_values=fill_value)
    for name, leaf in vars(observation.sensor).items():
        sensor[name] = _cast(leaf, f"sensor.{name}", np.float32, ())
    return replace(
        observation,
        pose=_cast(observation.pose, "pose", np.float32, (3,)),
        sensor=replace(observation.sensor, **sensor),
        **fields,
    )


def _cast(leaf: Any, name: str, dtype: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Convert a field of an observation to an array of a dtype and a shape."""
    array = _array(leaf, name, dtype)
    if array.shape != shape:
        raise _shape_error(name, array.shape, str(shape))
    return array


def _array(leaf: Any, name: str, dtype: Any = None) -> np.ndarray:
    """Convert numbers to an array, unless there are more than any observation may hold."""
    if not hasattr(leaf, "shape") and hasattr(leaf, "__len__") and len(leaf) > SLOTS[-1]:
        raise _shape_error(name, (len(leaf),), f"at most {SLOTS[-1]} numbers")
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            if is_complex(leaf):
                raise TypeError
            return np.asarray(leaf, dtype)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"observation's {name} is {quote(leaf)}, but must be numbers") from None


def _shape_error(name: str, shape: tuple[int, ...], expected: str) -> ValueError:
    """Build the error for a field of an observation with an invalid shape."""
    return ValueError(
        f"observation's {name} has the shape {shape}, but must have {expected}: "
        "navigator.observation makes all of them fit"
    )
