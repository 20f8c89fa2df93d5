"""What a conversation is worth: rows of a person who corrects, answers, states, and errs.

In the worlds of Table 2; the paper leaves it to future work.
"""

import dataclasses
import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxlangnav.experiments.dialogue import converse, sentence_with
from jaxlangnav.experiments.experiment import Options
from jaxlangnav.experiments.metrics import wilson_interval
from jaxlangnav.experiments.monte_carlo import OnProgress
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.table import Report, Row, Table, TableColumns
from jaxlangnav.experiments.tasks import cell, make_tasks
from jaxlangnav.navigator import default_params
from jaxlangnav.pytree import replace
from jaxlangnav.world.person import params_of

_NULL, _BEHIND = "go to the hydrant", "go to the hydrant behind the cone"
_TRUTH, _FALSEHOOD = "the hydrant is behind the cone", "the hydrant is in front of the cone"
_SILENT: dict[str, Any] = {"num_corrections": 0, "answers": False}
_ANSWERS: dict[str, Any] = {"num_corrections": 0}
COST = 0.1  # what a question costs in the rows that do not vary it
COSTS = (0.02, 0.05, 0.2, 0.4)  # what it costs in the others
_NOTE = (
    "Corrected way: metres from the first correction to the end over those straight from there to "
    "where the robot may stop, of the successes that were corrected, where the goal had been seen "
    "by then and where it had not and had to be looked for; with how many there were. Weighted: "
    "success less the cost of the questions asked."
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Dialogue:
    """A row: where, what is said at first, and who speaks."""

    name: str
    world: str = "2H1C"
    relation: str = "null"
    text: str = _NULL
    person: dict[str, Any]
    cost: float = math.inf
    sees: float = 3.0  # metres


ROWS = (
    Dialogue(name="nothing more", person=_SILENT),
    Dialogue(name="one correction", person={}),
    Dialogue(name="one correction, sees 12 m", person={}, sees=12.0),
    Dialogue(name="one correction, errs in 10 %", person={"error_rate": 0.1}),
    Dialogue(name="questions", person=_ANSWERS, cost=COST),
    Dialogue(name="questions, errs in 10 %", person=_ANSWERS | {"error_rate": 0.1}, cost=COST),
    *(Dialogue(name="questions", person=_ANSWERS, cost=cost) for cost in COSTS),
    Dialogue(name="questions", world="1H1C", person=_ANSWERS, cost=COST),
    Dialogue(name="questions", world="1H2C", person=_ANSWERS, cost=COST),
    Dialogue(name="nothing more", relation="behind", person=_SILENT),
    Dialogue(name="stated at step 4", relation="behind", person=_SILENT | {"states_at": 4}),
    Dialogue(
        name="stated at step 4, errs in 10 %",
        relation="behind",
        person=_SILENT | {"states_at": 4, "error_rate": 0.1},
    ),
    Dialogue(name="said at first", relation="behind", text=_BEHIND, person=_SILENT),
)
"""All rows; those of a world and relation are run in the same worlds."""


def _run_row(row: Dialogue, options: Options, on_progress: OnProgress | None = None) -> Row:
    given = row.world, row.relation, 0, row.sees, options.episodes, options.seed
    params = default_params() if options.params is None else options.params
    planner = replace(params.planner, question_cost=jnp.float32(row.cost))
    spoken = converse(
        make_tasks(cell(*given)),
        sentence_with(row.text, _TRUTH, _FALSEHOOD),
        params_of(**row.person),
        params=replace(params, planner=planner),
        config=navigator_config("informed", options.num_particles),
        on_progress=on_progress,
    )
    is_success = np.asarray(spoken.result.is_success)
    distance = np.asarray(spoken.result.distance)
    number, questions = len(is_success), float(np.mean(spoken.num_questions))
    low, high = wilson_interval(int(is_success.sum()), number)
    cost = row.cost if math.isfinite(row.cost) else None
    has_way = (np.asarray(spoken.num_corrections) > 0) & is_success
    ways: Row = {}
    for name, is_known in (("seen", spoken.is_known), ("unseen", ~spoken.is_known)):
        which = has_way & is_known
        straight = float(np.sum(spoken.straight[which]))
        ratio = float(np.sum(spoken.walked[which])) / straight if straight else None
        ways |= {f"corrected_way_{name}": ratio, f"corrected_{name}": int(np.sum(which))}
    rate = 100.0 * float(np.mean(is_success))
    return {
        "world": row.world,
        "relation": row.relation,
        "said": row.name,
        "question_cost": cost,
        "episodes": number,
        "success": rate,
        "success_low": low,
        "success_high": high,
        "distance": float(np.mean(distance)),
        "distance_of_successes": float(np.mean(distance[is_success])) if is_success.any() else None,
        "questions": questions,
        "corrections": float(np.mean(spoken.num_corrections)),
        **ways,
        "weighted": rate if cost is None else rate - 100.0 * cost * questions,
        "time_outs": int(np.sum(~np.asarray(spoken.result.is_stopped))),
    }


def run_rows(options: Options, *, on_progress: OnProgress | None = None) -> dict[str, Any]:
    """Run all rows; of the options episodes, seed, particles and the navigator's numbers count."""
    return {
        "experiment": "conversation",
        "episodes": options.episodes,
        "seed": options.seed,
        "num_particles": options.num_particles,
        "rows": [_run_row(row, options, on_progress) for row in ROWS],
    }


def _corrected(row: Row, which: str) -> str:
    """Write a corrected way with the number of episodes that it is of."""
    ratio = row[f"corrected_way_{which}"]
    return "" if ratio is None else f"{ratio:.2f} ({row[f'corrected_{which}']})"


_COLUMNS: TableColumns = (
    ("world", "{world}"),
    ("drawn for", "{relation}"),
    ("said", "{said}"),
    ("question costs",
     lambda row: "" if row["question_cost"] is None else f"{row['question_cost']:g}"),
    ("success %", "{success:.1f}"),
    ("walked m", "{distance:.2f}"),
    ("questions", "{questions:.2f}"),
    ("corrections", "{corrections:.2f}"),
    ("corrected way, seen", lambda row: _corrected(row, "seen")),
    ("unseen", lambda row: _corrected(row, "unseen")),
    ("weighted %", "{weighted:.1f}"),
)  # fmt: skip


CONVERSATION = Report(
    title="What a conversation is worth",
    lead="A simulated person who knows the goal corrects, answers and states.",
    tables=lambda document: [Table.of(document["rows"], _COLUMNS)],
    notes=lambda _: [_NOTE],
)
"""How the rows of ``run_rows`` are told."""
