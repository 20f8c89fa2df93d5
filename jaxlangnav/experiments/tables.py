"""Tables of rows: ours beside the paper's and the limits (section 4.2)."""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

from jaxlangnav.experiments.grid import Row
from jaxlangnav.experiments.metrics import timeouts_text
from jaxlangnav.experiments.policies import KNOWLEDGE
from jaxlangnav.experiments.rows import AGREEMENT, deviations, row_key
from jaxlangnav.experiments.table import Table
from jaxlangnav.planner.config import POLICIES
from jaxlangnav.world.simulator import SUCCESS_RADIUS

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
    "\nWorld",
    "\nm",
    "\nRelation",
    "\nPolicy",
    "Success\n%",
    "\n95 %",
    "paper\n%",
    "Distance\nm (σ)",
    "paper\nm",
    "Known\nm (σ)",
    "\nSPL",
    "Time-\nouts",
)


def _cells(row: Row, paper: Row | None) -> list[str]:
    """Write one row's cells."""
    low, high = row["success_ci"]
    ours = _printed_of(row["policy"], paper)
    return [
        row["world"],
        f"{row['range']:g}",
        row["relation"] or "null",
        row["policy"],
        f"{row['success_rate']:.1f} ({low:.1f}-{high:.1f})",
        f"{ours['success_rate']:.1f}" if ours else "",
        _with_sd(row, "distance"),
        _with_sd(ours, "distance") if ours else "",
        _with_sd(row, "known_distance"),
        _with_sd(paper, "known_distance") if paper else "",
        f"{row['spl']:.2f}",
        timeouts_text(row),
        _score(row, "ece", ".3f"),
        _score(row, "brier", ".3f"),
        _score(row, "coverage90", ".0f"),
    ]


def _printed_of(policy: str, paper: Row | None) -> Row | None:
    """Take what the paper prints for a policy, success and distance; None where it has none."""
    if paper is None or policy in POLICIES:
        return paper
    if policy != "known":
        return None
    names = ("success_rate", "distance_mean", "distance_sd")
    return {name: paper[f"known_{name}"] for name in names}


def least_distance(bound: Mapping[str, Any]) -> float:
    """Take the least mean distance of a policy that always succeeds where it can be known how.

    Args:
        bound: of ``rows.bound_rows``.

    Returns:
        Metres: of a search where nothing says where to look; elsewhere straight on, 1.5 m short.
    """
    return bound["search_law"] or max(0.0, bound["known"] - SUCCESS_RADIUS)


def _limit_cells(bound: Row) -> list[str]:
    """Write the limits of a row, which no policy can pass."""
    texts = dict.fromkeys(range(len(HEADINGS)), "")
    texts |= {
        0: bound["world"],
        1: f"{bound['range']:g}",
        2: bound["relation"] or "null",
        3: "limit",
        4: f"≤ {bound['success']:.0f}",
        6: f"≥ {least_distance(bound):.2f}",
    }
    return list(texts.values())


def results_table(document: Mapping[str, Any], *, fold: str = "") -> Table:
    """Lay out all lines of a table: every row's policies, then its limits.

    Args:
        document: with ``rows`` and perhaps ``paper`` and ``bounds``.
        fold: what to click on a page to see it.

    Returns:
        The table, of ``HEADINGS``; each row of the paper's is a block.
    """
    limits = {row_key(bound): bound for bound in document.get("bounds", [])}
    firsts, lines = [], []
    for key, pairs in itertools.groupby(_paired_rows(document), key=lambda pair: row_key(pair[0])):
        mine = [_cells(*pair) for pair in pairs]
        if key in limits:
            mine.append(_limit_cells(limits[key]))
        firsts += [index == 0 for index in range(len(mine))]
        lines += mine
    return Table(headings=HEADINGS, rows=lines, firsts=firsts, fold=fold)


def terminal_table(document: Mapping[str, Any], *, title: str) -> Table:
    """Lay out a document's rows narrow enough for a terminal, conditions beneath.

    Args:
        document: with ``rows`` and perhaps ``paper`` and ``bounds``.
        title: above the table.

    Returns:
        The table, of ``TERMINAL_HEADINGS``.
    """
    wide = results_table(document)
    return Table(
        headings=TERMINAL_HEADINGS,
        rows=[_terminal_cells(texts) for texts in wide.rows],
        title=title,
        caption=caption(document),
        firsts=wide.firsts,
        faint=[texts[3] == "limit" for texts in wide.rows],
    )


def _score(row: Row, name: str, form: str) -> str:
    """Write a score of calibration; a policy without a belief has none."""
    value = row.get(name)
    return "" if value is None else format(value, form)


def _with_sd(row: Row, name: str) -> str:
    """Write a mean with its standard deviation."""
    return f"{row[f'{name}_mean']:.2f} ({row[f'{name}_sd']:.2f})"


def _paired_rows(document: Mapping[str, Any]) -> list[tuple[Row, Row | None]]:
    """Set each of our rows beside the printed one; by row, then by policy."""
    printed = {row_key(row): row for row in document.get("paper", [])}
    order = list(dict.fromkeys(row_key(row) for row in document["rows"]))
    rows = sorted(document["rows"], key=lambda row: order.index(row_key(row)))
    return [(row, printed.get(row_key(row))) for row in rows]


def _terminal_cells(texts: Sequence[str]) -> list[str]:
    """Write one row's cells for the terminal, narrow enough for a hundred columns."""
    rate, _, interval = texts[4].partition(" (")
    ends = [f"{float(end):.0f}" for end in interval.rstrip(")").split("-") if end]
    return [
        *texts[:4],
        rate if ends else texts[4],
        "-".join(ends),
        texts[5],
        texts[6],
        texts[7].split(" ")[0],
        texts[8],
        *texts[10:12],
    ]


def caption(document: Mapping[str, Any]) -> str:
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
    invalid, overflows, dead, odd, faults = (
        sum(row[name] for row in document["rows"])
        for name in ("invalid_worlds", "overflows", "degenerate", "contradictions", "faults")
    )
    lines.append(
        f"Worlds that missed their law and are left out: {invalid}; detections without a slot: "
        f"{overflows}; steps with all weights dead: {dead}, with a look that contradicts the map: "
        f"{odd}, at which it stood still for what cannot be: {faults}."
    )
    if document.get("calibration_episodes"):
        lines.append(
            f"Calibration, over every step of {document['calibration_episodes']} episodes a row: "
            'ECE and Brier score of "this object is the goal"; share of steps (%) at which the '
            "90 % region holds the goal."
        )
    lines += [f"{name}: {KNOWLEDGE[name]}." for name in document["policies"]]
    return "\n".join([*lines, *_of_limits(document.get("bounds", []))])


def _of_limits(bounds: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say what the limits of the table are of; nothing where it has none."""
    lines = []
    if bounds:
        lines.append(
            "limit: with the map unknown, the highest success rate and the least mean way of a "
            "policy that reaches it: straight to within 1.5 m of the goal; without a relation, a "
            "search that knows by what law the hydrants stand."
        )
    searches = [
        f"{bound['search_uniform']:.1f} m ({bound['world']}, {bound['range']:g} m)"
        for bound in bounds
        if bound["search_uniform"] is not None
    ]
    if searches:
        lines.append(
            "A search for a goal that may be anywhere in the area, whatever the path, walks on "
            f"average at least: {', '.join(searches)}."
        )
    return lines


def deviations_table(document: Mapping[str, Any], policy: str = "faithful") -> Table:
    """Say row by row how far a policy lies from the paper's own rows.

    Args:
        document: with ``rows`` and ``paper``.
        policy: the one that should agree with "Ours" of the paper.

    Returns:
        A line for each of its rows that the paper prints.
    """
    headings = ["World", "Range m", "Relation", f"{policy} − paper: success", "in s. e."]
    headings += ["distance m", "in s. e.", "within 2 s. e. of both"]
    lines = []
    for row, paper in _paired_rows(document):
        if row["policy"] == policy and paper is not None:
            far = deviations(row, paper)
            lines.append(
                [
                    *_cells(row, paper)[:3],
                    f"{row['success_rate'] - paper['success_rate']:+.1f}",
                    f"{far['success']:+.1f}",
                    f"{row['distance_mean'] - paper['distance_mean']:+.2f}",
                    f"{far['distance']:+.1f}",
                    "yes" if max(abs(one) for one in far.values()) <= AGREEMENT else "no",
                ]
            )
    return Table(headings=headings, rows=lines)
