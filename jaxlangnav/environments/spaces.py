"""The spaces of our environments in Gymnasium's terms (extra ``gym``)."""

from typing import Any, Literal, get_args

import numpy as np
from gymnasium import spaces

from jaxlangnav.environments.functional import (
    ACTION_SIZE,
    BOUND,
    DISCRETE_ACTIONS,
    OBSERVATION_SIZE,
)

Actions = Literal["continuous", "discrete"]


def observation_space() -> spaces.Box:
    """Describe observations: bounded as ``functional.to_vector`` clips them."""
    return spaces.Box(-BOUND, BOUND, (OBSERVATION_SIZE,), np.float32)


def action_space(actions: str) -> spaces.Box | spaces.Discrete[np.int64]:
    """Describe actions: a step along x and y, and stop; or one of few, the first of them stop.

    Args:
        actions: "continuous" or "discrete".

    Returns:
        The space.

    Raises:
        ValueError: neither of these.
    """
    known = get_args(Actions)
    if actions not in known:
        raise ValueError(f'actions is "{actions}", but must be one of {", ".join(known)}')
    if actions == "discrete":
        return spaces.Discrete(len(DISCRETE_ACTIONS))
    return spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)


def to_functional(actions: Any, space: spaces.Space[Any]) -> np.ndarray:
    """Turn actions of a space, one or many, into those of ``functional``: f32[..., 3]."""
    if isinstance(space, spaces.Discrete):
        return DISCRETE_ACTIONS[np.asarray(actions)]
    return np.asarray(actions, np.float32)
