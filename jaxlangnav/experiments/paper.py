"""Table 2 and Figure 5 of the paper: success and distance in simulated worlds (section 4.2).

Our rows are listed with the published ones. The paper reports no geometry, noise or field of view:
worlds and noise are those of ``jaxlangnav.world``. Further worlds and ranges can be run too.
Figure 5 states no numbers: where Table 2 has a row of the same world, relation and range, it is in
``paper``.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from jaxlangnav.experiments.experiment import Experiment
from jaxlangnav.experiments.metrics import timeouts_text
from jaxlangnav.experiments.policies import POLICY_KNOWLEDGE
from jaxlangnav.experiments.rows import MAX_Z, TABLE2_ROWS, RowSpec, bound_rows, deviations, row_key
from jaxlangnav.experiments.table import SUCCESS_FORMAT, Document, Row, Table, TableColumns
from jaxlangnav.planner.config import POLICIES
from jaxlangnav.world.simulator import SUCCESS_RADIUS

SENSING_RANGES = (2.0, 3.0, 5.0, 10.0, 15.0, 20.0)  # metres, as in the paper
CALIBRATION_EPISODES = 32
"""Episodes of a row in which calibration is measured at every step."""
EXTRA_ROWS = (
    ("2H2C", 3.0, "null"),
    ("2H2C", 3.0, "behind"),
    ("2H2C", 5.0, "nearest"),
    ("1H3C", 3.0, "null"),
    ("1H3C", 3.0, "behind"),
    ("3H1C", 3.0, "null"),
    ("3H1C", 3.0, "behind"),
    ("3H1C", 5.0, "nearest"),
)
"""Rows not in the paper: its fourth template, and three objects of one type."""


def _format_record(name: str, template: str) -> Callable[[Row], str]:
    """Return a formatter for a nested record of a row; empty where it is missing."""
    return lambda row: template.format_map(row[name]) if row[name] else ""


def _format_score(name: str, spec: str) -> Callable[[Row], str]:
    """Return a formatter for a calibration score; empty for a policy without a belief."""
    return lambda row: "" if row.get(name) is None else format(row[name], spec)


_DISTANCE = "{distance_mean:.2f} ({distance_sd:.2f})"
_KNOWN_MAP_DISTANCE = "{known_distance_mean:.2f} ({known_distance_sd:.2f})"
ROW_COLUMNS: TableColumns = (
    ("World", "{world}"),
    ("Range m", "{range:g}"),
    ("Relation", lambda row: row["relation"] or "null"),
)
_COLUMNS: TableColumns = (
    *ROW_COLUMNS,
    ("Policy", "{policy}"),
    ("Success % (95 %)", SUCCESS_FORMAT),
    ("paper", _format_record("published_same_policy", "{success_rate:.1f}")),
    ("Distance m (σ)", _DISTANCE),
    ("paper (σ)", _format_record("published_same_policy", _DISTANCE)),
    ("Known m (σ)", _KNOWN_MAP_DISTANCE),
    ("paper (σ)", _format_record("published", _KNOWN_MAP_DISTANCE)),
    ("SPL", "{spl:.2f}"),
    ("Time-outs", timeouts_text),
    ("ECE", _format_score("ece", ".3f")),
    ("Brier", _format_score("brier", ".3f")),
    ("90 % region", _format_score("coverage90", ".0f")),
)
_NARROW: TableColumns = (
    ("\nWorld", "{world}"),
    ("\nm", "{range:g}"),
    ("\nRelation", lambda row: row["relation"] or "null"),
    ("\nPolicy", "{policy}"),
    ("Success\n%", "{success_rate:.1f}"),
    ("\n95 %", "{success_ci[0]:.0f}-{success_ci[1]:.0f}"),
    ("paper\n%", _format_record("published_same_policy", "{success_rate:.1f}")),
    ("Distance\nm (σ)", _DISTANCE),
    ("paper\nm", _format_record("published_same_policy", "{distance_mean:.2f}")),
    ("Known\nm (σ)", _KNOWN_MAP_DISTANCE),
    ("\nSPL", "{spl:.2f}"),
    ("Time-\nouts", timeouts_text),
)
"""Columns that fit a terminal of 100 characters."""


def _join_published(document: Document) -> list[Row]:
    """Join each of our rows with the published one; sorted as specified, then by policy."""
    # ``published_same_policy``: published row to compare a policy with: the paper's method with
    # both of our policies, its known map with ours; None for other policies.
    published = {row_key(row): row for row in document.get("paper", [])}
    order = list(dict.fromkeys(row_key(row) for row in document["rows"]))
    rows = []
    for row in sorted(document["rows"], key=lambda row: order.index(row_key(row))):
        paper_row, same_policy = published.get(row_key(row)), None
        if paper_row is not None and row["policy"] in POLICIES:
            same_policy = paper_row
        elif paper_row is not None and row["policy"] == "known":
            names = ("success_rate", "distance_mean", "distance_sd")
            same_policy = {name: paper_row[f"known_{name}"] for name in names}
        rows.append(row | {"published": paper_row, "published_same_policy": same_policy})
    return rows


def min_distance(bound: Mapping[str, Any]) -> float:
    """Compute a lower bound on the mean distance: straight to within 1.5 m of the goal, metres."""
    return max(0.0, bound["known"] - SUCCESS_RADIUS)


def results_table(document: Document, *, collapsed_title: str = "") -> Table:
    """Build a results table: for each setting a line per policy, then a line of bounds."""
    bounds = {row_key(bound): bound for bound in document.get("bounds", [])}
    lines: list[list[Sequence[str]]] = [[], []]
    for key, group in itertools.groupby(_join_published(document), key=row_key):
        rows = list(group)
        for target, columns, distance in zip(lines, (_COLUMNS, _NARROW), (6, 7), strict=True):
            target += Table.of(rows, columns).rows
            if bound := bounds.get(key):
                # Bounds for every policy; the distance is in its column.
                (labels,) = Table.of([bound], ROW_COLUMNS).rows
                line = [*labels, "limit", f"≤ {bound['success']:.0f}"]
                line += [""] * (len(columns) - len(line))
                line[distance] = f"≥ {min_distance(bound):.2f}"
                target.append(line)
    is_dim = [line[3] == "limit" for line in lines[0]]
    narrow = dataclasses.replace(Table.of([], _NARROW), rows=lines[1])
    table = Table.of([], _COLUMNS, group=len(ROW_COLUMNS), dim=is_dim, narrow=narrow)
    return dataclasses.replace(table, rows=lines[0], collapsed_title=collapsed_title)


def caption(document: Document) -> list[str]:
    """Describe the experimental conditions of a table, and its limits."""
    noise = document["noise"]
    lines = [
        f"{document['episodes']} episodes a row, a fresh world each, seed {document['seed']}, "
        f"{document['num_particles']} particles; every policy has the same worlds and noise.",
        f"Noise: detection {noise['detection_probability']:g}, {noise['detection_noise']:g} m; "
        f"field of view {math.degrees(noise['field_of_view']):.0f}°; odometry "
        f"{100 * noise['odometry_noise']:g} % of the way; {noise['step_length']:g} m a step.",
        "The paper prints neither geometry nor noise; its σ is over about 100 runs.",
    ]
    names = ("invalid_worlds", "overflows", "degenerate", "contradictions", "faults")
    totals = {name: sum(row[name] for row in document["rows"]) for name in names}
    lines.append(
        "Invalid worlds, left out: {invalid_worlds}; detections without a slot: {overflows}; steps "
        "with all weights zero: {degenerate}, with an observation that contradicts the map: "
        "{contradictions}, with an invalid observation, at which it stood still: "
        "{faults}.".format_map(totals)
    )
    if document.get("calibration_episodes"):
        lines.append(
            f"Calibration, over every step of {document['calibration_episodes']} episodes a row: "
            'ECE and Brier score of "this object is the goal"; share of steps (%) at which the '
            "90 % region holds the goal."
        )
    lines += [f"{name}: {POLICY_KNOWLEDGE[name]}." for name in document["policies"]]
    if document.get("bounds"):
        lines.append(
            "limit: with the map unknown, the highest success rate and the least mean way of a "
            "policy that reaches it: straight to within 1.5 m of the goal."
        )
    return lines


_DEVIATIONS: TableColumns = (
    *ROW_COLUMNS,
    ("faithful − paper: success", "{success:+.1f}"),
    ("in s. e.", "{z[success]:+.1f}"),
    ("distance m", "{distance:+.2f}"),
    ("in s. e.", "{z[distance]:+.1f}"),
    ("within 2 s. e. of both",
     lambda row: "yes" if max(abs(z) for z in row["z"].values()) <= MAX_Z else "no"),
)  # fmt: skip


def figure_5(*, ranges: Sequence[float] = ()) -> Experiment:
    """Build Figure 5: rows by relation, then by range (metres; default: the paper's)."""
    specs = [
        RowSpec(world="2H1C", range=sensing_range, relation=relation)
        for relation in ("behind", "nearest")
        for sensing_range in sorted(set(ranges)) or SENSING_RANGES
    ]
    return Experiment(
        name="figure5",
        title="Figure 5: distance and success against the sensing range",
        intro="The farther the robot sees, the less it has to search, and the less the sentence "
        "matters: all curves that use it end at the known map's (section 4.2). The printed figure "
        "states no numbers; where Table 2 prints a row of the same world, command and range, it is "
        "drawn.",
        specs=tuple(specs),
        derived=lambda rows, _: {"bounds": bound_rows(specs), "falls": _success_drops(rows)},
        tables=lambda document: _tables(document, collapsed_title="All numbers"),
        notes=lambda document: [describe_success_drops(document), *caption(document)],
    )


def _tables(document: Document, *, collapsed_title: str = "") -> list[Table]:
    """Build the results table, and published rows against ``faithful``, the paper's policy."""
    rows = [
        row
        | {
            "z": deviations(row, row["published"]),
            "success": row["success_rate"] - row["published"]["success_rate"],
            "distance": row["distance_mean"] - row["published"]["distance_mean"],
        }
        for row in _join_published(document)
        if row["policy"] == "faithful" and row["published"]
    ]
    results = results_table(document, collapsed_title=collapsed_title)
    return [results, *([Table.of(rows, _DEVIATIONS)] if rows else [])]


def _success_drops(rows: Sequence[Row]) -> list[Row]:
    """Find significant drops of success with range: disjoint intervals of neighbours."""
    names = ("world", "relation", "policy")
    curves: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        curves.setdefault(tuple(row[name] for name in names), []).append(row)
    drops = []
    for curve in curves.values():
        for before, after in itertools.pairwise(sorted(curve, key=lambda row: row["range"])):
            if after["success_ci"][1] < before["success_ci"][0]:
                rates = {"from": before["success_rate"], "to": after["success_rate"]}
                drops.append({name: after[name] for name in (*names, "range")} | rates)
    return drops


def describe_success_drops(document: Document) -> str:
    """Describe where success drops with range, or that it does not."""
    lines = [
        f"{drop['policy']}, {drop['world']} {drop['relation']}: success falls from "
        f"{drop['from']:.1f} % to {drop['to']:.1f} % at {drop['range']:g} m."
        for drop in _success_drops(document["rows"])
    ]
    return "\n".join(lines) or "Success nowhere falls beyond its intervals as the range grows."


def table_2(*, extra: bool = False, ranges: Sequence[float] = ()) -> Experiment:
    """Build Table 2 in the paper's order: with ``extra`` rows, or at other ``ranges``, metres."""
    conditions = [(spec.world, spec.range, spec.relation) for spec in TABLE2_ROWS]
    specs = tuple(
        RowSpec(world=world, range=sensing_range, relation=relation)
        for world, paper_range, relation in [*conditions, *(EXTRA_ROWS if extra else ())]
        for sensing_range in sorted(set(ranges)) or [paper_range]
    )
    return Experiment(
        name="table2",
        title="Table 2: ours beside the paper's",
        intro="Success and distance in simulated worlds, by world and command (section 4.2). A run "
        "succeeds if the robot itself says stop within 1.5 m of the intended goal.",
        specs=specs,
        calibration_episodes=CALIBRATION_EPISODES,
        derived=lambda *_: {"bounds": bound_rows(specs)},
        tables=_tables,
        notes=lambda document: [
            *([describe_success_drops(document)] if len(set(ranges)) > 1 else []),
            *caption(document),
        ],
    )
