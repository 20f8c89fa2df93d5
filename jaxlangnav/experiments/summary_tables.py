"""A sweep's summary for people: its rows, and its paired tests."""

from collections.abc import Sequence
from typing import Any

from jaxlangnav import plain_text
from jaxlangnav.experiments.metrics import timeouts_text
from jaxlangnav.experiments.table import Document, Table

_ALWAYS = ("world", "relation", "range", "policy")
_RESULTS = ("Episodes", "Success % (95 %)", "Distance m (σ)", "Known m", "SPL", "Time-outs")
_TESTS = ("Pairs", "Only 1st, 2nd", "p", "Distance, 2nd − 1st m (95 %)", "p")


def _rows_table(document: Document) -> Table:
    """Lay out the rows of a summary."""
    names = _names(document)
    cells = [
        [*(_text(row[name]) for name in names), *_result_cells(row)] for row in document["rows"]
    ]
    return Table(
        headings=[*names, *_RESULTS], rows=cells, title=document["name"], caption=_state(document)
    )


def _comparisons_table(document: Document) -> Table:
    """Lay out the paired tests of a summary."""
    comparisons = document["comparisons"]
    names = [name for name in _names(document) if comparisons and name in comparisons[0]]
    cells = []
    for one in comparisons:
        low, high = one["distance_ci"]
        first, second = (_arm(one[side], document["varied"]) for side in ("first", "second"))
        cells.append(
            [
                *(_text(one[name]) for name in names),
                first,
                second,
                str(one["pairs"]),
                f"{one['success_only_first']}, {one['success_only_second']}",
                f"{one['success_p']:.3g}",
                f"{one['distance_difference']:+.2f} ({low:+.2f} to {high:+.2f})",
                f"{one['distance_p']:.3g}",
            ]
        )
    headings = [*names, "1st", "2nd", *_TESTS]
    return Table(headings=headings, rows=cells, title="Paired tests", caption=_METHOD)


def summary_markdown(document: Document) -> str:
    """Write a summary as Markdown.

    Args:
        document: of ``summarize_directory``.

    Returns:
        Heading, rows, paired tests.
    """
    rows = _rows_table(document)
    parts = [f"# {plain_text.markdown(rows.title)}", rows.caption, rows.markdown().rstrip()]
    if document["comparisons"]:
        tests = _comparisons_table(document)
        parts += [f"## {tests.title}", tests.markdown().rstrip(), tests.caption]
    return "\n\n".join(parts) + "\n"


_METHOD = (
    "Pairs ran the same world with the same noise. Success: exact McNemar test. Distance: mean "
    "difference, sign-flip permutation test."
)


def render(document: Document) -> Any:
    """Draw a summary for the terminal.

    Args:
        document: of ``summarize_directory``.

    Returns:
        A rich group of tables.
    """
    from rich.console import Group

    tables = [_rows_table(document)]
    if document["comparisons"]:
        tables.append(_comparisons_table(document))
    return Group(*(one.text() for one in tables))


def _names(document: Document) -> list[str]:
    """Choose the columns worth showing, in the order of the files."""
    row = document["rows"][0]
    return [
        name
        for name in row
        if name in _ALWAYS or (name in document["varied"] and name != "command")
    ]


def _arm(arm: dict[str, Any], varied: Sequence[str]) -> str:
    """Name an arm by its policy and whatever else varies."""
    extra = [
        f"{name.split('.')[-1]} {_text(value)}"
        for name, value in arm.items()
        if name != "policy" and name in varied and value is not None
    ]
    return " ".join([arm["policy"], *extra])


def _result_cells(row: dict[str, Any]) -> list[str]:
    """Write the results of one row."""
    low, high = row["success_ci"]
    return [
        str(row["episodes"]),
        f"{row['success_rate']:.1f} ({low:.1f}-{high:.1f})",
        f"{row['distance_mean']:.2f} ({row['distance_sd']:.2f})",
        f"{row['known_distance_mean']:.2f}",
        f"{row['spl']:.2f}",
        timeouts_text(row),
    ]


def _text(value: Any) -> str:
    """Write a value of a column."""
    if value is None:
        return "-"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _state(document: Document) -> str:
    """Say how much of the sweep is there."""
    missing = f"; {document['missing']} files are still missing" if document["missing"] else ""
    if document["damaged"]:
        missing += f", {len(document['damaged'])} of them because they are damaged"
    return f"{document['episodes']} episodes in {document['files']} files{missing}."
