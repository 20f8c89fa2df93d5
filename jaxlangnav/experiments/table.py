"""The one kind of table: headings and cells of text, told in the terminal, Markdown or HTML."""

import dataclasses
import html
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from jaxlangnav import plain_text

if TYPE_CHECKING:
    import rich.table

Document = Mapping[str, Any]
"""What a command or an experiment found, in JSON's own types."""
_NUMBER = re.compile(r"[≤≥<>+−-]? ?\d[\d.,]*([\s%*e-]|$)")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Table:
    """Texts in rows and columns; columns that hold numbers only are aligned at the right."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    caption: str = ""
    firsts: Sequence[bool] = ()
    """Which rows begin a block; none by default. The others do not repeat what they share with the
    row above in the leading columns, but for Markdown, in which a row is read alone."""
    faint: Sequence[bool] = ()
    """Which rows the terminal draws dim; none by default. So are columns of the paper's."""
    fold: str = ""
    """What to click on a page to see it; it is open where empty."""

    def markdown(self, *, is_marked: bool = False) -> str:
        """Write the table in Markdown, without title and caption.

        Args:
            is_marked: whether the cells are Markdown already.

        Returns:
            Lines, each ended.
        """
        if not is_marked:
            return plain_text.markdown_table(self.headings, self.rows)
        lines = [self.headings, ["---"] * len(self.headings), *self.rows]
        return "".join(f"| {' | '.join(line)} |\n" for line in lines)

    def text(self) -> "rich.table.Table":
        """Draw the table for the terminal."""
        from rich.table import Table as Drawn

        drawn = Drawn(title=self.title or None, caption=self.caption or None,
                      caption_justify="left")  # fmt: skip
        for place, heading in enumerate(self.headings):
            justify = "right" if self._is_numeric(place) else "left"
            style = "dim" if heading.startswith("paper") else None
            drawn.add_column(heading, justify=justify, style=style, no_wrap=justify == "right")
        for place, row in enumerate(self._blocks()):
            if place and self.firsts and self.firsts[place]:
                drawn.add_section()
            drawn.add_row(*row, style="dim" if self.faint and self.faint[place] else None)
        return drawn

    def html(self) -> str:
        """Write the table for a page; columns that are empty are left out."""
        places = range(len(self.headings))
        used = [place for place in places if any(row[place] for row in self.rows)]
        align = {place: " class=number" if self._is_numeric(place) else "" for place in used}
        head = "".join(f"<th{align[at]}>{html_text(self.headings[at])}</th>" for at in used)
        lines = []
        for place, row in enumerate(self._blocks()):
            cells = "".join(f"<td{align[at]}>{html_text(row[at])}</td>" for at in used)
            is_first = bool(self.firsts) and self.firsts[place]
            lines.append(f"<tr{' class=first' if is_first else ''}>{cells}</tr>")
        body = "\n".join(lines)
        whole = f"<table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table>"
        whole = f'<div class="wide">{whole}</div>'
        folded = f"<details><summary>{html_text(self.fold)}</summary>{whole}</details>"
        return folded if self.fold else whole

    def _is_numeric(self, place: int) -> bool:
        """Tell whether all that a column holds are numbers."""
        return all(_NUMBER.match(row[place]) for row in self.rows if row[place])

    def _blocks(self) -> list[list[str]]:
        """Blank the leading cells that a row has in common with the one above in its block."""
        told, above = [], [""] * len(self.headings)
        for place, row in enumerate(self.rows):
            same = 0
            if self.firsts and not self.firsts[place]:
                pairs = zip(above, row, strict=True)
                same = next((at for at, (one, two) in enumerate(pairs) if one != two), len(row))
            told.append([*[""] * same, *row[same:]])
            above = list(row)
        return told


def html_text(value: object) -> str:
    """Write plain text inside HTML; line breaks stay."""
    return html.escape(plain_text.printable(str(value), keep="\n"), quote=True)
