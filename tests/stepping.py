"""LANES robots in plain NumPy places: one program steps them all, through public functions only."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxlangnav
from jaxlangnav import messages, navigator

_OFTEN = {"xla_backend_optimization_level": 3, "xla_llvm_disable_expensive_passes": False}
"""As users compile, also where tests are compiled briefly: it runs long."""
LANES, DETECTIONS = 20, 16
FEW = 8  # detections that the program holds which ``Navigator.step`` compiles first


@functools.lru_cache
def stepper(config: Any) -> Any:
    """Compile one cycle of several robots."""

    def one(key: Any, state: Any, seen: Any, params: Any) -> Any:
        state, action, info = navigator.step(key, state, seen, params=params, config=config)
        return state, (action.step, action.is_stop, action.status, info.filter.overflow)

    many = jax.vmap(one, in_axes=(0, 0, 0, None))
    return jax.jit(many, compiler_options=_OFTEN)


@jax.jit
def _renewed(states: Any, first: Any, is_new: Any) -> Any:
    def choose(now: Any, begun: Any) -> Any:
        return jnp.where(is_new.reshape(-1, *[1] * (now.ndim - 1)), begun[None], now)

    return jax.tree.map(choose, states, first)


class Robots(NamedTuple):
    """Robots that are told the same."""

    begin: Callable[[Any, int], Any]  # the state of one → those of so many
    renew: Callable[[Any, Any, Any], Any]  # let some begin anew
    step: Callable[..., Any]  # as ``stepper`` gives


def together(robot: jaxlangnav.Navigator) -> Robots:
    """Step all robots in one program of their own."""

    def begin(first: Any, lanes: int) -> Any:
        return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (lanes, *leaf.shape)), first)

    return Robots(begin, _renewed, stepper(robot.config))


def one_by_one(robot: jaxlangnav.Navigator) -> Robots:
    """Step one robot after the other through ``Navigator.step``: at most FEW detections a look."""

    def renew(states: list[Any], first: Any, is_new: Any) -> list[Any]:
        return [first if new else state for state, new in zip(states, is_new, strict=True)]

    def step(keys: Any, states: list[Any], seen: Any, _: Any) -> Any:
        after, told = [], []
        looks, own = jax.device_get(seen), list(keys)
        for lane, state in enumerate(states):
            look = jax.tree.map(
                lambda leaf, n=lane: leaf[n][:FEW] if leaf.ndim > 1 else leaf[n], looks
            )
            state, action, info = robot.step(own[lane], state, look)
            after.append(state)
            told.append((action.step, action.is_stop, action.status, info.filter.overflow))
        return after, [np.stack(leaves) for leaves in zip(*jax.device_get(told), strict=True)]

    return Robots(lambda first, lanes: [first] * lanes, renew, step)


def observation(
    odometry: Sequence[np.ndarray] | np.ndarray,
    found: Sequence[Sequence[tuple[int, float, float]]],
    sensor: Any,
) -> messages.Observation:
    """Lay out what robots see, type, range and bearing, as one batch."""
    lanes = len(found)
    kind = np.full((lanes, DETECTIONS), messages.NONE, np.int32)
    metres, bearing = np.zeros((2, lanes, DETECTIONS), np.float32)
    for lane, detections in enumerate(found):
        for slot, (name, far, turn) in enumerate(detections):
            kind[lane, slot], metres[lane, slot], bearing[lane, slot] = name, far, turn
    poses = np.pad(np.stack(odometry), ((0, 0), (0, 1)))
    return messages.Observation(
        pose=jnp.asarray(poses, jnp.float32),
        detection_type=jnp.asarray(kind),
        detection_range=jnp.asarray(metres),
        detection_bearing=jnp.asarray(bearing),
        is_detection=jnp.asarray(kind != messages.NONE),
        sensor=jax.tree.map(lambda leaf: jnp.full((lanes,), leaf, jnp.float32), sensor),
    )


@jax.jit
@jax.vmap
def keys_of(seed: Any, number: Any) -> Any:
    """Derive the key of an episode's step from its seed."""
    return jax.random.fold_in(jax.random.key(seed), number)
