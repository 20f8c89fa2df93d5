"""The one kind of table: headings and cells of text, told in the terminal, Markdown or HTML."""

import base64
import dataclasses
import html
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxlangnav.inputs import sanitize
from jaxlangnav.inputs.whole_files import write_text

if TYPE_CHECKING:
    import rich.table

Document = Mapping[str, Any]  # what a command or an experiment found, in JSON's own types
Row = dict[str, Any]  # a row of a table of results, by the names of its figures
TableColumns = Sequence[tuple[str, str | Callable[[Any], str]]]
"""Headings of a table, each with what writes its cells; see ``Table.of``."""
SUCCESS = "{success_rate:.1f} ({success_ci[0]:.1f}-{success_ci[1]:.1f})"
"""Writes the success of a row with its 95 % interval, percent."""
_NUMBER = re.compile(r"[≤≥<>+−-]? ?\d[\d.,]*([\s%*e-]|$)")
_MEDIA = {".svg": "image/svg+xml", ".png": "image/png"}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Table:
    """Texts in rows and columns; columns that hold numbers only are aligned at the right."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    caption: str = ""
    group: int = 0
    """Leading columns by which rows are of one block. Only its first row shows what they hold, but
    for Markdown, in which a row is read alone."""
    faint: Sequence[bool] = ()
    """Which rows the terminal draws dim; none by default. So are columns of the paper's."""
    fold: str = ""  # what to click on a page to see it; it is open where empty
    screen: "Table | None" = None
    """What a terminal, which has less room, draws in its place: other headings and cells."""

    @classmethod
    def of(cls, rows: Iterable[Mapping[str, Any]], columns: "TableColumns", **rest: Any) -> "Table":
        """Lay out records, a line each.

        ``columns``: heading of each, and what writes its cell: a format such as
        "{distance_mean:.2f}", or a function of the record. ``rest``: the table's other fields.
        """
        cells = [
            [one.format_map(row) if isinstance(one, str) else one(row) for _, one in columns]
            for row in rows
        ]
        return cls(headings=[heading for heading, _ in columns], rows=cells, **rest)

    def markdown(self) -> str:
        """Write the table in Markdown, without title and caption: lines, each ended."""
        return sanitize.markdown_table(self.headings, self.rows)

    def text(self) -> "rich.table.Table":
        """Draw the table for the terminal."""
        from rich.table import Table as Drawn

        if small := self.screen:
            cells = {"headings": small.headings, "rows": small.rows}
            return dataclasses.replace(self, screen=None, **cells).text()
        told: dict[str, Any] = {"title": self.title or None, "caption": self.caption or None}
        drawn = Drawn(**told, caption_justify="left")
        for place, heading in enumerate(self.headings):
            justify = "right" if self._is_numeric(place) else "left"
            style = "dim" if heading.startswith("paper") else None
            drawn.add_column(heading, justify=justify, style=style, no_wrap=justify == "right")
        for place, (is_first, row) in enumerate(self._blocks()):
            if place and is_first:
                drawn.add_section()
            drawn.add_row(*row, style="dim" if self.faint and self.faint[place] else None)
        return drawn

    def html(self) -> str:
        """Write the table for a page; columns that are empty are left out."""
        places = range(len(self.headings))
        used = [place for place in places if any(row[place] for row in self.rows)]
        align = {place: " class=number" if self._is_numeric(place) else "" for place in used}
        head = "".join(f"<th{align[at]}>{_html_text(self.headings[at])}</th>" for at in used)
        lines = []
        for is_first, row in self._blocks():
            cells = "".join(f"<td{align[at]}>{_html_text(row[at])}</td>" for at in used)
            lines.append(f"<tr{' class=first' if is_first else ''}>{cells}</tr>")
        body = "\n".join(lines)
        whole = f"<table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table>"
        whole = f'<div class="wide">{whole}</div>'
        folded = f"<details><summary>{_html_text(self.fold)}</summary>{whole}</details>"
        return folded if self.fold else whole

    def _is_numeric(self, place: int) -> bool:
        return all(_NUMBER.match(row[place]) for row in self.rows if row[place])

    def _blocks(self) -> Iterator[tuple[bool, list[str]]]:
        """Tell which rows begin a block, and blank what the others share with it."""
        above: list[str] = []
        for row in self.rows:
            head, is_first = list(row[: self.group]), above != list(row[: self.group])
            yield is_first, [*(head if is_first else [""] * self.group), *row[self.group :]]
            above = head


def _html_text(value: object) -> str:
    """Write plain text inside HTML; line breaks stay."""
    return html.escape(sanitize.sanitize(str(value), keep="\n"), quote=True)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Report:
    """How an experiment is told, from its document: heading, tables, and notes beneath."""

    title: str
    lead: str = ""  # what it is and what to see in it, for people
    tables: Callable[[Document], list[Table]] = lambda _: []
    notes: Callable[[Document], list[str]] = lambda _: []

    def markdown(self, document: Document) -> str:
        """Write heading, tables and notes in Markdown."""
        tables = "\n".join(one.markdown() for one in self.tables(document))
        return f"# {self.title}\n\n{tables}\n" + "\n".join(self.notes(document)) + "\n"

    def render(self, document: Document) -> "rich.table.Table":
        """Draw the first table and the notes for the terminal."""
        notes = "\n".join(self.notes(document))
        first = self.tables(document)[0]
        return dataclasses.replace(first, title=self.title, caption=notes).text()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Section:
    """A part of the page: an experiment or a figure."""

    title: str
    lead: str = ""  # what it is, and what to see in it
    pictures: Sequence[tuple[Path, str]] = ()
    """SVG or PNG files, each with the words for those who cannot see it."""
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    made: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """How it was made: command, episodes, seconds, files."""


def _render_report(title: str, sections: Sequence[Section], *, made: Mapping[str, str]) -> str:
    numbered = list(enumerate(sections, start=1))
    links = [f'<a href="#part{index}">{_html_text(part.title)}</a>' for index, part in numbered]
    page = resources.files("jaxlangnav.experiments") / "report.html"
    places = {
        "__TITLE__": _html_text(title),
        "__MADE__": _facts(made),
        "__CONTENTS__": "\n".join(f"<li>{one}</li>" for one in links),
        "__PARTS__": "\n".join(_section(*one) for one in numbered),
    }
    # In one pass: a value may hold the name of another place.
    filled = page.read_text(encoding="utf-8")
    return re.sub("|".join(places), lambda found: places[found[0]], filled)


def write_report(
    title: str, sections: Sequence[Section], path: Path, *, made: Mapping[str, str]
) -> Path:
    """Write the page into a file, all or nothing; ``made`` says how. Pictures are SVG or PNG."""
    return write_text(_render_report(title, sections, made=made), path)


def _section(index: int, part: Section) -> str:
    pieces = [f'<section id="part{index}">', f"<h2>{_html_text(part.title)}</h2>"]
    pieces += [f"<p>{_html_text(part.lead)}</p>"] if part.lead else []
    for path, words in part.pictures:
        if path.suffix not in _MEDIA:
            raise ValueError(f"{path} is no picture: a report takes {' and '.join(_MEDIA)} files")
        data = f"{_MEDIA[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode()}"
        pieces.append(f'<figure><img src="data:{data}" alt="{_html_text(words)}"></figure>')
    pieces += [table.html() for table in part.tables]
    if part.notes:
        notes = "".join(f"<li>{_html_text(note)}</li>" for note in part.notes)
        pieces.append(f'<ul class="notes">{notes}</ul>')
    if part.made:
        head = "<summary>How this was made</summary>"
        pieces.append(f"<details open>{head}{_facts(part.made)}</details>")
    return "\n".join([*pieces, "</section>"])


def _facts(made: Mapping[str, str]) -> str:
    """Write how something was made as a list of terms."""
    rows = "".join(
        f"<dt>{_html_text(name)}</dt><dd>{_html_text(value)}</dd>"
        for name, value in made.items()
        if value
    )
    return f"<dl>{rows}</dl>"
