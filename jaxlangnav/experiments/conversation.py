"""Value of dialogue: success and distance with a simulated, possibly erring speaker.

Runs in the worlds of Table 2; the paper leaves dialogue to future work.
"""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.experiments import dialogue
from jaxlangnav.experiments.experiment import Options
from jaxlangnav.experiments.metrics import summarize
from jaxlangnav.experiments.monte_carlo import OnProgress, run_tasks
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.table import Report, Row, Table, TableColumns
from jaxlangnav.experiments.tasks import SENTENCES, Cell, known_distances, make_tasks
from jaxlangnav.messages import default_sensor
from jaxlangnav.navigator import default_params
from jaxlangnav.pytree import replace
from jaxlangnav.world.person import params_of

_TRUE_TEXT, _FALSE_TEXT = "the hydrant is behind the cone", "the hydrant is in front of the cone"
_SILENT: dict[str, Any] = {"num_corrections": 0, "answers": False}
_ANSWERS: dict[str, Any] = {"num_corrections": 0}
_COST = dialogue.QUESTION_COST
_VARIED_COSTS = (0.02, 0.05, 0.2, 0.4)
_NOTE = (
    "Corrected way: metres from the first correction to the end over those straight from there to "
    "where the robot may stop, of the successes that were corrected, where the goal had been seen "
    "by then and where it had not and had to be looked for; with how many there were. Weighted: "
    "success less the cost of the questions asked."
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class DialogueSpec:
    """Specification of a row: worlds, initial command and simulated person."""

    name: str
    world: str = "2H1C"
    relation: str = "null"  # for which a template's worlds are sampled
    text: str = SENTENCES["null"]  # initial command
    person: dict[str, Any]  # arguments of ``params_of``
    cost: float = math.inf  # of a question, in units of success; inf: never ask
    sensing_range: float = 3.0  # metres


ROWS = (
    DialogueSpec(name="nothing more", person=_SILENT),
    DialogueSpec(name="one correction", person={}),
    DialogueSpec(name="one correction, sees 12 m", person={}, sensing_range=12.0),
    DialogueSpec(name="one correction, errs in 10 %", person={"error_rate": 0.1}),
    DialogueSpec(name="questions", person=_ANSWERS, cost=_COST),
    DialogueSpec(name="questions, errs in 10 %", person=_ANSWERS | {"error_rate": 0.1}, cost=_COST),
    *(DialogueSpec(name="questions", person=_ANSWERS, cost=cost) for cost in _VARIED_COSTS),
    DialogueSpec(name="questions", world="1H1C", person=_ANSWERS, cost=_COST),
    DialogueSpec(name="questions", world="1H2C", person=_ANSWERS, cost=_COST),
    DialogueSpec(name="nothing more", relation="behind", person=_SILENT),
    DialogueSpec(name="stated at step 4", relation="behind", person=_SILENT | {"states_at": 4}),
    DialogueSpec(
        name="stated at step 4, errs in 10 %",
        relation="behind",
        person=_SILENT | {"states_at": 4, "error_rate": 0.1},
    ),
    DialogueSpec(name="said at first", relation="behind", text=SENTENCES["behind"], person=_SILENT),
)
"""All rows; those with the same world and relation share their worlds."""


def _run_row(spec: DialogueSpec, options: Options, on_progress: OnProgress | None = None) -> Row:
    sensor = default_sensor(spec.sensing_range)
    cell = Cell(world=spec.world, relation=spec.relation, sensor=sensor, seed=options.seed)
    tasks = make_tasks(cell, options.episodes)
    params = default_params() if options.params is None else options.params
    planner = replace(params.planner, question_cost=jnp.float32(spec.cost))
    navigator, person = replace(params, planner=planner), params_of(**spec.person)
    sentence = dialogue.ground_dialogue(spec.text, _TRUE_TEXT, _FALSE_TEXT)
    dialogues: dialogue.DialogueResult = run_tasks(
        tasks,
        sentence,
        params=dialogue.DialogueParams(navigator=navigator, person=person, sentence=sentence),
        config=navigator_config("informed", options.num_particles),
        on_progress=on_progress,
        program=dialogue.DIALOGUE_PROGRAM,
    )
    metrics = summarize(dialogues.result, known_distances(tasks))
    dialogues = jax.tree.map(lambda leaf: leaf[dialogues.result.is_valid], dialogues)
    is_success, distance = dialogues.result.is_success, dialogues.result.distance
    count = max(1, metrics.episodes)
    questions = float(dialogues.num_questions.sum()) / count
    cost = spec.cost if math.isfinite(spec.cost) else None
    is_corrected = (dialogues.num_corrections > 0) & is_success
    ratios: Row = {}
    for name, group in (("seen", dialogues.has_seen_goal), ("unseen", ~dialogues.has_seen_goal)):
        selected = is_corrected & group
        shortest = float(np.sum(dialogues.shortest[selected]))
        ratio = float(np.sum(dialogues.walked[selected])) / shortest if shortest else None
        ratios |= {f"corrected_way_{name}": ratio, f"corrected_{name}": int(np.sum(selected))}
    return {
        "world": spec.world,
        "relation": spec.relation,
        "said": spec.name,
        "question_cost": cost,
        "episodes": metrics.episodes,
        "success": metrics.success_rate,
        "success_low": metrics.success_ci[0],
        "success_high": metrics.success_ci[1],
        "distance": metrics.distance_mean,
        "distance_of_successes": float(np.mean(distance[is_success])) if is_success.any() else None,
        "questions": questions,
        "corrections": float(dialogues.num_corrections.sum()) / count,
        **ratios,
        "weighted": metrics.success_rate - 100.0 * (cost or 0.0) * questions,
        "time_outs": metrics.timeouts,
    }


def run_rows(options: Options, *, on_progress: OnProgress | None = None) -> dict[str, Any]:
    """Run all rows; only episodes, seed, particles and params of the options are used."""
    return {
        "experiment": "conversation",
        **{name: getattr(options, name) for name in ("episodes", "seed", "num_particles")},
        "rows": [_run_row(spec, options, on_progress) for spec in ROWS],
    }


def _format_ratio(row: Row, suffix: str) -> str:
    """Format the path ratio after a correction, with its number of episodes."""
    ratio = row[f"corrected_way_{suffix}"]
    return "" if ratio is None else f"{ratio:.2f} ({row[f'corrected_{suffix}']})"


_RESULT_COLUMNS: TableColumns = (
    ("world", "{world}"),
    ("drawn for", "{relation}"),
    ("said", "{said}"),
    ("question costs",
     lambda row: "" if row["question_cost"] is None else f"{row['question_cost']:g}"),
    ("success %", "{success:.1f}"),
    ("walked m", "{distance:.2f}"),
    ("questions", "{questions:.2f}"),
    ("corrections", "{corrections:.2f}"),
    ("corrected way, seen", lambda row: _format_ratio(row, "seen")),
    ("unseen", lambda row: _format_ratio(row, "unseen")),
    ("weighted %", "{weighted:.1f}"),
)  # fmt: skip


CONVERSATION = Report(
    title="What a conversation is worth",
    intro="A simulated person who knows the goal corrects, answers and states.",
    tables=lambda document: [Table.of(document["rows"], _RESULT_COLUMNS)],
    notes=lambda _: [_NOTE],
)
"""Report of a document of ``run_rows``."""
