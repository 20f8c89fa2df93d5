"""Text tables and reports, rendered in the terminal, Markdown or HTML."""

import base64
import dataclasses
import html
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxlangnav.inputs import sanitize

if TYPE_CHECKING:
    import rich.table

Document = Mapping[str, Any]  # results of a command or an experiment, in JSON types
Row = dict[str, Any]  # a row of results, by column
TableColumns = Sequence[tuple[str, str | Callable[[Any], str]]]
"""Headings of a table, each with its cells' format; see ``Table.of``."""
SUCCESS_FORMAT = "{success_rate:.1f} ({success_ci[0]:.1f}-{success_ci[1]:.1f})"
"""Format of a row's success with its 95 % interval, percent."""
_NUMBER = re.compile(r"[≤≥<>+−-]? ?\d[\d.,]*([\s%*e-]|$)")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Table:
    """A table of text cells; numeric columns are right-aligned."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    caption: str = ""
    group: int = 0
    """Number of leading columns that define a block of rows. Only a block's first row shows them,
    except in Markdown."""
    dim: Sequence[bool] = ()
    """Rows that the terminal draws dim, as it does the paper's columns; none by default."""
    collapsed_title: str = ""  # HTML: summary of the collapsed table; not collapsed if empty
    narrow: "Table | None" = None
    """Narrower table that a terminal draws in its place."""

    @classmethod
    def of(cls, rows: Iterable[Mapping[str, Any]], columns: TableColumns, **kwargs: Any) -> "Table":
        """Build a table from records, a line each.

        ``columns``: headings, each with a format such as "{distance_mean:.2f}" or a function from
        the record to the cell. ``kwargs``: the table's other fields.
        """
        cells = [
            [spec.format_map(row) if isinstance(spec, str) else spec(row) for _, spec in columns]
            for row in rows
        ]
        return cls(headings=[heading for heading, _ in columns], rows=cells, **kwargs)

    def markdown(self) -> str:
        """Format the table in Markdown, without title and caption; newline-terminated."""
        return sanitize.markdown_table(self.headings, self.rows)

    def text(self) -> "rich.table.Table":
        """Render the table for the terminal."""
        from rich.table import Table as RichTable

        if narrow := self.narrow:
            content = {"headings": narrow.headings, "rows": narrow.rows}
            return dataclasses.replace(self, narrow=None, **content).text()
        texts: dict[str, Any] = {"title": self.title or None, "caption": self.caption or None}
        table = RichTable(**texts, caption_justify="left")
        for i, heading in enumerate(self.headings):
            justify = "right" if self._is_numeric(i) else "left"
            style = "dim" if heading.startswith("paper") else None
            table.add_column(heading, justify=justify, style=style, no_wrap=justify == "right")
        for i, (is_first, row) in enumerate(self._blanked_rows()):
            if i and is_first:
                table.add_section()
            table.add_row(*row, style="dim" if self.dim and self.dim[i] else None)
        return table

    def html(self) -> str:
        """Format the table in HTML, without empty columns."""
        used = [i for i in range(len(self.headings)) if any(row[i] for row in self.rows)]
        align = {i: " class=number" if self._is_numeric(i) else "" for i in used}
        header = "".join(f"<th{align[i]}>{_html_text(self.headings[i])}</th>" for i in used)
        lines = []
        for is_first, row in self._blanked_rows():
            cells = "".join(f"<td{align[i]}>{_html_text(row[i])}</td>" for i in used)
            lines.append(f"<tr{' class=first' if is_first else ''}>{cells}</tr>")
        body = "\n".join(lines)
        table = f"<table><thead><tr>{header}</tr></thead>\n<tbody>{body}</tbody></table>"
        table = f'<div class="wide">{table}</div>'
        details = f"<details><summary>{_html_text(self.collapsed_title)}</summary>{table}</details>"
        return details if self.collapsed_title else table

    def _is_numeric(self, column: int) -> bool:
        return all(_NUMBER.match(row[column]) for row in self.rows if row[column])

    def _blanked_rows(self) -> Iterator[tuple[bool, list[str]]]:
        """Yield whether each row begins a block, and the row with repeated labels blank."""
        previous: list[str] = []
        for row in self.rows:
            labels, is_first = list(row[: self.group]), previous != list(row[: self.group])
            yield is_first, [*(labels if is_first else [""] * self.group), *row[self.group :]]
            previous = labels


def _html_text(value: object) -> str:
    """Escape plain text for HTML; line breaks are kept."""
    return html.escape(sanitize.sanitize(str(value), keep="\n"), quote=True)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Report:
    """Report of an experiment, built from its document: title, tables and notes."""

    title: str
    intro: str = ""  # introduction for readers
    tables: Callable[[Document], list[Table]] = lambda _: []
    notes: Callable[[Document], list[str]] = lambda _: []

    def markdown(self, document: Document) -> str:
        """Format title, tables and notes in Markdown."""
        tables = "\n".join(table.markdown() for table in self.tables(document))
        return f"# {self.title}\n\n{tables}\n" + "\n".join(self.notes(document)) + "\n"

    def render(self, document: Document) -> "rich.table.Table":
        """Render the first table and the notes for the terminal."""
        notes = "\n".join(self.notes(document))
        return dataclasses.replace(self.tables(document)[0], title=self.title, caption=notes).text()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Section:
    """A section of the HTML report: an experiment or a figure."""

    title: str
    intro: str = ""  # introduction for readers
    pictures: Sequence[tuple[Path, str]] = ()
    """SVG files, each with its alternative text."""
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    facts: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Provenance: command, episodes, seconds, files."""


def report_html(title: str, sections: Sequence[Section], *, facts: Mapping[str, str]) -> str:
    """Format a report in HTML; ``facts``: its provenance."""
    numbered = list(enumerate(sections, start=1))
    links = [f'<a href="#part{i}">{_html_text(section.title)}</a>' for i, section in numbered]
    template = resources.files("jaxlangnav.experiments") / "report.html"
    fields = {
        "__TITLE__": _html_text(title),
        "__MADE__": _definition_list(facts),
        "__CONTENTS__": "\n".join(f"<li>{link}</li>" for link in links),
        "__PARTS__": "\n".join(_section(*link) for link in numbered),
    }
    # In one pass, since a value may contain another placeholder.
    filled = template.read_text(encoding="utf-8")
    return re.sub("|".join(fields), lambda match: fields[match[0]], filled)


def _section(index: int, section: Section) -> str:
    parts = [f'<section id="part{index}">', f"<h2>{_html_text(section.title)}</h2>"]
    parts += [f"<p>{_html_text(section.intro)}</p>"] if section.intro else []
    for path, alt in section.pictures:
        data = f"image/svg+xml;base64,{base64.b64encode(path.read_bytes()).decode()}"
        parts.append(f'<figure><img src="data:{data}" alt="{_html_text(alt)}"></figure>')
    parts += [table.html() for table in section.tables]
    if section.notes:
        notes = "".join(f"<li>{_html_text(note)}</li>" for note in section.notes)
        parts.append(f'<ul class="notes">{notes}</ul>')
    if section.facts:
        head = "<summary>How this was made</summary>"
        parts.append(f"<details open>{head}{_definition_list(section.facts)}</details>")
    return "\n".join([*parts, "</section>"])


def _definition_list(entries: Mapping[str, str]) -> str:
    rows = "".join(
        f"<dt>{_html_text(name)}</dt><dd>{_html_text(value)}</dd>"
        for name, value in entries.items()
        if value
    )
    return f"<dl>{rows}</dl>"
