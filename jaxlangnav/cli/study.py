"""What the experiments behind ``jaxlangnav reproduce`` share: settings, and one record each."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxlangnav.cli.output import Document, Output
from jaxlangnav.cli.settings import SettingPath
from jaxlangnav.experiments.experiment import Options
from jaxlangnav.experiments.table import Section, Table
from jaxlangnav.navigator import NavigatorParams

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """What is run, and where it is written."""

    options: Options
    """Of the experiments made of episodes; the sensing range is a matter of each row."""
    params: NavigatorParams
    seed_unknowns: int
    """Of the study of the paper's unknowns."""
    extra: bool
    """Whether Table 2 has rows that the paper lacks."""
    ranges: tuple[float, ...]
    """Metres, in place of those of Table 2's rows and of Figure 5; none for their own."""
    particles_drawn: int
    """P of the episodes that are drawn."""
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
