"""A robot that somebody else drives, as a picture: the true world, the way gone, what is in view.

Unlike the pictures of an episode there is no belief to show: what ``environments`` renders.
"""

from typing import TYPE_CHECKING

import numpy as np

from jaxlangnav.viz import mapping, style

if TYPE_CHECKING:
    from jaxlangnav.viz.mapping import HasPlace, HasScenario, HasSensor

_HEIGHT = 4.8
_HEAD, _SIDE, _FOOT = 0.62, 0.55, 0.45
_DOTS = 100


def drive_picture(
    state: "HasScenario", *, params: "HasSensor", world: "HasPlace", way: np.ndarray, text: str
) -> np.ndarray:
    """Draw the true world with the robot in it.

    Args:
        state: holds the true world.
        params: hold the sensor's specification.
        world: where the robot is.
        way: f32[T, 2], true positions so far, metres.
        text: the command.

    Returns:
        u8[480, W, 3], red, green, blue; the width follows from the area's shape.

    Raises:
        MissingExtraError: without matplotlib.
    """
    style.require("matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    x_min, x_max, y_min, y_max = (float(edge) for edge in state.scenario.area)
    tall = _HEIGHT - _HEAD - _FOOT
    wide = max(tall * (x_max - x_min) / (y_max - y_min), 2.4)
    with style.house_style():
        figure = Figure(figsize=(wide + 2 * _SIDE, _HEIGHT), dpi=_DOTS)
        canvas = FigureCanvasAgg(figure)
        width = wide + 2 * _SIDE
        place = (_SIDE / width, _FOOT / _HEIGHT, wide / width, tall / _HEIGHT)
        axes = figure.add_axes(place)
        mapping.frame_area(axes, (x_min, x_max, y_min, y_max))
        mapping.draw_truth(axes, state)
        mapping.draw_view(axes, params, world)
        axes.plot(way[:, 0], way[:, 1], color=style.PATH, linewidth=1.1, zorder=4)
        mapping.draw_robot(axes, world)
        metres = float(np.hypot(*np.diff(way, axis=0).T).sum())
        style.title(figure, f"“{text}”", f"step {len(way) - 1} · {metres:.1f} m")
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()
