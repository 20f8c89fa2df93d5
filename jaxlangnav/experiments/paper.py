"""Table 2 and Figure 5 of the paper: success and distance in simulated worlds (section 4.2).

Our rows stand beside the printed ones. The paper gives no geometry, no noise and no field of view;
worlds and noise are those of ``jaxlangnav.world`` and every row says how many runs it rests on.
The paper ran further worlds and ranges that it does not print; they can be run beside its rows.
Figure 5 has ranges of 2 to 20 m for "behind" and for "nearest"; the printed figure states no
numbers, so where Table 2 prints a row of the same world, relation and range, it is in ``paper``.
"""

import itertools
from collections.abc import Sequence
from typing import Any

from jaxlangnav.experiments.experiment import Experiment
from jaxlangnav.experiments.grid import Row
from jaxlangnav.experiments.rows import PRINTED, RowSpec, bound_rows
from jaxlangnav.experiments.table import Document, Table
from jaxlangnav.experiments.tables import caption, deviations_table, results_table
from jaxlangnav.world.templates import parse_template

SENSING_RANGES = (2.0, 3.0, 5.0, 10.0, 15.0, 20.0)
"""Metres, as in the paper."""
_RELATIONS = ("behind", "nearest")
_WORLDS = ("2H1C",)
"""The template of which Table 2 prints both commands."""
_LEAD_FIGURE5 = (
    "The farther the robot sees, the less it has to search, and the less the sentence matters: all "
    "curves that use it end at the known map's (section 4.2). The printed figure states no "
    "numbers; where Table 2 prints a row of the same world, command and range, it is drawn."
)


def figure_5(worlds: Sequence[str] = _WORLDS, ranges: Sequence[float] = ()) -> Experiment:
    """Build the experiment for some worlds.

    Args:
        worlds: templates, such as "2H1C".
        ranges: metres; those of the paper if there is none.

    Returns:
        Rows by world and relation, ranges growing.

    Raises:
        ValueError: no world, or an unknown template.
    """
    if not worlds:
        raise ValueError("no world given: name a template such as 2H1C")
    specs = [
        RowSpec(world=parse_template(world).name, range=sensing_range, relation=relation)
        for world in worlds
        for relation in _RELATIONS
        for sensing_range in sorted(set(ranges)) or SENSING_RANGES
    ]
    return Experiment(
        name="figure5",
        title="Figure 5: distance and success against the sensing range",
        lead=_LEAD_FIGURE5,
        specs=tuple(specs),
        found=lambda rows, _: {"bounds": bound_rows(specs), "falls": _falls(rows)},
        tables=lambda document: _tables(document, fold="All numbers"),
        notes=lambda document: [describe_falls(document), *caption(document)],
    )


def _tables(document: Document, *, fold: str = "") -> list[Table]:
    """Lay out the results, and how far our reading of the paper's method lies from its rows."""
    compared = deviations_table(document)
    return [results_table(document, fold=fold), *([compared] if compared.rows else [])]


def _falls(rows: Sequence[Row]) -> list[Row]:
    """Find where success falls as the range grows: the intervals of neighbours do not meet."""
    curves: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        curves.setdefault((row["world"], row["relation"], row["policy"]), []).append(row)
    found = []
    for (world, relation, policy), curve in curves.items():
        ordered = sorted(curve, key=lambda row: row["range"])
        for before, after in itertools.pairwise(ordered):
            if after["success_ci"][1] < before["success_ci"][0]:
                found.append(
                    {
                        "world": world,
                        "relation": relation,
                        "policy": policy,
                        "range": after["range"],
                        "from": before["success_rate"],
                        "to": after["success_rate"],
                    }
                )
    return found


def describe_falls(document: Document) -> str:
    """Say in words where success falls.

    Args:
        document: with ``rows``.

    Returns:
        A sentence for each fall, or that there is none.
    """
    lines = [
        f"{one['policy']}, {one['world']} {one['relation']}: success falls from "
        f"{one['from']:.1f} % to {one['to']:.1f} % at {one['range']:g} m."
        for one in _falls(document["rows"])
    ]
    return "\n".join(lines) or "Success nowhere falls beyond its intervals as the range grows."


CALIBRATION_EPISODES = 32
"""Episodes of a row in which every step's belief is held against the truth."""
_LEAD = (
    "Success and distance in simulated worlds, by world and command (section 4.2). A run succeeds "
    "if the robot itself says stop within 1.5 m of the intended goal."
)
EXTRA = (
    ("2H2C", 3.0, "null"),
    ("2H2C", 3.0, "behind"),
    ("2H2C", 5.0, "nearest"),
    ("1H3C", 3.0, "null"),
    ("1H3C", 3.0, "behind"),
    ("3H1C", 3.0, "null"),
    ("3H1C", 3.0, "behind"),
    ("3H1C", 5.0, "nearest"),
)
"""Rows that the paper does not print: its fourth template, and three objects of one kind."""


def table_2(*, extra: bool = False, ranges: Sequence[float] = ()) -> Experiment:
    """Build the table.

    Args:
        extra: whether the rows that the paper does not print stand beneath its own.
        ranges: metres, in place of each row's own.

    Returns:
        Rows in the paper's order, ranges growing.
    """
    printed = [(row.world, row.range, row.relation) for row in PRINTED]
    reaches = sorted(set(ranges))
    specs = tuple(
        RowSpec(world=world, range=reach, relation=relation)
        for world, own, relation in [*printed, *(EXTRA if extra else ())]
        for reach in reaches or [own]
    )
    remark = describe_falls if len(reaches) > 1 else None
    return Experiment(
        name="table2",
        title="Table 2: ours beside the paper's",
        lead=_LEAD,
        specs=specs,
        calibration_episodes=CALIBRATION_EPISODES,
        found=lambda *_: {"bounds": bound_rows(specs)},
        tables=_tables,
        notes=lambda document: [*([remark(document)] if remark else []), *caption(document)],
    )
