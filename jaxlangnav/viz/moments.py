"""Which moments of an episode to show: the few panels that tell its story (Figures 1 and 4).

The first and the last step always; between them the steps at which the belief or the plan
changed most, no two side by side.
"""

import numpy as np

from jaxlangnav.recording import Recording
from jaxlangnav.viz.summary import expected_goal


def change(recording: Recording) -> np.ndarray:
    """Measure how much each step changed what is believed and planned.

    Args:
        recording: an episode.

    Returns:
        f64[T], arbitrary units: a new object counts most, then the share of hypotheses drawn
        anew, the shift of the expected goal, and a new waypoint.
    """
    frames = recording.frames
    goal = expected_goal(frames)
    shift = np.zeros(recording.num_steps)
    shift[1:] = np.hypot(*np.diff(goal, axis=0).T)
    moved = np.zeros(recording.num_steps)
    moved[1:] = np.any(np.diff(frames.waypoint, axis=0) != 0, axis=1)
    share = frames.num_regrounded / recording.num_particles
    return 2.0 * frames.is_news + share + 0.25 * np.nan_to_num(shift) + 0.2 * moved


def pick_moments(recording: Recording, number: int = 6) -> list[int]:
    """Choose the steps to show.

    Args:
        recording: an episode of T steps.
        number: panels wanted, at least 1.

    Returns:
        Steps in order, min(number, T) of them; the first and the last step among them if
        number > 1, otherwise the last one.

    Raises:
        ValueError: ``number`` is less than 1.
    """
    if number < 1:
        raise ValueError(f"number of panels is {number}, but must be at least 1")
    last = recording.num_steps - 1
    chosen = {0, last} if number > 1 else {last}
    score = change(recording)
    # Everything else being equal the panels spread over the episode.
    for _ in range(min(number, recording.num_steps) - len(chosen)):
        steps = np.arange(recording.num_steps)
        gap = np.min(np.abs(steps[:, None] - np.array(sorted(chosen))[None, :]), axis=1)
        spread = gap / max(1, last)
        merit = np.where(gap == 0, -np.inf, score * np.minimum(gap / 2.0, 1.0) + 2.0 * spread)
        chosen.add(int(np.argmax(merit)))
    return sorted(chosen)
