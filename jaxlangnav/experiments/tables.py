"""Tables for people: ours beside the paper's, in Markdown and in the terminal (section 4.2)."""

import math
from typing import Any

from jaxlangnav.experiments.policies import KNOWLEDGE
from jaxlangnav.experiments.rows import Row, row_key

HEADINGS = (
    "World",
    "Range m",
    "Relation",
    "Policy",
    "Success % (95 %)",
    "paper",
    "Distance m (σ)",
    "paper (σ)",
    "Known m (σ)",
    "paper (σ)",
    "SPL",
    "Time-outs",
    "ECE",
    "Brier",
    "90 % region",
)
TERMINAL_HEADINGS = (
    "World",
    "m",
    "Relation",
    "Policy",
    "Success %",
    "95 %",
    "paper",
    "Distance m",
    "paper",
    "Known m",
    "SPL",
    "Late",
)
PAPER_RUNS = 100
"""Simulations behind a printed figure: "approximately 100" (section 4.2)."""


def cells(row: Row, paper: Row | None) -> list[str]:
    """Write one row's cells.

    Args:
        row: ours.
        paper: the printed row beside it, if there is one.

    Returns:
        Texts in the order of ``HEADINGS``.
    """
    low, high = row["success_ci"]
    printed = paper or {}
    return [
        row["world"],
        f"{row['range']:g}",
        row["relation"] or "null",
        row["policy"],
        f"{row['success_rate']:.1f} ({low:.1f}-{high:.1f})",
        f"{printed['success_rate']:.1f}" if printed else "",
        _with_sd(row, "distance"),
        _with_sd(printed, "distance") if printed else "",
        _with_sd(row, "known_distance"),
        _with_sd(printed, "known_distance") if printed else "",
        f"{row['spl']:.2f}",
        str(row["timeouts"]),
        _score(row, "ece", ".3f"),
        _score(row, "brier", ".3f"),
        _score(row, "coverage90", ".0f"),
    ]


def _score(row: Row, name: str, form: str) -> str:
    """Write a score of calibration; a policy without a belief has none."""
    value = row.get(name)
    return "" if value is None else format(value, form)


def _with_sd(row: Row, name: str) -> str:
    """Write a mean with its standard deviation."""
    return f"{row[f'{name}_mean']:.2f} ({row[f'{name}_sd']:.2f})"


def paired_rows(document: dict[str, Any]) -> list[tuple[Row, Row | None]]:
    """Set each of our rows beside the printed one; by row, then by policy.

    Args:
        document: with ``rows`` and perhaps ``paper``.

    Returns:
        Ours and the paper's, rows of the same worlds behind one another.
    """
    printed = {row_key(row): row for row in document.get("paper", [])}
    order = list(dict.fromkeys(row_key(row) for row in document["rows"]))
    rows = sorted(document["rows"], key=lambda row: order.index(row_key(row)))
    return [(row, printed.get(row_key(row))) for row in rows]


def markdown_table(document: dict[str, Any]) -> str:
    """Write a document's rows as a Markdown table.

    Args:
        document: with ``rows`` and perhaps ``paper``.

    Returns:
        Lines, each ended.
    """
    lines = [f"| {' | '.join(HEADINGS)} |", "|" + "---|" * len(HEADINGS)]
    lines += [f"| {' | '.join(cells(*pair))} |" for pair in paired_rows(document)]
    return "\n".join(lines) + "\n"


def rich_table(document: dict[str, Any], *, title: str) -> Any:
    """Draw a document's rows for the terminal.

    Args:
        document: with ``rows`` and perhaps ``paper``.
        title: above the table.

    Returns:
        A rich table, its caption says under what noise it was measured.
    """
    from rich.table import Table

    table = Table(title=title, caption=caption(document), caption_justify="left")
    for heading in TERMINAL_HEADINGS:
        is_text = heading in ("World", "Relation", "Policy")
        style = "dim" if heading.startswith("paper") else None
        table.add_column(heading, justify="left" if is_text else "right", style=style, no_wrap=True)
    before = None
    for row, paper in paired_rows(document):
        is_first = before != row_key(row)
        if before is not None and is_first and len(document["policies"]) > 1:
            table.add_section()
        before = row_key(row)
        texts = _terminal_cells(row, paper)
        # What a block of policies has in common is said once.
        table.add_row(*(texts if is_first else ["", "", "", *texts[3:]]))
    return table


def _terminal_cells(row: Row, paper: Row | None) -> list[str]:
    """Write one row's cells for the terminal, narrow enough for a hundred columns."""
    texts = cells(row, paper)
    low, high = row["success_ci"]
    printed = texts[7].split(" ")[0]
    return [
        *texts[:4],
        f"{row['success_rate']:.1f}",
        f"{low:.0f}-{high:.0f}",
        texts[5],
        texts[6],
        printed,
        texts[8],
        *texts[10:12],
    ]


def caption(document: dict[str, Any]) -> str:
    """Say under what conditions a table was measured.

    Args:
        document: of an experiment.

    Returns:
        Lines of plain text.
    """
    noise = document["noise"]
    worlds = document.get("environments", 0)
    where = f"{worlds} worlds a template in turn" if worlds else "a fresh world each"
    lines = [
        f"{document['episodes']} episodes a row, {where}, seed {document['seed']}, "
        f"{document['num_particles']} particles; every policy has the same worlds and noise.",
        f"Noise: detection {noise['detection_probability']:g}, {noise['detection_noise']:g} m; "
        f"field of view {math.degrees(noise['field_of_view']):.0f}°; odometry "
        f"{100 * noise['odometry_noise']:g} % of the way; {noise['step_length']:g} m a step.",
        "The paper prints neither geometry nor noise; its σ is over about 100 runs.",
    ]
    invalid = sum(row["invalid_worlds"] for row in document["rows"])
    broken = sum(row["overflows"] + row["degenerate"] for row in document["rows"])
    lines.append(
        f"Worlds that missed their law and are left out: {invalid}; detections without a slot and "
        f"steps with all weights dead: {broken}."
    )
    if document.get("calibration_episodes"):
        lines.append(
            f"Calibration, over every step of {document['calibration_episodes']} episodes a row: "
            'ECE and Brier score of "this object is the goal"; share of steps (%) at which the '
            "90 % region holds the goal."
        )
    lines += [f"{name}: {KNOWLEDGE[name]}." for name in document["policies"]]
    for bound in document.get("bounds", []):
        if bound["search_law"] is not None:
            lines.append(
                f"Limits {bound['world']}, {bound['range']:g} m: known map {bound['known']:.2f} m; "
                f"search without a hint at least {bound['search_law']:.1f} m by the worlds' law, "
                f"{bound['search_uniform']:.1f} m for a goal anywhere in the area; success at most "
                f"{bound['success']:.0f} %."
            )
    return "\n".join(lines)


def deviations(row: Row, paper: Row) -> dict[str, float]:
    """Measure how far a row lies from the printed one, in standard errors of both.

    Args:
        row: ours.
        paper: the printed row.

    Returns:
        ``distance`` and ``success``: signed; ours above the paper's is positive. A rate of 0 or
        100 % counts as half a run away from it, or it would have no error at all.
    """
    distance_error = math.hypot(
        row["distance_sd"] / math.sqrt(max(1, row["episodes"])),
        paper["distance_sd"] / math.sqrt(PAPER_RUNS),
    )
    success_error = math.hypot(
        _rate_error(row["success_rate"], row["episodes"]),
        _rate_error(paper["success_rate"], PAPER_RUNS),
    )
    return {
        "distance": (row["distance_mean"] - paper["distance_mean"]) / max(distance_error, 1e-9),
        "success": (row["success_rate"] - paper["success_rate"]) / success_error,
    }


def _rate_error(percent: float, runs: int) -> float:
    """Compute the standard error of a rate, percent."""
    rate = min(max(percent / 100.0, 0.5 / max(1, runs)), 1.0 - 0.5 / max(1, runs))
    return 100.0 * math.sqrt(rate * (1.0 - rate) / max(1, runs))
