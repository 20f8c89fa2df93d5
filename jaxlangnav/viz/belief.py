"""The belief over time, as Figure 1 of the paper: where the goal may be, and how that changes."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from jaxlangnav.recording import Recording
from jaxlangnav.viz import mapping, panels, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def belief_figure(
    recording: Recording, *, steps: Sequence[int] | None = None, num_panels: int = 6
) -> "Figure":
    """Draw the belief at several moments of an episode.

    Args:
        recording: the episode.
        steps: moments to show, see ``panels.choose_steps``.
        num_panels: how many, where no moments are given.

    Returns:
        What ``style.save`` writes.

    Raises:
        MissingExtraError: without matplotlib.
        ValueError: a step is not in the recording, or there are none.
    """
    chosen = panels.choose_steps(recording, steps, num_panels)
    scene = recording.scene
    with style.house_style():
        text = (
            "Dots: hypotheses, one map per particle, stronger where heavier. Grey: not looked at."
        )
        figure, maps, _ = panels.lay_out(recording, len(chosen), text=text, foot=0.62)
        for index, (axes, step) in enumerate(zip(maps, chosen, strict=True)):
            frame = recording.at(step)
            mapping.draw_ground(axes, scene, frame)
            mapping.draw_truth(axes, scene)
            mapping.draw_hypotheses(axes, frame)
            mapping.draw_objects(axes, frame)
            mapping.draw_path(axes, recording, step)
            mapping.draw_view(axes, scene, frame)
            mapping.draw_waypoint(axes, frame)
            mapping.draw_robot(axes, frame)
            panels.head_panel(axes, recording, step, index)
        panels.add_legend(figure, mapping.legend_handles(recording))
    return figure
