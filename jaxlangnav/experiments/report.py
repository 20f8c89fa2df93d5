"""One page that shows tables and figures beside the paper's numbers and says how they were made.

The page is a single file: pictures stand in it as data, nothing is fetched from anywhere, so it
opens offline and can be sent around. What is in the pictures is up to the caller.
"""

import base64
import dataclasses
import re
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path

from jaxlangnav.experiments.table import Table, html_text
from jaxlangnav.files.whole import write_text

_MEDIA = {".svg": "image/svg+xml", ".png": "image/png"}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Section:
    """A part of the page: an experiment or a figure."""

    title: str
    lead: str = ""
    """What it is, and what to see in it."""
    pictures: Sequence[tuple[Path, str]] = ()
    """SVG or PNG files, each with the words for those who cannot see it."""
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    made: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """How it was made: command, episodes, seconds, files."""


def render_report(title: str, sections: Sequence[Section], *, made: Mapping[str, str]) -> str:
    """Write the page.

    Args:
        title: of the page.
        sections: its parts, in order.
        made: how all of it was made: command, seed, versions, machine, wall time.

    Returns:
        HTML.

    Raises:
        ValueError: a picture is neither SVG nor PNG.
    """
    contents = "\n".join(
        f'<li><a href="#part{index}">{html_text(part.title)}</a></li>'
        for index, part in enumerate(sections, start=1)
    )
    parts = "\n".join(_section(index, part) for index, part in enumerate(sections, start=1))
    page = resources.files("jaxlangnav.experiments") / "report.html"
    places = {
        "__TITLE__": html_text(title),
        "__MADE__": _facts(made),
        "__CONTENTS__": contents,
        "__PARTS__": parts,
    }
    # In one pass: a value may hold the name of another place.
    filled = page.read_text(encoding="utf-8")
    return re.sub("|".join(places), lambda found: places[found[0]], filled)


def write_report(
    title: str, sections: Sequence[Section], path: Path, *, made: Mapping[str, str]
) -> Path:
    """Write the page into a file, all or nothing.

    Args:
        title: of the page.
        sections: its parts, in order.
        path: of the file; its folder is made.
        made: how all of it was made.

    Returns:
        The path.

    Raises:
        ValueError: a picture is neither SVG nor PNG.
    """
    return write_text(render_report(title, sections, made=made), path)


def data_uri(path: Path) -> str:
    """Put a picture into a text.

    Args:
        path: an SVG or PNG file.

    Returns:
        A data URI in base64. Each picture stays a document of its own, so that names inside two
        SVG files cannot clash.

    Raises:
        ValueError: neither SVG nor PNG.
    """
    if path.suffix not in _MEDIA:
        raise ValueError(f"{path} is no picture: a report takes {' and '.join(_MEDIA)} files")
    return f"data:{_MEDIA[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode()}"


def _section(index: int, part: Section) -> str:
    """Write one part of the page."""
    pieces = [f'<section id="part{index}">', f"<h2>{html_text(part.title)}</h2>"]
    pieces += [f"<p>{html_text(part.lead)}</p>"] if part.lead else []
    pieces += [
        f'<figure><img src="{data_uri(path)}" alt="{html_text(words)}"></figure>'
        for path, words in part.pictures
    ]
    pieces += [table.html() for table in part.tables]
    if part.notes:
        notes = "".join(f"<li>{html_text(note)}</li>" for note in part.notes)
        pieces.append(f'<ul class="notes">{notes}</ul>')
    if part.made:
        pieces.append(
            f"<details open><summary>How this was made</summary>{_facts(part.made)}</details>"
        )
    return "\n".join([*pieces, "</section>"])


def _facts(made: Mapping[str, str]) -> str:
    """Write how something was made as a list of terms."""
    rows = "".join(
        f"<dt>{html_text(name)}</dt><dd>{html_text(value)}</dd>"
        for name, value in made.items()
        if value
    )
    return f"<dl>{rows}</dl>"
