"""How a row of map panels is laid out: sizes from the area's shape, headline, legend, letters."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from jaxlangnav.messages import Status
from jaxlangnav.recording import Recording
from jaxlangnav.viz import style
from jaxlangnav.viz.moments import pick_moments
from jaxlangnav.viz.narrative import headline

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

_WIDTH = 10.5
"""Width of a figure, inches: two columns of a journal, or a screen."""


def _num_columns(number: int, shape: float) -> int:
    """Choose the columns of a grid of maps."""
    if number <= (4 if shape < 1.0 else 3):
        return number
    return math.ceil(number / 2) if shape >= 0.5 else number


def lay_out(
    recording: Recording, number: int, *, text: str, foot: float, extra: float = 0.0
) -> "tuple[Figure, list[Axes], list[Axes]]":
    """Lay out a figure of maps.

    Args:
        recording: the episode; its area gives the maps their shape.
        number: maps.
        text: line of explanation under the headline.
        foot: inches left free at the bottom for the legend.
        extra: inches beneath each map for a small chart; 0 for none.

    Returns:
        The figure, the axes of the maps, and those of the charts (none without ``extra``).
    """
    from matplotlib.figure import Figure

    x_min, x_max, y_min, y_max = recording.scene.area
    shape = (x_max - x_min) / (y_max - y_min)
    columns = _num_columns(number, shape)
    rows = math.ceil(number / columns)
    left, gap, right, head = 0.62, 0.16, 0.12, 0.66
    above, below = 0.42, 0.40
    width = min((_WIDTH - left - right - gap * (columns - 1)) / columns, 3.6)
    height = min(width / shape, 4.4)
    width = min(width, height * shape)
    chart = extra + 0.30 if extra else 0.0
    total = left + right + gap * (columns - 1) + width * columns
    tall = head + foot + rows * (above + height + below + chart)
    # The headline and the legend need room of their own, however few the maps.
    total = max(total, 8.4)
    side = left + (total - left - right - gap * (columns - 1) - width * columns) / 2
    figure = Figure(figsize=(total, tall))
    maps, charts = [], []
    for index in range(number):
        row, column = divmod(index, columns)
        x = side + column * (width + gap)
        y = tall - head - row * (above + height + below + chart) - above - height
        maps.append(figure.add_axes((x / total, y / tall, width / total, height / tall)))
        if extra:
            y = y - below - extra
            charts.append(figure.add_axes((x / total, y / tall, width / total, extra / tall)))
        maps[-1].set_xlabel("x (m)" if row == rows - 1 or index + columns >= number else "")
        maps[-1].set_ylabel("y (m)" if column == 0 else "")
        maps[-1].tick_params(labelleft=column == 0)
        maps[-1].xaxis.labelpad = maps[-1].yaxis.labelpad = 2
    style.title(
        figure,
        f"“{recording.scene.text}”" if recording.scene.text else "Episode",
        f"{verdict(recording)}.\n{text}",
    )
    return figure, maps, charts


def head_panel(axes: "Axes", recording: Recording, step: int, index: int) -> None:
    """Head a panel: its letter, the step and the way so far; beneath, what happens.

    Args:
        axes: the panel.
        recording: the episode.
        step: shown in the panel.
        index: of the panel.
    """
    frame = recording.at(step)
    before = recording.at(step - 1) if step else None
    letter = chr(ord("a") + index % 26)
    head = f"({letter}) step {step} · {float(frame.distance):.1f} m"
    axes.set_title(head, pad=16)
    axes.annotate(
        headline(recording.scene_at(step), frame, before, recording.said_at(step)),
        xy=(0, 1),
        xytext=(0, 5),
        xycoords="axes fraction",
        textcoords="offset points",
        fontsize=8,
        color=style.MUTED,
    )


def outcome(recording: Recording) -> str:
    """Say in two or three words how the episode ended."""
    result = recording.result
    if recording.ended:
        return recording.ended.partition(":")[0].replace("_", " ")
    if int(result.ending) in (Status.HALTED, Status.IDLE):
        return "halted" if int(result.ending) == Status.HALTED else "cancelled"
    if not bool(result.is_stopped):
        return "failure: out of time"
    if int(result.ending) == Status.NOT_FOUND:
        return "not found"
    if not recording.scene.is_judged:
        return "cannot be judged"
    return "success" if bool(result.is_success) else "failure"


def verdict(recording: Recording) -> str:
    """Say in half a line how the episode ended."""
    result, ended = recording.result, outcome(recording)
    if not recording.scene.is_judged:
        return f"{recording.scene.policy} policy: {ended}, for {recording.scene.unjudged}"
    away, walked = float(result.goal_distance), float(result.distance)
    return (
        f"{recording.scene.policy} policy: {ended}, {away:.1f} m from the meant goal after "
        f"{walked:.1f} m (known map, to where it may stop: "
        f"{recording.scene.straight_distance:.1f} m)"
    )


def choose_steps(recording: Recording, steps: Sequence[int] | None, number: int) -> list[int]:
    """Choose the moments that a figure shows.

    Args:
        recording: the episode.
        steps: moments to show, negative ones counted from the end; those that tell the most if
            None.
        number: how many, where ``steps`` are not given.

    Returns:
        The moments in [0, T).

    Raises:
        ValueError: a step is not in the recording, or the list is empty.
    """
    return check_steps(recording, steps) or pick_moments(recording, number)


def check_steps(recording: Recording, steps: Sequence[int] | None) -> list[int]:
    """Check the moments a person asks for.

    Args:
        recording: the episode.
        steps: moments, negative ones counted from the end; None for none.

    Returns:
        The moments in [0, T); empty for None.

    Raises:
        ValueError: a step is not in the recording, or the list is empty.
    """
    if steps is None:
        return []
    number = recording.num_steps
    if not steps:
        raise ValueError("steps is empty, but a figure needs at least one moment")
    for step in steps:
        if not -number <= step < number:
            raise ValueError(f"step is {step}, but the recording has steps 0 to {number - 1}")
    return [step % number for step in steps]


def add_legend(figure: "Figure", handles: "Sequence[Line2D]") -> None:
    """Put a legend along the bottom of a figure, in as many columns as fit.

    Args:
        figure: laid out with half an inch at the bottom.
        handles: what to list.
    """
    columns = min(len(handles), max(3, int(figure.get_figwidth() / 1.55)))
    rows = math.ceil(len(handles) / columns)
    figure.legend(
        handles=list(handles),
        loc="lower center",
        ncols=math.ceil(len(handles) / rows),
        bbox_to_anchor=(0.5, 0.02 / figure.get_figheight()),
        columnspacing=1.4,
        handletextpad=0.5,
    )
