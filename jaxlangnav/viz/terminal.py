"""An episode in the terminal as it happens: ``jaxlangnav follow --live``.

A map of characters beside the story of the step. What shares a cell is drawn in the order of
importance: robot, waypoint, observed objects, the densest hypotheses, the ground.
"""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.episode.recording import (
    Frame,
    Moment,
    Recording,
    Remark,
    StaticScene,
    moments,
    stack_frames,
)
from jaxlangnav.inputs.sanitize import Plain
from jaxlangnav.viz import narrative, style, summary
from jaxlangnav.viz.sentences import percent

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.text import Text

ARROWS = "→↗↑↖←↙↓↘"
_DENSITY = "·░▒▓"  # hypotheses in a cell, from few to many
_CELL_SHAPE = 2.0  # height of a character over its width


def _letters(scene: StaticScene) -> dict[int, str]:
    """Give each object type a letter of its own: the first of its name that is still free."""
    taken: dict[int, str] = {}
    for kind, name in enumerate(scene.type_names):
        free = (one for one in name.upper() if one.isalpha() and one not in taken.values())
        taken[kind] = next(free, "?")
    return taken


def _draw_map(scene: StaticScene, frame: Frame, *, width: int = 48) -> "Text":
    # Letters are observed objects (H a hydrant), shades where hypotheses lie, × the waypoint, an
    # arrow the robot; blank ground has been looked at, dots have not.
    from rich.text import Text

    x_min, x_max, y_min, y_max = scene.area
    width = max(width, 8)
    height = max(4, round(width * (y_max - y_min) / (x_max - x_min) / _CELL_SHAPE))
    size = frame.miss.shape[0]
    line, column = (((np.arange(n) + 0.5) / n * size).astype(int) for n in (height, width))
    unseen = frame.miss[::-1][line][:, column] >= 0.5
    cells = [["·" if one else " " for one in line] for line in unseen]
    looks = [["grey78"] * width for _ in cells]

    def put(x: float, y: float, character: str, look: str) -> None:
        column = int(np.clip((x - x_min) / (x_max - x_min) * width, 0, width - 1))
        row = int(np.clip((y_max - y) / (y_max - y_min) * height, 0, height - 1))
        cells[row][column], looks[row][column] = character, look

    _shade(scene, frame, cells, looks)
    for one_x, one_y, other_x, other_y in scene.walls:
        for part in np.linspace(0.0, 1.0, 2 * width):
            x, y = one_x + part * (other_x - one_x), one_y + part * (other_y - one_y)
            put(float(x), float(y), "█", "grey30")
    names = _letters(scene)
    for one in summary.seen_objects(frame):
        letter = names.get(one.object_type, "?")
        put(one.x, one.y, letter, f"bold white on {style.type_color(one.object_type)}")
    if not bool(frame.is_done):
        put(float(frame.waypoint[0]), float(frame.waypoint[1]), "×", "bold bright_magenta")
    turn = round(float(frame.heading) / (np.pi / 4)) % 8
    put(float(frame.robot[0]), float(frame.robot[1]), ARROWS[turn], "bold reverse")
    text = Text(no_wrap=True)
    for row, (line, styles) in enumerate(zip(cells, looks, strict=True)):
        for character, look in zip(line, styles, strict=True):
            text.append(character, style=look)
        text.append("\n" if row < height - 1 else "")
    return text


def _draw_moment(moment: Moment, *, width: int = 48) -> "RenderableType":
    """Draw a step: the map, and beside it what happens and how sure the robot is."""
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    scene, frame, side = moment.scene, moment.frame, Text()
    side.append(f"step {moment.step} · {float(frame.distance):.1f} m\n", style="bold")
    side.append(f"{narrative.headline(moment)}\n\n", style="italic")
    for sentence in narrative.tell_step(moment):
        side.append(f"{sentence}\n")
    side.append("\n")
    for name, share, look in (
        ("goal seen", float(frame.goal_mass.sum()), style.type_color(0)),
        ("goal unseen", float(frame.hypothesis_goal_mass.sum()), "grey50"),
        ("looked at", summary.explored_share(frame), style.type_color(1)),
    ):
        full = round(20 * min(max(share, 0.0), 1.0))
        bar = ("█" * full, look), ("─" * (20 - full), "grey70")
        side.append(Text.assemble(f"{name:<12}", *bar, f" {percent(share)}\n"))
    side.append("\n")
    names = _letters(scene)
    for kind in sorted({one.object_type for one in summary.seen_objects(frame)}):
        side.append(f" {names.get(kind, '?')} ", style=f"bold white on {style.type_color(kind)}")
        side.append(f" {scene.type_name(kind)}  ")
    grid = Table.grid(padding=(0, 2))
    grid.add_column(width=max(width, 8))
    grid.add_column(ratio=1, min_width=30)
    grid.add_row(_draw_map(scene, frame, width=width), side)
    title = Text(f"“{scene.text}”" if scene.text else "Episode")
    return Plain(Panel(grid, title=title, title_align="left", border_style="grey50"))


def watch(
    scene: StaticScene,
    steps: Iterable[tuple[Frame, EpisodeResult]],
    *,
    said: Sequence[Remark] = (),
    console: "Console | None" = None,
    seconds_per_step: float = 0.4,
) -> Recording:
    """Draw an episode in the terminal while it runs; returns it as ``recorder.record`` would.

    ``scene`` is of ``recorder.scene_of``, ``steps`` of ``recorder.play``, at least one; ``said``
    may grow as the episode runs. ``seconds_per_step``: least time a step stays on the screen.
    """
    import time

    from rich.console import Console
    from rich.live import Live

    console = console or Console()
    width = int(np.clip(console.width // 2 - 4, 8, 56))
    height = max(4, console.height - 4)
    x_min, x_max, y_min, y_max = scene.area
    # The map must fit the screen, or a live display would scroll.
    width = min(width, int(height * _CELL_SHAPE * (x_max - x_min) / (y_max - y_min)))
    seen: list[Moment] = []
    with Live(console=console, auto_refresh=False, vertical_overflow="crop") as live:
        for moment in moments(scene, steps, said):
            live.update(_draw_moment(moment, width=width), refresh=True)
            seen.append(moment)
            if console.is_terminal:
                time.sleep(seconds_per_step)
    if not seen:
        raise ValueError("an episode needs at least one step")
    return stack_frames(scene, [one.frame for one in seen], seen[-1].result)


def _shade(
    scene: StaticScene, frame: Frame, cells: list[list[str]], looks: list[list[str]]
) -> None:
    """Shade the cells in which hypotheses lie, in the colour of the type that weighs most."""
    x_min, x_max, y_min, y_max = scene.area
    height, width = len(cells), len(cells[0])
    is_in = np.asarray(frame.is_hypothesised)
    if not is_in.any():
        return
    x, y = frame.hypothesis_x[is_in], frame.hypothesis_y[is_in]
    weight = np.broadcast_to(frame.weight, is_in.shape)[is_in]
    kinds, kind = np.unique(frame.mention_type[is_in], return_inverse=True)
    mass, _ = np.histogramdd(
        (kind, y, x),
        bins=(len(kinds), height, width),
        range=((-0.5, len(kinds) - 0.5), (y_min, y_max), (x_min, x_max)),
        weights=weight,
    )
    mass = mass[:, ::-1]
    total = mass.sum(axis=0)
    # A tenth of all belief in one cell counts as dense.
    level = np.ceil(np.sqrt(np.clip(total / 0.1, 0.0, 1.0)) * len(_DENSITY)).astype(int)
    for row, column in zip(*np.nonzero(level), strict=True):
        heaviest = int(kinds[int(np.argmax(mass[:, row, column]))])
        cells[row][column] = _DENSITY[level[row, column] - 1]
        looks[row][column] = style.type_color(heaviest)
