"""The one kind of table: the same cells in the terminal, in Markdown and on a page."""

import io

from rich.console import Console

from jaxlangnav.experiments.table import Table

TABLE = Table(
    title="Robots",
    headings=["World", "Policy", "Success %", "paper", "empty"],
    rows=[
        ["1H1C", "ours", "93.9 (90-97)", "93.9", ""],
        ["1H1C", "limit", "≤ 100", "", ""],
        ["2H|1C", "ours", "4", "", ""],
    ],
    firsts=[True, False, True],
    faint=[False, True, False],
)


def drawn(table: Table) -> str:
    console = Console(width=90, record=True, file=io.StringIO(), markup=False)
    console.print(table.text())
    return console.export_text()


def test_a_block_says_once_what_it_shares() -> None:
    text = drawn(TABLE)
    assert "Robots" in text
    assert text.count("1H1C") == 1
    assert TABLE.html().count("<td>1H1C</td>") == 1
    assert TABLE.html().count("class=first") == 2
    # In Markdown a row is read alone.
    assert TABLE.markdown().count("1H1C") == 2
    alone = Table(headings=TABLE.headings, rows=TABLE.rows)
    assert drawn(alone).count("1H1C") == 2


def test_numbers_are_aligned_and_empty_columns_go_from_a_page() -> None:
    page = TABLE.html()
    assert "<th class=number>Success %</th>" in page
    assert "<th>Policy</th>" in page
    assert "empty" not in page
    justified = [column.justify for column in TABLE.text().columns]
    assert justified == ["left", "left", "right", "right", "right"]


def test_what_is_dim() -> None:
    text = TABLE.text()
    assert [row.style for row in text.rows] == [None, "dim", None]
    assert [column.header for column in text.columns if column.style == "dim"] == ["paper"]


def test_cells_are_text_unless_they_are_marked() -> None:
    assert "| 2H\\|1C |" in TABLE.markdown()
    bold = Table(headings=["a"], rows=[["**1**"]])
    assert bold.markdown() == "| a |\n| --- |\n| \\*\\*1\\*\\* |\n"
    assert bold.markdown(is_marked=True) == "| a |\n| --- |\n| **1** |\n"
    assert "&lt;b&gt;" in Table(headings=["<b>"], rows=[["x"]]).html()
