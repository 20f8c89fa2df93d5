"""Live view of a running episode in the terminal: ``jaxlangnav follow --live``.

A character map beside the narrative of the step. Each cell shows the highest of these layers:
robot, waypoint, observed objects, the densest hypotheses, the ground.
"""

import time
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.episode.recording import (
    Recording,
    Remark,
    Snapshot,
    StaticScene,
    StepView,
    replay,
    stack_frames,
)
from jaxlangnav.inputs.sanitize import Escaped
from jaxlangnav.viz import narrative, style, summary
from jaxlangnav.viz.sentences import percent

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.text import Text

ARROWS = "→↗↑↖←↙↓↘"
_DENSITY = "·░▒▓"  # hypotheses in a cell, from few to many
_CELL_SHAPE = 2.0  # height of a character over its width


def _letters(scene: StaticScene) -> dict[int, str]:
    """Assign each object type a letter: the first of its name that is still unused."""
    letters: dict[int, str] = {}
    for type_id, name in enumerate(scene.type_names):
        unused = (c for c in name.upper() if c.isalpha() and c not in letters.values())
        letters[type_id] = next(unused, "?")
    return letters


def _draw_map(scene: StaticScene, frame: Snapshot, *, width: int) -> "Text":
    """Draw objects as letters, hypotheses as shades, × the waypoint; dots: unobserved ground."""
    from rich.text import Text

    x_min, x_max, y_min, y_max = scene.area
    height = max(4, round(width * (y_max - y_min) / (x_max - x_min) / _CELL_SHAPE))
    size = frame.miss.shape[0]
    line, column = (((np.arange(n) + 0.5) / n * size).astype(int) for n in (height, width))
    unseen = frame.miss[::-1][line][:, column] >= 0.5
    cells = [["·" if is_unseen else " " for is_unseen in line] for line in unseen]
    styles = [["grey78"] * width for _ in cells]

    def put(x: float, y: float, character: str, style_name: str) -> None:
        column = int(np.clip((x - x_min) / (x_max - x_min) * width, 0, width - 1))
        row = int(np.clip((y_max - y) / (y_max - y_min) * height, 0, height - 1))
        cells[row][column], styles[row][column] = character, style_name

    _shade(scene, frame, cells, styles)
    for x1, y1, x2, y2 in scene.walls:
        for t in np.linspace(0.0, 1.0, 2 * width):
            x, y = x1 + t * (x2 - x1), y1 + t * (y2 - y1)
            put(float(x), float(y), "█", "grey30")
    names = _letters(scene)
    for obj in summary.observed_objects(frame):
        letter = names.get(obj.object_type, "?")
        put(obj.x, obj.y, letter, f"bold white on {style.type_color(obj.object_type)}")
    if not bool(frame.is_done):
        put(float(frame.waypoint[0]), float(frame.waypoint[1]), "×", "bold bright_magenta")
    direction = round(float(frame.heading) / (np.pi / 4)) % 8
    put(float(frame.robot[0]), float(frame.robot[1]), ARROWS[direction], "bold reverse")
    rows = (Text.assemble(*zip(*row, strict=True)) for row in zip(cells, styles, strict=True))
    return Text("\n", no_wrap=True).join(rows)


def _draw_moment(moment: StepView, *, width: int) -> "RenderableType":
    """Render a step: the map beside its narrative and bars of probability."""
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    scene, frame, side = moment.scene, moment.frame, Text()
    side.append(f"step {moment.step} · {float(frame.distance):.1f} m\n", style="bold")
    side.append(f"{narrative.headline(moment)}\n\n", style="italic")
    side.append("\n".join([*narrative.narrate_step(moment), "", ""]))
    for name, frac, bar_style in (
        ("goal seen", float(frame.goal_mass.sum()), style.type_color(0)),
        ("goal unseen", float(frame.hypothesis_goal_mass.sum()), "grey50"),
        ("looked at", summary.explored_fraction(frame), style.type_color(1)),
    ):
        filled = round(20 * min(max(frac, 0.0), 1.0))
        bar = ("█" * filled, bar_style), ("─" * (20 - filled), "grey70")
        side.append(Text.assemble(f"{name:<12}", *bar, f" {percent(frac)}\n"))
    side.append("\n")
    names = _letters(scene)
    for code in sorted({obj.object_type for obj in summary.observed_objects(frame)}):
        side.append(f" {names.get(code, '?')} ", style=f"bold white on {style.type_color(code)}")
        side.append(f" {scene.type_name(code)}  ")
    side.append(f"\n· not looked at, in colour {_DENSITY} hypotheses, × waypoint", style="dim")
    grid = Table.grid(padding=(0, 2))
    grid.add_column(width=width)
    grid.add_column(ratio=1, min_width=30)
    grid.add_row(_draw_map(scene, frame, width=width), side)
    title = Text(f"“{scene.text}”" if scene.text else "Episode")
    return Escaped(Panel(grid, title=title, title_align="left", border_style="grey50"))


def watch(
    scene: StaticScene,
    steps: Iterable[tuple[Snapshot, EpisodeResult]],
    *,
    said: Sequence[Remark] = (),
    console: "Console | None" = None,
    seconds_per_step: float = 0.4,
) -> Recording:
    """Show an episode in the terminal while it runs; returns the recording.

    ``scene`` is of ``recorder.make_scene``, ``steps`` of ``recorder.play``, at least one; ``said``
    may grow as the episode runs. ``seconds_per_step``: minimum display time of a step.
    """
    from rich.console import Console
    from rich.live import Live

    console = console or Console()
    height = max(4, console.height - 4)
    x_min, x_max, y_min, y_max = scene.area
    # The map must fit the screen, or a live display would scroll.
    fitting = int(height * _CELL_SHAPE * (x_max - x_min) / (y_max - y_min))
    width = max(8, min(console.width // 2 - 4, 56, fitting))
    shown: list[StepView] = []
    with Live(console=console, auto_refresh=False, vertical_overflow="crop") as live:
        for moment in replay(scene, steps, said):
            live.update(_draw_moment(moment, width=width), refresh=True)
            shown.append(moment)
            if console.is_terminal:
                time.sleep(seconds_per_step)
    if not shown:
        raise ValueError("an episode needs at least one step")
    return stack_frames(scene, [(step.frame, step.result) for step in shown])


def _shade(
    scene: StaticScene, frame: Snapshot, cells: list[list[str]], styles: list[list[str]]
) -> None:
    """Shade cells by hypothesis density, in the colour of the type with the most weight."""
    x_min, x_max, y_min, y_max = scene.area
    height, width = len(cells), len(cells[0])
    is_in = np.asarray(frame.is_hypothesised)
    if not is_in.any():
        return
    x, y = frame.hypothesis_x[is_in], frame.hypothesis_y[is_in]
    types, type_index = np.unique(frame.mention_type[is_in], return_inverse=True)
    mass, _ = np.histogramdd(
        (type_index, y, x),
        bins=(len(types), height, width),
        range=((-0.5, len(types) - 0.5), (y_min, y_max), (x_min, x_max)),
        weights=np.broadcast_to(frame.weight, is_in.shape)[is_in],
    )
    mass = mass[:, ::-1]
    total = mass.sum(axis=0)
    # A tenth of all belief in one cell counts as dense.
    density = np.ceil(np.sqrt(np.clip(total / 0.1, 0.0, 1.0)) * len(_DENSITY)).astype(int)
    for row, column in zip(*np.nonzero(density), strict=True):
        heaviest = int(types[int(np.argmax(mass[:, row, column]))])
        cells[row][column] = _DENSITY[density[row, column] - 1]
        styles[row][column] = style.type_color(heaviest)
