"""Simulated SLAM scenario with eight landmarks, to compare filters.

The robot knows its heading, as ours does; odometry has noise in each axis; all landmarks are in
range all the time, each with a unique type, so that the data association is known.
"""

import dataclasses

import numpy as np

LANDMARKS = np.array(
    [[3, -2], [6, 3], [9, -1], [5, 7], [1, 6], [-3, 3], [-2, -3], [8, 8]], np.float64
)
"""[L, 2] metres."""
STEP = 0.5
"""Metres a step."""
ODOMETRY_NOISE = 0.1
"""Standard deviation per axis as a fraction of the distance."""
SENSOR_NOISE = 0.1
"""Standard deviation of a relative position, each axis, metres."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Drive:
    """Ground truth and measurements of a drive; T steps, L landmarks. Metres, map axes."""

    truth: np.ndarray
    """f64[T, 2] positions after each step; the start is the origin, known."""
    odometry: np.ndarray
    """f64[T, 2] measured displacement of each step."""
    offsets: np.ndarray
    """f64[T, L, 2] measured positions of the landmarks relative to the robot."""


def drive(num_steps: int, seed: int) -> Drive:
    """Simulate a drive on a circle of 3 m radius.

    Args:
        num_steps: T.
        seed: of all noise.

    Returns:
        The drive.
    """
    rng = np.random.default_rng(seed)
    angle = STEP / 3.0 * np.arange(num_steps)
    moves = STEP * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    truth = np.cumsum(moves, axis=0)
    odometry = moves + ODOMETRY_NOISE * STEP * rng.normal(size=moves.shape)
    offsets = LANDMARKS[None] - truth[:, None]
    return Drive(
        truth=truth,
        odometry=odometry,
        offsets=offsets + SENSOR_NOISE * rng.normal(size=offsets.shape),
    )


def error(robot: np.ndarray, landmarks: np.ndarray, of: Drive) -> float:
    """Compute the error of an estimate at the end of a drive.

    Args:
        robot: f64[2], metres.
        landmarks: f64[L, 2], metres.
        of: the drive.

    Returns:
        Root mean square over robot and landmarks, metres.
    """
    estimated = np.concatenate([robot[None], landmarks])
    true = np.concatenate([of.truth[-1:], LANDMARKS])
    return float(np.sqrt(np.mean(np.sum((estimated - true) ** 2, axis=1))))
