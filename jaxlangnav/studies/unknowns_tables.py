"""Tables of the paper's unknowns: every variation beside the printed rows (section 4.2)."""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

from jaxlangnav.experiments.grid import Row
from jaxlangnav.experiments.metrics import timeouts_text
from jaxlangnav.experiments.rows import AGREEMENT, PAPER_RUNS
from jaxlangnav.experiments.table import Document, Table

TITLE = "What the paper leaves open, one thing at a time"
LEAD = (
    "The rows of Table 2 for faithful, the paper's method, with one thing set otherwise at a time "
    "that the paper does not print. Which of them brings our figures to the paper's?"
)
_LONG = (
    "World", "Range m", "Relation", "Unknown", "Value", "Success % ± s. e.", "paper", "z",
    "Distance m ± s. e.", "paper", "z", "against ours, m (95 %)", "Time-outs",
)  # fmt: skip


def row_name(row: Mapping[str, Any]) -> str:
    """Name a row of Table 2: "2H1C behind"."""
    return f"{row['world']} {row['relation'] or 'null'}"


def matrix(document: Document, *, mark: str = "**") -> Table:
    """Lay out the variations as lines and the rows of Table 2 as columns.

    Args:
        document: of ``Unknowns.run``.
        mark: put before and after a figure within two standard errors of the printed one.

    Returns:
        The table, its cells "success · distance"; the paper's line leads.
    """
    paper, rows = document["paper"], document["rows"]
    printed = [f"{one['success_rate']:.1f} · {one['distance_mean']:.1f}" for one in paper]
    lines = [["the paper", "", *printed, "", ""]]
    for place, fit in enumerate(document["variations"]):
        mine = rows[place * len(paper) : (place + 1) * len(paper)]
        lines.append(
            [
                fit["unknown"],
                fit["value"],
                *(_figures(row, mark, mark, " · ") for row in mine),
                f"{fit['rows_near']} of {len(paper)}",
                f"{fit['rms_z']:.1f}",
            ]
        )
    names = [row_name(one) for one in paper]
    return Table(headings=["unknown", "set to", *names, "rows explained", "rms z"], rows=lines)


def _figures(row: Row, before: str, after: str, between: str, unmarked: str = "") -> str:
    """Write success and distance of a row, with marks about those near the paper's."""
    parts = ((row["success_rate"], "success"), (row["distance_mean"], "distance"))
    return between.join(
        f"{before}{value:.1f}{after}" if row[f"is_{name}_near"] else f"{value:.1f}{unmarked}"
        for value, name in parts
    )


def explained_lines(document: Document) -> list[str]:
    """Say row by row what explains it.

    Args:
        document: of ``Unknowns.run``.

    Returns:
        A sentence for each row of Table 2.
    """
    return [f"{row_name(one)}: {_explain(one)}" for one in document["explained"]]


def _explain(one: Mapping[str, Any]) -> str:
    """Say what explains one row."""
    if one["is_near"]:
        return "ours lies within two standard errors as it is."
    if one["both"]:
        return f"explained by {_or(one['both'])}."
    words = []
    for name in ("success", "distance"):
        if one[f"is_{name}_near"]:
            words.append(f"{name} is near as it is")
        elif one[name]:
            words.append(f"{name} by {_or(one[name])}")
        else:
            words.append(f"{name} by none")
    far = max(abs(z) for z in one["nearest_z"])
    return (
        f"nothing explains both figures ({'; '.join(words)}); the nearest is {one['nearest']}, "
        f"{far:.1f} standard errors away."
    )


def _or(names: Sequence[str]) -> str:
    """List names: "A, B or C"."""
    *others, last = names
    return f"{', '.join(others)} or {last}" if others else last


def long_table(document: Document) -> Table:
    """Lay out every figure with its standard error, the paper's and z beside it.

    Args:
        document: of ``Unknowns.run``.

    Returns:
        The table, by row of Table 2, then by variation.
    """
    number = len(document["paper"])
    ordered = itertools.chain.from_iterable(
        document["rows"][index::number] for index in range(number)
    )
    return Table(headings=_LONG, rows=[_cells(row) for row in ordered], fold="All figures")


def _cells(row: Row) -> list[str]:
    """Write all of a row."""
    pair, against = row["paired"], ""
    if pair is not None and row["value"]:
        low, high = pair["distance_ci"]
        against = f"{pair['distance_difference']:+.2f} ({low:+.2f} to {high:+.2f})"
    return [
        row["world"],
        f"{row['range']:g}",
        row["relation"] or "null",
        row["unknown"],
        row["value"],
        f"{row['success_rate']:.1f} ± {row['success_se']:.1f}",
        f"{row['paper_success_rate']:.1f}",
        f"{row['z_success']:+.1f}",
        f"{row['distance_mean']:.2f} ± {row['distance_se']:.2f}",
        f"{row['paper_distance_mean']:.2f}",
        f"{row['z_distance']:+.1f}",
        against,
        timeouts_text(row),
    ]


def conditions(document: Document) -> str:
    """Say how the tables are to be read and what they were measured under.

    Args:
        document: of ``Unknowns.run``.

    Returns:
        Lines of plain text.
    """
    noise, ours = document["noise"], document["ours"]
    left_out = sum(row["invalid_worlds"] for row in document["rows"])
    return "\n".join(
        [
            f"Success (%) and distance (m); set off, or with a star: within {AGREEMENT:g} standard "
            f"errors of the printed figure, by z in standard errors of both (the paper's rest on "
            f"about {PAPER_RUNS} runs). A row is explained where both figures are near.",
            f"{document['episodes']} episodes a row and variation, a fresh world each, seed "
            f"{document['seed']}; every variation has the same worlds and noise.",
            f"As in all our tables: field of view {math.degrees(noise['field_of_view']):.0f}°; a "
            f"frontier node for each of {ours['num_blocks']} × {ours['num_blocks']} blocks of the "
            f"area; γ {ours['discount']:g}; {document['num_particles']} particles; "
            f"τ {ours['stop_probability']:g}; α {ours['concentration']:g}; reach "
            f"{ours['reach']:g} m; detection {100 * noise['detection_probability']:g} %; time-out "
            f"after {ours['max_steps']} steps of {noise['step_length']:g} m; objects within "
            f"±{math.degrees(ours['bearing_max']):.0f}° ahead.",
            f"Worlds that missed their law and are left out: {left_out}.",
        ]
    )


def unknowns_markdown(document: Document) -> str:
    """Write the whole study as Markdown.

    Args:
        document: of ``Unknowns.run``.

    Returns:
        Heading, matrix, what explains each row, all figures.
    """
    explained = "\n".join(f"- {line}" for line in explained_lines(document))
    return (
        "\n\n".join(
            [
                f"# {TITLE}",
                LEAD,
                matrix(document).markdown(is_marked=True).rstrip(),
                conditions(document),
                explained,
                "## All figures",
                long_table(document).markdown(is_marked=True).rstrip(),
            ]
        )
        + "\n"
    )


def draw_unknowns(document: Document) -> Any:
    """Draw the variations for the terminal, figures near the paper's with a star.

    Args:
        document: of ``Unknowns.run``.

    Returns:
        A rich group: the table, and what explains each row.
    """
    from rich.console import Group
    from rich.text import Text

    paper, rows = document["paper"], document["rows"]
    names = [row_name(one).replace(" ", "\n") for one in paper]
    printed = [f"{one['success_rate']:.1f} \n{one['distance_mean']:.1f} " for one in paper]
    lines = [["the paper", *printed, "", ""]]
    for place, fit in enumerate(document["variations"]):
        mine = rows[place * len(paper) : (place + 1) * len(paper)]
        stacked = [_figures(row, "", "*", "\n", " ") for row in mine]
        near = [str(fit["rows_near"]), f"{fit['rms_z']:.1f}"]
        lines.append([f"{fit['unknown']} {fit['value']}".strip(), *stacked, *near])
    table = Table(
        headings=["success %\ndistance m", *names, "rows\nnear", "rms\nz"],
        rows=lines,
        title=TITLE,
        caption=conditions(document),
        faint=[place == 0 for place in range(len(lines))],
    )
    return Group(table.text(), *(Text(line) for line in explained_lines(document)))
