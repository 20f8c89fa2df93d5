"""What an agent may do: a step along the map's axes and stop, continuous or one of few."""

import math

import numpy as np

ACTION_SIZE = 3
STOP_ABOVE = 0.9
"""An action stops where its last entry is above this: one in twenty of uniformly random ones."""
NUM_DIRECTIONS = 16


def _all_around() -> np.ndarray:
    """List stop and the steps all around."""
    turns = np.arange(NUM_DIRECTIONS) * (2.0 * math.pi / NUM_DIRECTIONS)
    steps = np.stack([np.cos(turns), np.sin(turns), np.full(NUM_DIRECTIONS, -1.0)], axis=1)
    return np.concatenate([[[0.0, 0.0, 1.0]], steps]).astype(np.float32)


DISCRETE_ACTIONS = _all_around()
"""f32[17, 3], the discrete actions: stop, then the greatest step in 16 directions, +x to +y."""
