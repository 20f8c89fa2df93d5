"""Table 2 of the paper: success and distance in simulated worlds (section 4.2).

Our rows stand beside the printed ones. The paper gives no geometry, no noise and no field of view;
worlds and noise are those of ``jaxlangnav.world`` and every row says how many runs it rests on.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from jaxlangnav.experiments.metrics import summarize
from jaxlangnav.experiments.monte_carlo import (
    cell,
    concatenate,
    known_distances,
    make_tasks,
    run_tasks,
)
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams
from jaxlangnav.world.templates import TABLE_2, TableRow

SENTENCES = {
    "null": "go to the hydrant",
    "behind": "go to the hydrant behind the cone",
    "nearest": "go to the hydrant nearest to the cone",
}
"""The three commands of Table 2 by their relation; none of them is in a training corpus."""
Row = dict[str, Any]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Table2:
    """Rows with their episodes."""

    rows: list[Row]
    """One per policy and printed row, in the paper's order."""
    columns: dict[str, Any]
    """One entry per episode."""


def run_table2(
    instructions: Instruction,
    *,
    configs: dict[str, NavigatorConfig],
    params: NavigatorParams,
    episodes: int,
    seed: int,
    on_progress: Callable[[int], None] | None = None,
) -> Table2:
    """Run the seven rows for every policy, on the same worlds and noise.

    Args:
        instructions: the grounded sentences in the order of ``SENTENCES``, leaves [3, …].
        configs: by policy name, sizes and policy.
        params: the navigator's numbers.
        episodes: runs a row.
        seed: root seed of worlds and noise.
        on_progress: called with the number of episodes just finished.

    Returns:
        Rows and episodes.
    """
    order = list(SENTENCES)
    tasks = concatenate(
        [
            make_tasks(
                cell(row.world, row.relation, order.index(row.relation), row.range, episodes, seed)
            )
            for row in TABLE_2
        ]
    )
    known = known_distances(tasks)
    rows: list[Row] = []
    parts: list[dict[str, Any]] = []
    for policy, config in configs.items():
        results = run_tasks(
            tasks, instructions, params=params, config=config, on_progress=on_progress
        )
        for index, row in enumerate(TABLE_2):
            span = slice(index * episodes, (index + 1) * episodes)
            mine = jax.tree.map(lambda leaf, span=span: leaf[span], results)
            metrics = dataclasses.asdict(summarize(mine, known[span]))
            rows.append({**_heading(row), "policy": policy, **metrics})
        parts.append(_columns(results, known, policy, episodes, seed))
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return Table2(rows=rows, columns=columns)


def printed_rows() -> list[Row]:
    """List the rows as the paper prints them, rates in percent, distances in metres."""
    return [
        {
            **_heading(row),
            "policy": "paper",
            "success_rate": row.success_ours,
            "distance_mean": row.distance_ours,
            "distance_sd": row.distance_ours_sd,
            "known_success_rate": row.success_known,
            "known_distance_mean": row.distance_known,
            "known_distance_sd": row.distance_known_sd,
        }
        for row in TABLE_2
    ]


def markdown(rows: Sequence[Row]) -> str:
    """Write the table, ours beside the paper's.

    Args:
        rows: of ``run_table2``.

    Returns:
        A Markdown table.
    """
    lines = [
        "| World | Range | Relation | Policy | Success % (95 % interval) | paper | "
        "Distance m (σ) | paper | Known m (σ) | paper | SPL | Time-outs |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    printed = {_key(row): row for row in printed_rows()}
    for row in rows:
        paper = printed[_key(row)]
        low, high = row["success_ci"]
        cells = [
            row["world"],
            f"{row['range']:g}",
            row["relation"] or "null",
            row["policy"],
            f"{row['success_rate']:.1f} ({low:.1f}-{high:.1f})",
            f"{paper['success_rate']:.1f}",
            f"{row['distance_mean']:.2f} ({row['distance_sd']:.2f})",
            f"{paper['distance_mean']:.2f} ({paper['distance_sd']:.2f})",
            f"{row['known_distance_mean']:.2f} ({row['known_distance_sd']:.2f})",
            f"{paper['known_distance_mean']:.2f} ({paper['known_distance_sd']:.2f})",
            f"{row['spl']:.2f}",
            str(row["timeouts"]),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def total_episodes(*, episodes: int, policies: Sequence[str]) -> int:
    """Count the runs of a table, for a progress bar."""
    return len(TABLE_2) * len(policies) * episodes


def _heading(row: TableRow) -> Row:
    """Say which row it is; a command without a relation has None."""
    relation = None if row.relation == "null" else row.relation
    return {"world": row.world, "range": row.range, "relation": relation}


def _key(row: Row) -> tuple[str, float, str | None]:
    """Identify a row of the table."""
    return row["world"], row["range"], row["relation"]


def _columns(
    results: Any, known: np.ndarray, policy: str, episodes: int, seed: int
) -> dict[str, Any]:
    """Lay the episodes of one policy out as tidy columns."""
    number = len(known)
    return {
        "world": np.repeat([row.world for row in TABLE_2], episodes),
        "range": np.repeat([row.range for row in TABLE_2], episodes),
        "relation": np.repeat([row.relation for row in TABLE_2], episodes),
        "policy": np.full(number, policy),
        "seed": np.full(number, seed),
        "episode": np.tile(np.arange(episodes), len(TABLE_2)),
        **{field.name: getattr(results, field.name) for field in dataclasses.fields(results)},
        "known_distance": known,
    }
