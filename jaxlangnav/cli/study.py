"""What the experiments behind ``jaxlangnav reproduce`` share: settings, and what they hand back."""

import dataclasses
import importlib.util
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxlangnav.cli.output import Output
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
    """An experiment that has been run: what ``reproduce`` makes of settings and an output."""

    document: dict[str, Any]
    section: Section


def told(
    name: str,
    document: dict[str, Any],
    settings: Settings,
    *,
    title: str,
    lead: str,
    pictures: Sequence[tuple[Path, str]] = (),
    tables: Sequence[Table] = (),
    notes: Sequence[str] = (),
    made: Mapping[str, str] | None = None,
) -> Study:
    """Put what an experiment found into its part of the report.

    Args:
        name: on the command line.
        document: what was found, with ``wall_s`` and perhaps ``compile_s`` and ``files``.
        settings: what was run.
        title: of the part.
        lead: what it is, and what to see in it.
        pictures: files, each with the words for those who cannot see it; SVG ones are shown, sharp
            at any size.
        tables: beneath them.
        notes: beneath those.
        made: what else there is to say of how it was made.

    Returns:
        The study.
    """
    took = f"{document['wall_s']:.{0 if document['wall_s'] > 10 else 1}f} s"
    if "compile_s" in document:
        took += f", {document['compile_s']:.0f} s of them compilation"
    section = Section(
        title=title,
        lead=lead,
        pictures=[(path, words) for path, words in pictures if path.suffix == ".svg"],
        tables=tables,
        notes=notes,
        made={
            "command": settings.command(name),
            **(made or {}),
            "wall time": took,
            "files": ", ".join(Path(path).name for path in document.get("files", ())),
        },
    )
    return Study(document=document, section=section)


def draw_figures(
    out: Path | None, output: Output, figures: "Mapping[str, Callable[[], Figure]]"
) -> list[Path]:
    """Draw figures, where there is a folder and something to draw with.

    Args:
        out: the folder; nothing is drawn if None.
        output: told where there is no matplotlib.
        figures: by the name of their files, what draws them.

    Returns:
        The files.
    """
    if out is None:
        return []
    if importlib.util.find_spec("matplotlib") is None:
        output.note('note: no figure without matplotlib: pip install "jaxlangnav[viz]"')
        return []
    from jaxlangnav.viz.style import save

    return [path for name, figure in figures.items() for path in save(figure(), out / name)]
