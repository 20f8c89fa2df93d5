"""The house style of all pictures: light, colour-blind safe, readable in print.

Colours are Okabe and Ito's; every colour that carries a meaning comes with a shape of its own, so
that nothing is lost in grey. matplotlib belongs to the extra ``viz``. It is imported where it is
used and never through pyplot: no window, no global figure, no style left behind in a notebook.
"""

import importlib
import importlib.util
import itertools
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxlangnav.inputs.object_types import is_anything
from jaxlangnav.inputs.sanitize import sanitize
from jaxlangnav.inputs.whole_files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.figure import Figure

INK = "#1f2328"
MUTED = "#6b7280"
LINE = "#d5d8dd"
PAPER = "#ffffff"
UNSEEN = "#dfe3e8"  # ground that nobody has looked at
PATH = "#1f2328"
WALL = "#4b3621"
VIEW = "#7aa6c2"  # the field of view
GOOD = "#009e73"
BAD = "#b3261e"
WAYPOINT = "#7b3294"
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#7a6a00", "#56b4e9")
"""Lines of a chart, in this order."""
TYPE_COLORS = (
    "#d55e00",  # hydrant
    "#0072b2",  # cone
    "#009e73",  # car
    "#6b7280",  # building
    "#5b7f2b",  # tree
    "#8c564b",  # bench
    "#cc79a7",  # barrel
    "#b8860b",  # box
)
TYPE_MARKERS = ("o", "s", "D", "p", "^", "P", "h", "X")
"""Marker of each object type, in matplotlib's letters."""
SPLIT = {"goal": "#d55e00", "information": "#0072b2", "cost": "#6b7280"}  # parts of a value
VALUE_STOPS = ("#f2ead3", "#e3c878", "#7fb08a", "#2f7f8f", "#173f5f")
"""Sequential ramp of the value function, light to dark: monotone in lightness."""
Mark = tuple[str, str, str]
POLICY_LOOKS = {
    "informed": (SERIES[0], "o", "informed (ours)"),
    "faithful": (SERIES[1], "s", "faithful (the paper's method)"),
    "frontier": (SERIES[2], "^", "nearest frontier, no language"),
    "lawnmower": (SERIES[3], "v", "lawnmower, no language"),
    "arc": (SERIES[4], "<", "sweep that knows the worlds' law"),
    "known": (MUTED, "", "known map"),
}
"""Colour, marker and name of each policy."""
_BOLD_WIDTH, _PLAIN_WIDTH = 0.69, 0.6
"""Mean width of a character over the size of its type, on the safe side."""


class MissingExtraError(ValueError):
    """A picture was asked for, but what draws it is not installed; the message is one line."""


def require(module: str, *, extra: str = "viz") -> Any:
    """Load a module, or raise ``MissingExtraError``, which says what to install."""
    if importlib.util.find_spec(module) is None:
        raise MissingExtraError(
            f"{module} is not installed: pip install 'jaxlangnav[{extra}]' brings it"
        )
    return importlib.import_module(module)


def type_color(object_type: int) -> str:
    """Give an object type its colour; types beyond the eight share them in turn."""
    is_typed = object_type >= 0 and not is_anything(object_type)
    return TYPE_COLORS[object_type % len(TYPE_COLORS)] if is_typed else MUTED


def type_marker(object_type: int) -> str:
    """Give an object type its marker; of the first sixty-four no two share it and the colour."""
    if is_anything(object_type):
        return "*"
    turn = object_type // len(TYPE_COLORS)
    return TYPE_MARKERS[(object_type + turn) % len(TYPE_MARKERS)] if object_type >= 0 else "x"


def looks_of(arms: Sequence[str]) -> dict[str, Mark]:
    """Give each arm its colour, marker and name; what is no policy takes the next colour."""
    looks = zip(itertools.cycle(SERIES), itertools.cycle("os^vDPXh"), arms, strict=False)
    return {arm: POLICY_LOOKS.get(arm, (color, marker, arm)) for color, marker, arm in looks}


def add_legend(figure: "Figure", panels: "Iterable[Axes]", *, columns: int = 3) -> None:
    """Put the legend over several panels along the bottom of a figure, each label once."""
    found: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(list(found.values()), list(found), loc="lower center", ncols=columns)


def panels(
    size: tuple[float, float],
    rows: int,
    columns: int,
    margins: tuple[float, float, float, float],
    **how: Any,
) -> "tuple[Figure, np.ndarray]":
    """Set up a figure, inches, with axes [rows, columns]; ``how``: of ``Figure.subplots``.

    ``margins``: at the left, at the right, above and below, inches; ``wspace`` and ``hspace`` may
    be among ``how``.
    """
    from matplotlib.figure import Figure

    (wide, tall), (left, right, head, foot) = size, margins
    places = {"left": left / wide, "right": 1 - right / wide, "top": 1 - head / tall}
    spaces = {name: how.pop(name) for name in ("wspace", "hspace") if name in how}
    figure = Figure(figsize=size)
    grid = figure.subplots(rows, columns, squeeze=False, **how)
    figure.subplots_adjust(**places, bottom=foot / tall, **spaces)
    return figure, grid


def value_colormap() -> "LinearSegmentedColormap":
    """Build the colour map of the value function."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("jaxlangnav-value", VALUE_STOPS)


def rc() -> dict[str, Any]:
    """Build matplotlib's settings of the house style."""
    return {
        "figure.facecolor": PAPER,
        "figure.dpi": 110,
        "savefig.dpi": 160,
        "font.family": "DejaVu Sans",
        "font.size": 8.5,
        "axes.titlesize": 9,
        "axes.titlelocation": "left",
        "axes.titleweight": "bold",
        "axes.labelsize": 8.5,
        "axes.labelcolor": INK,
        "axes.edgecolor": MUTED,
        "axes.linewidth": 0.7,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.axisbelow": True,
        "text.color": INK,
        # A dollar sign in somebody's sentence or file name is no formula.
        "text.parse_math": False,
        "xtick.color": MUTED,
        "ytick.color": MUTED,
        "xtick.labelsize": 7.5,
        "ytick.labelsize": 7.5,
        "grid.color": LINE,
        "grid.linewidth": 0.6,
        "legend.frameon": False,
        "legend.fontsize": 7.5,
        "lines.linewidth": 1.6,
        "svg.hashsalt": "jaxlangnav",
        "svg.fonttype": "path",
    }


@contextmanager
def house_style() -> Iterator[None]:
    """Draw in the house style inside the block; settings outside stay as they were."""
    with require("matplotlib").rc_context(rc()):
        yield


def title(figure: "Figure", text: str, subtitle: str = "") -> None:
    """Head a figure at its upper left: what it shows in bold, how to read it beneath.

    Long headlines are set smaller, and cut where even that does not fit. The figure's layout must
    leave half an inch at the top.
    """
    text = sanitize(text)
    width, height = figure.get_figwidth(), figure.get_figheight()
    left = 0.12 / width
    text, size = _fitted(text, width - 0.3, 12.0, 8.0, _BOLD_WIDTH)
    figure.text(left, 1 - 0.10 / height, text, va="top", fontsize=size, fontweight="bold")
    if subtitle:
        longest = max(subtitle.split("\n"), key=len)
        _, size = _fitted(longest, width - 0.3, 8.5, 6.5, _PLAIN_WIDTH)
        figure.text(left, 1 - 0.36 / height, subtitle, va="top", fontsize=size, color=MUTED)


def _fitted(text: str, width: float, most: float, least: float, share: float) -> tuple[str, float]:
    """Find the size in points at which a line fits into inches; cut it if there is none."""
    size = min(most, width * 72 / (share * max(1, len(text))))
    if size >= least:
        return text, size
    keep = int(width * 72 / (share * least)) - 1
    return text[:keep].rstrip() + "…", least


def save(figure: "Figure", stem: Path | str) -> tuple[Path, Path]:
    """Write a figure as PNG and SVG, all or nothing; folders are made, ``stem`` has no ending."""
    stem = Path(stem)
    paths = (stem.with_name(stem.name + ".png"), stem.with_name(stem.name + ".svg"))
    with house_style():
        for path in paths:
            kind = path.suffix[1:]
            metadata = {"Date": None} if kind == "svg" else {}
            with replacing(path) as temporary:
                figure.savefig(temporary, format=kind, metadata=metadata)
    return paths
