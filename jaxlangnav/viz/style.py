"""Plot style of all figures: light, colour-blind safe, readable in print.

Colours are Okabe and Ito's; every colour that carries a meaning has a distinct marker too, so
that figures work in greyscale. matplotlib belongs to the extra ``viz``. It is imported where it is
used and never through pyplot: no window, no global figure, no change of a notebook's style.
"""

import importlib
import importlib.util
import itertools
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxlangnav.inputs.atomic_files import replacing
from jaxlangnav.inputs.object_types import is_anything
from jaxlangnav.inputs.sanitize import sanitize

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.figure import Figure

INK = "#1f2328"
MUTED = "#6b7280"
LINE = "#d5d8dd"
PAPER = "#ffffff"
UNSEEN = "#dfe3e8"  # unobserved ground
PATH = "#1f2328"
WALL = "#4b3621"
VIEW = "#7aa6c2"  # the field of view
GOOD = "#009e73"
BAD = "#b3261e"
WAYPOINT = "#7b3294"
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#7a6a00", "#56b4e9")
"""Colour cycle of the series of a chart."""
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
"""Marker of each object type, as matplotlib codes."""
SPLIT = {"goal": "#d55e00", "information": "#0072b2", "cost": "#6b7280"}  # terms of the value
VALUE_STOPS = ("#f2ead3", "#e3c878", "#7fb08a", "#2f7f8f", "#173f5f")
"""Sequential colormap of the value function, monotone in lightness, light to dark."""
SeriesStyle = tuple[str, str, str]
POLICY_STYLES = {
    "informed": (SERIES[0], "o", "informed (ours)"),
    "faithful": (SERIES[1], "s", "faithful (the paper's method)"),
    "frontier": (SERIES[2], "^", "nearest frontier, no language"),
    "lawnmower": (SERIES[3], "v", "lawnmower, no language"),
    "arc": (SERIES[4], "<", "sweep that knows the worlds' law"),
    "known": (MUTED, "", "known map"),
}
"""Colour, marker and name of each policy."""
_BOLD_WIDTH, _PLAIN_WIDTH = 0.69, 0.6
"""Upper estimates of a character's mean width over the font size."""


class MissingExtraError(ValueError):
    """An optional dependency is not installed or does not work; the message is one line."""


def require(module: str, *, extra: str = "viz") -> Any:
    """Import an optional module, or raise ``MissingExtraError``, which says what to install."""
    if importlib.util.find_spec(module) is None:
        raise MissingExtraError(
            f"{module} is not installed: pip install 'jaxlangnav[{extra}]' brings it"
        )
    return importlib.import_module(module)


def type_color(object_type: int) -> str:
    """Return the colour of an object type, cycling after eight types."""
    is_typed = object_type >= 0 and not is_anything(object_type)
    return TYPE_COLORS[object_type % len(TYPE_COLORS)] if is_typed else MUTED


def type_marker(object_type: int) -> str:
    """Return the marker of an object type; the first 64 types differ in marker or colour."""
    if is_anything(object_type):
        return "*"
    cycle = object_type // len(TYPE_COLORS)
    return TYPE_MARKERS[(object_type + cycle) % len(TYPE_MARKERS)] if object_type >= 0 else "x"


def policy_styles(names: Sequence[str]) -> dict[str, SeriesStyle]:
    """Map each series to colour, marker and label; unknown policies take the next of the cycle."""
    defaults = zip(itertools.cycle(SERIES), itertools.cycle("os^vDPXh"), names, strict=False)
    return {key: POLICY_STYLES.get(key, (color, marker, key)) for color, marker, key in defaults}


def add_legend(figure: "Figure", panels: "Iterable[Axes]", *, columns: int = 3) -> None:
    """Add one legend of several panels along the bottom of a figure, each label once."""
    handles: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(list(handles.values()), list(handles), loc="lower center", ncols=columns)


def panels(
    size: tuple[float, float],
    rows: int,
    columns: int,
    margins: tuple[float, float, float, float],
    **options: Any,
) -> "tuple[Figure, np.ndarray]":
    """Create a figure, inches, with axes [rows, columns]; ``options``: of ``Figure.subplots``.

    ``margins``: at the left, at the right, above and below, inches; ``wspace`` and ``hspace`` may
    be among ``options``.
    """
    from matplotlib.figure import Figure

    (width, height), (left, right, head, foot) = size, margins
    where = {name: options.pop(name) for name in ("wspace", "hspace") if name in options}
    where |= {"left": left / width, "right": 1 - right / width}
    where |= {"top": 1 - head / height, "bottom": foot / height}
    figure = Figure(figsize=size)
    return figure, figure.subplots(rows, columns, squeeze=False, gridspec_kw=where, **options)


def rgb_image(figure: "Figure") -> np.ndarray:
    """Render a figure as an RGB image, u8[H, W, 3]."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def value_colormap() -> "LinearSegmentedColormap":
    """Build the colormap of the value function."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("jaxlangnav-value", VALUE_STOPS)


def rc() -> dict[str, Any]:
    """Build the matplotlib rcParams of the plot style."""
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
        # A dollar sign in a sentence or file name is not TeX.
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
    """Apply the plot style within the block; outside, rcParams are unchanged."""
    with require("matplotlib").rc_context(rc()):
        yield


def title(figure: "Figure", text: str, subtitle: str = "") -> None:
    """Set a figure's title in bold at the upper left, and a subtitle below.

    Long titles are set smaller, and truncated where that does not suffice. The figure's layout must
    leave half an inch at the top.
    """
    text = sanitize(text)
    width, height = figure.get_figwidth(), figure.get_figheight()
    left = 0.12 / width
    text, size = _fit_text(text, width - 0.3, 12.0, 8.0, _BOLD_WIDTH)
    figure.text(left, 1 - 0.10 / height, text, va="top", fontsize=size, fontweight="bold")
    if subtitle:
        longest = max(subtitle.split("\n"), key=len)
        _, size = _fit_text(longest, width - 0.3, 8.5, 6.5, _PLAIN_WIDTH)
        figure.text(left, 1 - 0.36 / height, subtitle, va="top", fontsize=size, color=MUTED)


def _fit_text(text: str, width: float, high: float, low: float, em: float) -> tuple[str, float]:
    """Fit a line into a width, inches, by font size in points; truncate it at the smallest size."""
    size = min(high, width * 72 / (em * max(1, len(text))))
    if size >= low:
        return text, size
    return text[: int(width * 72 / (em * low)) - 1].rstrip() + "…", low


def save(figure: "Figure", stem: Path | str) -> tuple[Path, Path]:
    """Write a figure as PNG and SVG atomically; folders are made, ``stem`` has no extension."""
    stem = Path(stem)
    paths = (stem.with_name(stem.name + ".png"), stem.with_name(stem.name + ".svg"))
    with house_style():
        for path in paths:
            extension = path.suffix[1:]
            metadata = {"Date": None} if extension == "svg" else {}
            with replacing(path) as temporary:
                figure.savefig(temporary, format=extension, metadata=metadata)
    return paths
