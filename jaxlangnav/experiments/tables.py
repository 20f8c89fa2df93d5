"""The tables of the paper's experiments: ours beside the printed rows and the limits (4.2)."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from jaxlangnav.experiments.grid import Row
from jaxlangnav.experiments.metrics import timeouts_text
from jaxlangnav.experiments.policies import KNOWLEDGE
from jaxlangnav.experiments.rows import AGREEMENT, deviations, row_key
from jaxlangnav.experiments.table import SUCCESS, Document, Table, TableColumns
from jaxlangnav.planner.config import POLICIES
from jaxlangnav.world.simulator import SUCCESS_RADIUS


def _beside(name: str, form: str) -> Callable[[Row], str]:
    """Write a record that stands in a row, where there is one."""
    return lambda row: form.format_map(row[name]) if row[name] else ""


def _score(name: str, form: str) -> Callable[[Row], str]:
    """Write a score of calibration; a policy without a belief has none."""
    return lambda row: "" if row.get(name) is None else format(row[name], form)


_WAY = "{distance_mean:.2f} ({distance_sd:.2f})"
_KNOWN = "{known_distance_mean:.2f} ({known_distance_sd:.2f})"
_ROW: TableColumns = (
    ("World", "{world}"),
    ("Range m", "{range:g}"),
    ("Relation", lambda row: row["relation"] or "null"),
)
_COLUMNS: TableColumns = (
    *_ROW,
    ("Policy", "{policy}"),
    ("Success % (95 %)", SUCCESS),
    ("paper", _beside("same", "{success_rate:.1f}")),
    ("Distance m (σ)", _WAY),
    ("paper (σ)", _beside("same", _WAY)),
    ("Known m (σ)", _KNOWN),
    ("paper (σ)", _beside("paper", _KNOWN)),
    ("SPL", "{spl:.2f}"),
    ("Time-outs", timeouts_text),
    ("ECE", _score("ece", ".3f")),
    ("Brier", _score("brier", ".3f")),
    ("90 % region", _score("coverage90", ".0f")),
)
_SCREEN: TableColumns = (
    ("\nWorld", "{world}"),
    ("\nm", "{range:g}"),
    ("\nRelation", lambda row: row["relation"] or "null"),
    ("\nPolicy", "{policy}"),
    ("Success\n%", "{success_rate:.1f}"),
    ("\n95 %", "{success_ci[0]:.0f}-{success_ci[1]:.0f}"),
    ("paper\n%", _beside("same", "{success_rate:.1f}")),
    ("Distance\nm (σ)", _WAY),
    ("paper\nm", _beside("same", "{distance_mean:.2f}")),
    ("Known\nm (σ)", _KNOWN),
    ("\nSPL", "{spl:.2f}"),
    ("Time-\nouts", timeouts_text),
)
"""Narrow enough for a terminal of a hundred columns."""


def _beside_paper(document: Document) -> list[Row]:
    """Set each of our rows beside ``paper``, the printed one; by row, then by policy."""
    # ``same`` is what it prints for the policy. The paper's method stands beside ours and beside
    # our reading of it, its known map beside ours; it ran no other.
    printed = {row_key(row): row for row in document.get("paper", [])}
    order = list(dict.fromkeys(row_key(row) for row in document["rows"]))
    found = []
    for row in sorted(document["rows"], key=lambda row: order.index(row_key(row))):
        paper, same = printed.get(row_key(row)), None
        if paper is not None and row["policy"] in POLICIES:
            same = paper
        elif paper is not None and row["policy"] == "known":
            names = ("success_rate", "distance_mean", "distance_sd")
            same = {name: paper[f"known_{name}"] for name in names}
        found.append(row | {"paper": paper, "same": same})
    return found


def least_distance(bound: Mapping[str, Any]) -> float:
    """Take the least mean distance of a policy that always succeeds where it can be known how.

    Args:
        bound: of ``rows.bound_rows``.

    Returns:
        Metres: of a search where nothing says where to look; elsewhere straight on, 1.5 m short.
    """
    return bound["search_law"] or max(0.0, bound["known"] - SUCCESS_RADIUS)


def _limit_cells(bound: Row, columns: TableColumns, distance: int) -> list[str]:
    """Write the limits of a row, which no policy can pass; the distance stands in its column."""
    line = [*Table.of([bound], _ROW).rows[0], "limit", f"≤ {bound['success']:.0f}"]
    texts = {distance: f"≥ {least_distance(bound):.2f}"}
    return [*line, *(texts.get(place, "") for place in range(len(line), len(columns)))]


def results_table(document: Document, *, fold: str = "") -> Table:
    """Lay out all lines of a table: every row's policies, then its limits.

    Args:
        document: with ``rows`` and perhaps ``paper`` and ``bounds``.
        fold: what to click on a page to see it.

    Returns:
        The table; each row of the paper's is a block.
    """
    limits = {row_key(bound): bound for bound in document.get("bounds", [])}
    firsts: list[bool] = []
    wide, small = Table.of([], _COLUMNS), Table.of([], _SCREEN)
    lines: list[list[Sequence[str]]] = [[], []]
    for key, mine in itertools.groupby(_beside_paper(document), key=row_key):
        rows, begun = list(mine), len(lines[0])
        for into, columns, distance in zip(lines, (_COLUMNS, _SCREEN), (6, 7), strict=True):
            into += Table.of(rows, columns).rows
            into += [_limit_cells(limits[key], columns, distance)] if key in limits else []
        firsts += [place == 0 for place in range(len(lines[0]) - begun)]
    return Table(
        headings=wide.headings,
        rows=lines[0],
        firsts=firsts,
        faint=[line[3] == "limit" for line in lines[0]],
        fold=fold,
        screen=Table(headings=small.headings, rows=lines[1]),
    )


def caption(document: Document) -> list[str]:
    """Say under what conditions a table was measured.

    Args:
        document: of an experiment.

    Returns:
        Lines of plain text, what the limits are of among them.
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
    bounds = document.get("bounds", [])
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


_DEVIATIONS: TableColumns = (
    *_ROW,
    ("faithful − paper: success", "{success:+.1f}"),
    ("in s. e.", "{far[success]:+.1f}"),
    ("distance m", "{distance:+.2f}"),
    ("in s. e.", "{far[distance]:+.1f}"),
    ("within 2 s. e. of both",
     lambda row: "yes" if max(abs(one) for one in row["far"].values()) <= AGREEMENT else "no"),
)  # fmt: skip


def deviations_table(document: Document) -> Table:
    """Say row by row how far ``faithful`` lies from the paper's own rows.

    Args:
        document: with ``rows`` and ``paper``.

    Returns:
        A line for each of its rows that the paper prints.
    """
    rows = [
        row
        | {
            "far": deviations(row, row["paper"]),
            "success": row["success_rate"] - row["paper"]["success_rate"],
            "distance": row["distance_mean"] - row["paper"]["distance_mean"],
        }
        for row in _beside_paper(document)
        if row["policy"] == "faithful" and row["paper"]
    ]
    return Table.of(rows, _DEVIATIONS)
