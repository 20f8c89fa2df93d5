"""Which moments of an episode to show: the few panels that tell its story (Figures 1 and 4).

The first and the last step always; between them the steps at which the belief or the plan
changed most, no two side by side.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxlangnav.experiments.table import Table
from jaxlangnav.recording import Recording
from jaxlangnav.viz.narrative import headline
from jaxlangnav.viz.summary import expected_goal, explored_share
from jaxlangnav.viz.words import percent


def step_changes(recording: Recording) -> np.ndarray:
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
    score = step_changes(recording)
    # Everything else being equal the panels spread over the episode.
    for _ in range(min(number, recording.num_steps) - len(chosen)):
        steps = np.arange(recording.num_steps)
        gap = np.min(np.abs(steps[:, None] - np.array(sorted(chosen))[None, :]), axis=1)
        spread = gap / max(1, last)
        merit = np.where(gap == 0, -np.inf, score * np.minimum(gap / 2.0, 1.0) + 2.0 * spread)
        chosen.add(int(np.argmax(merit)))
    return sorted(chosen)


def describe_moments(recording: Recording, steps: Sequence[int]) -> list[dict[str, Any]]:
    """Say in numbers what the panels of a figure show.

    Args:
        recording: the episode.
        steps: the moments.

    Returns:
        For each: ``step``, ``distance`` walked (m), ``event``, ``goal_seen`` (probability that the
        goal is an observed object), ``unseen_left`` and ``unseen_right`` (that it is unseen, on
        either side of the line along which the robot began), ``spread`` of the unseen goal (m,
        root mean square from its mean; None where it has been seen), ``explored`` (share of the
        area).
    """
    x, y, heading = (float(one) for one in recording.scene.scenario.start)
    found = []
    for step in steps:
        frame = recording.at(step)
        before = recording.at(step - 1) if step else None
        mass = np.asarray(frame.hypothesis_goal_mass, float)
        gone_x, gone_y = frame.hypothesis_goal_x - x, frame.hypothesis_goal_y - y
        is_left = np.cos(heading) * gone_y - np.sin(heading) * gone_x > 0.0
        found.append(
            {
                "step": step,
                "distance": float(frame.distance),
                "event": headline(recording.scene_at(step), frame, before, recording.said_at(step)),
                "goal_seen": float(frame.goal_mass.sum()),
                "unseen_left": float(mass[is_left].sum()),
                "unseen_right": float(mass[~is_left].sum()),
                "spread": _spread(gone_x, gone_y, mass),
                "explored": explored_share(frame),
            }
        )
    return found


def moments_table(moments: Sequence[dict[str, Any]]) -> Table:
    """Lay out the moments of a figure.

    Args:
        moments: of ``describe_moments``.

    Returns:
        A line for each.
    """
    headings = ["step", "walked m", "what happens", "goal seen", "unseen, left", "unseen, right",
                "its spread m", "looked at"]  # fmt: skip
    rows = [
        [
            str(one["step"]),
            f"{one['distance']:.1f}",
            one["event"],
            *(percent(one[name]) for name in ("goal_seen", "unseen_left", "unseen_right")),
            "" if one["spread"] is None else f"{one['spread']:.1f}",
            percent(one["explored"]),
        ]
        for one in moments
    ]
    return Table(headings=headings, rows=rows)


def _spread(x: np.ndarray, y: np.ndarray, mass: np.ndarray) -> float | None:
    """Compute the root mean square distance from the mean; None where there is hardly any mass."""
    total = mass.sum()
    if total < 0.05:
        return None
    square = (x - (x @ mass) / total) ** 2 + (y - (y @ mass) / total) ** 2
    return float(np.sqrt((square @ mass) / total))
