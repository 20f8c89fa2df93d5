"""What the experiments behind ``jaxlangnav reproduce`` share: settings, and one record each."""

import dataclasses
import importlib.util
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxlangnav.cli.output import Document, Output
from jaxlangnav.cli.settings import SettingPath
from jaxlangnav.experiments.table import Section, Table
from jaxlangnav.navigator import NavigatorParams

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """What is run, and where it is written."""

    episodes: int
    policies: tuple[str, ...]
    seed: int
    seed_unknowns: int
    """Of the study of the paper's unknowns."""
    extra: bool
    """Whether Table 2 has rows that the paper lacks."""
    ranges: tuple[float, ...]
    """Metres, in place of those of Table 2's rows and of Figure 5; none for their own."""
    particles: int
    particles_drawn: int
    """P of the episodes that are drawn."""
    params: NavigatorParams
    values: Mapping[SettingPath, Any]
    """Numbers of engine, detector and motion that are not the defaults."""
    out: Path | None
    command: Callable[[str], str]
    """Writes the command that runs an experiment again."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study:
    """An experiment of ``reproduce``: how it is run, and what stands of it in the report."""

    title: str
    lead: str
    """What it is, and what to see in it."""
    run: Callable[[Settings, Output], dict[str, Any]]
    """Runs it and tells it; the document has ``wall_s`` and the ``files`` that are written."""
    tables: Callable[[Document], list[Table]] = lambda _: []
    notes: Callable[[Document], list[str]] = lambda _: []
    figures: "Callable[[Document], Mapping[str, Callable[[], Figure]]]" = lambda _: {}
    """What draws its figures, by the name of their files."""
    made: Callable[[Document], Mapping[str, str]] = lambda _: {}
    """What else there is to say of how it was made."""

    def section(self, name: str, document: Document, settings: Settings) -> Section:
        """Put what was found into the report; SVG pictures are shown, sharp at any size."""
        wall, files = document["wall_s"], [Path(path) for path in document["files"]]
        took = f"{wall:.{0 if wall > 10 else 1}f} s"
        if "compile_s" in document:
            took += f", {document['compile_s']:.0f} s of them compilation"
        return Section(
            title=self.title,
            lead=self.lead,
            pictures=[(path, f"{self.title}: figure") for path in files if path.suffix == ".svg"],
            tables=self.tables(document),
            notes=self.notes(document),
            made={
                "command": settings.command(name),
                **self.made(document),
                "wall time": took,
                "files": ", ".join(path.name for path in files),
            },
        )


def draw_figures(
    out: Path | None, output: Output, figures: "Mapping[str, Callable[[], Figure]]"
) -> list[str]:
    """Draw figures into a folder, if there is one, and say so where nothing draws them.

    Args:
        out: the folder; nothing is drawn if None.
        output: told where there is no matplotlib.
        figures: by the name of their files, what draws them.

    Returns:
        The paths of the files.
    """
    if out is None or not figures:
        return []
    if importlib.util.find_spec("matplotlib") is None:
        output.note('note: no figure without matplotlib: pip install "jaxlangnav[viz]"')
        return []
    from jaxlangnav.viz.style import save

    return [str(path) for name, draw in figures.items() for path in save(draw(), out / name)]
