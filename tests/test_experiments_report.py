"""The page of results: one file, nothing from outside, everything escaped."""

import base64
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from jaxlangnav.experiments.report import Section, data_uri, render_report, write_report
from jaxlangnav.experiments.table import Table

SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="3" height="2"></svg>'


class Page(HTMLParser):
    """Collects what the page refers to, its cells and its text."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.ids: list[str] = []
        self.cells: list[str] = []
        self.text = ""
        self._is_cell = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = dict(attrs)
        self.links += [value for key in ("src", "href") if (value := names.get(key))]
        self.ids += [value for key in ("id",) if (value := names.get(key))]
        self._is_cell = tag in ("td", "th")
        if self._is_cell:
            self.cells.append("")

    def handle_endtag(self, tag: str) -> None:
        self._is_cell = False

    def handle_data(self, data: str) -> None:
        self.text += data
        if self._is_cell:
            self.cells[-1] += data


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    path = tmp_path / "figure.svg"
    path.write_text(SVG, "utf-8")
    return path


def read(*sections: Section, title: str = "Ours & theirs", **made: str) -> Page:
    page = Page()
    page.feed(render_report(title, sections, made=made))
    return page


def test_pictures_stand_in_the_page_and_nothing_is_fetched(picture: Path) -> None:
    page = read(
        Section(title="One", pictures=[(picture, "a figure")]),
        Section(title="Two", pictures=[(picture, 'a "second" figure')]),
        seed="7",
    )
    outside = [link for link in page.links if not link.startswith(("#", "data:"))]
    assert outside == []
    assert [link for link in page.links if link.startswith("#")] == ["#part1", "#part2"]
    assert {"part1", "part2"} <= set(page.ids)
    images = [link for link in page.links if link.startswith("data:image/svg+xml;base64,")]
    assert len(images) == 2
    assert base64.b64decode(images[0].split(",")[1]).decode() == SVG
    text = render_report("x", [Section(title="One", pictures=[(picture, "a")])], made={})
    assert not re.search(r"https?://|@import|url\(|<script", text)


def test_tables_and_how_they_were_made(picture: Path) -> None:
    table = Table(
        headings=["World", "paper"],
        rows=[["1H1C", "93.9"], ["2H<1C", "54.4"]],
        firsts=[True, False],
    )
    made = {"command": "jaxlangnav reproduce table2", "nothing": ""}
    page = read(Section(title="T", lead="words", tables=[table], notes=["noise 2 %"], made=made))
    assert page.cells == ["World", "paper", "1H1C", "93.9", "2H<1C", "54.4"]
    for part in ("words", "noise 2 %", "jaxlangnav reproduce table2"):
        assert part in page.text
    # A term without a value is not listed.
    assert "nothing" not in page.text


def test_blocks_say_once_what_they_share_and_empty_columns_go() -> None:
    rows = [["1H1C", "3", "informed", ""], ["1H1C", "3", "known", ""], ["2H1C", "3", "known", ""]]
    headings = ["World", "m", "Policy", "ECE"]
    page = read(Section(title="T", tables=[Table(headings=headings, rows=rows, firsts=[1, 0, 1])]))
    told = [page.cells[at : at + 3] for at in range(0, 12, 3)]
    assert told == [headings[:3], rows[0][:3], ["", "", "known"], rows[2][:3]]
    plain = read(Section(title="T", tables=[Table(headings=headings, rows=rows, fold="More")]))
    assert plain.cells[6:9] == rows[1][:3]
    assert "More" in plain.text


def test_what_is_written_cannot_break_the_page(tmp_path: Path) -> None:
    evil = '</title><script>alert("x")</script>'
    page = render_report(evil, [Section(title=evil, lead=evil, notes=[evil])], made={"a": evil})
    assert "<script" not in page
    path = write_report("t", [], tmp_path / "new" / "report.html", made={})
    assert path.read_text("utf-8").startswith("<!doctype html>")


def test_only_pictures_are_taken(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="is no picture"):
        data_uri(tmp_path / "figure.pdf")


def test_text_that_names_a_place_of_the_page_stays_text() -> None:
    part = Section(title="__MADE__ <i>", lead="__CONTENTS__ \x1b[2J", notes=["__PARTS__"])
    text = render_report("__PARTS__ <b>", [part], made={"command": "__TITLE__ \u202e"})
    page = Page()
    page.feed(text)
    assert text.count("<section") == 1
    assert "__PARTS__ <b>" in page.text
    assert "__MADE__ <i>" in page.text
    assert "<b>" not in text
    assert "\x1b" not in text
    assert "\u202e" not in text
