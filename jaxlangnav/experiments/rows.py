"""Rows of the paper's tables and figures: run them for every policy, summarise them (section 4.2).

A row is a template, a relation and a sensing range. All rows of an experiment go through one
compiled program as one batch, and every policy runs the very same tasks.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxlangnav.episode import EpisodeResult, Task
from jaxlangnav.experiments.bounds import limits
from jaxlangnav.experiments.calibration import scores, tally_tasks
from jaxlangnav.experiments.metrics import summarize
from jaxlangnav.experiments.monte_carlo import (
    Progress,
    cell,
    concatenate,
    known_distances,
    make_tasks,
    take_tasks,
)
from jaxlangnav.experiments.policies import (
    DEFAULT_PARTICLES,
    check_policies,
    navigator_config,
    run_policy,
)
from jaxlangnav.experiments.reliability import bin_sums
from jaxlangnav.experiments.sentences import SENTENCES, GroundedSentences
from jaxlangnav.experiments.sizes import check_count, result_bytes, task_bytes
from jaxlangnav.messages import MotionParams, SensorParams, default_motion, default_sensor
from jaxlangnav.navigator import NavigatorParams, default_params
from jaxlangnav.planner.config import POLICIES
from jaxlangnav.pytree import replace
from jaxlangnav.world.templates import TableRow

Row = dict[str, Any]
_NAMES = 4 * (len("1H1C") + len("nearest") + len("lawnmower")) + 3 * 8
"""Bytes of an episode's row that say which it is: texts of four bytes a letter, three numbers."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RowSpec:
    """Which row it is."""

    world: str
    range: float
    relation: str
    """A key of ``SENTENCES``."""

    def heading(self) -> Row:
        """Say which row it is in a document; a command without a relation has None."""
        relation = None if self.relation == "null" else self.relation
        return {"world": self.world, "range": self.range, "relation": relation}


@dataclasses.dataclass(frozen=True, kw_only=True)
class RowResults:
    """Rows with their episodes."""

    rows: list[Row]
    """For each policy one per specification, in their order."""
    columns: dict[str, Any]
    """One entry per episode."""


def check_episodes(episodes: int, *, rows: int, kept: int) -> int:
    """Refuse a number of episodes that cannot be run, before any is.

    Args:
        episodes: runs a row.
        rows: how many rows there are.
        kept: how often the episodes of a row are run and their results kept, such as policies.

    Returns:
        The same.

    Raises:
        ValueError: fewer than one, or more than memory holds.
    """
    if episodes < 1:
        raise ValueError(f"episodes is {episodes}, but must be at least 1")
    # Tasks and columns are laid out in parts and then put together: for a moment twice.
    each = 2 * (task_bytes() + kept * (result_bytes() + _NAMES))
    check_count("episodes", episodes, each=rows * each, beside=f"{rows} rows run {kept} times")
    return episodes


def run_rows(
    specs: Sequence[RowSpec],
    sentences: GroundedSentences,
    *,
    policies: Sequence[str],
    episodes: int,
    seed: int,
    num_particles: int = DEFAULT_PARTICLES,
    params: NavigatorParams | None = None,
    calibration_episodes: int = 0,
    environments: int = 0,
    sensor: SensorParams | None = None,
    motion: MotionParams | None = None,
    on_progress: Progress | None = None,
) -> RowResults:
    """Run rows for every policy, on the same worlds and noise.

    Args:
        specs: the rows.
        sentences: grounded, in the order of ``SENTENCES``.
        policies: names.
        episodes: runs a row.
        seed: root seed of worlds and noise.
        num_particles: P, of the navigator's policies.
        params: the navigator's numbers; its defaults if None.
        calibration_episodes: of each row, the first so many are run once more with every step's
            belief held against the truth.
        environments: worlds of a template taken in turn; 0 for a fresh one per episode.
        sensor: the detector; its range is that of each row. The default one if None.
        motion: the odometry, of which the belief is told; the default one if None.
        on_progress: called with the number of episodes just finished, those held against the
            truth included.

    Returns:
        Rows and episodes.

    Raises:
        ValueError: fewer than one episode, or an unknown policy.
    """
    names = check_policies(policies)
    number = check_episodes(episodes, rows=len(specs), kept=len(names))
    tasks = row_tasks(
        specs, episodes=number, seed=seed, environments=environments, sensor=sensor, motion=motion
    )
    if motion is not None:
        params = default_params() if params is None else params
        params = replace(params, map=replace(params.map, motion=motion))
    known = known_distances(tasks)
    rows: list[Row] = []
    parts: list[dict[str, Any]] = []
    for policy in names:
        results = run_policy(
            policy,
            tasks,
            sentences.instructions,
            params=params,
            num_particles=num_particles,
            on_progress=on_progress,
        )
        rows += [
            _row(one, policy, results, known, slice(index * number, (index + 1) * number))
            for index, one in enumerate(specs)
        ]
        parts.append(_columns(specs, policy, number, seed) | result_columns(results, known))
        judged = min(number, calibration_episodes) if policy in POLICIES else 0
        found = _calibration(
            specs, tasks, sentences, policy, num_particles, params, judged, on_progress
        )
        for row, judgement in zip(rows[-len(specs) :], found, strict=True):
            row |= judgement
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return RowResults(rows=rows, columns=columns)


def row_tasks(
    specs: Sequence[RowSpec],
    *,
    episodes: int,
    seed: int,
    environments: int = 0,
    sensor: SensorParams | None = None,
    motion: MotionParams | None = None,
) -> Task:
    """Draw the tasks of rows.

    Args:
        specs: the rows.
        episodes: runs a row.
        seed: root seed of worlds and noise.
        environments: worlds of a template taken in turn; 0 for a fresh one per episode.
        sensor: the detector; its range is that of each row. The default one if None.
        motion: the odometry; the default one if None.

    Returns:
        Tasks, leaves [rows · episodes, …], row by row; sentences in the order of ``SENTENCES``.

    Raises:
        ValueError: an unknown world or relation.
    """
    order = list(SENTENCES)
    parts = []
    for one in specs:
        drawn = cell(one.world, one.relation, order.index(one.relation), one.range, episodes, seed)
        mine = drawn.sensor if sensor is None else replace(sensor, range_max=drawn.sensor.range_max)
        drawn = dataclasses.replace(
            drawn, environments=environments, sensor=mine, motion=motion or drawn.motion
        )
        parts.append(make_tasks(drawn))
    return concatenate(parts)


def judged_episodes(
    specs: Sequence[RowSpec], policies: Sequence[str], *, episodes: int, calibration_episodes: int
) -> int:
    """Count the episodes that are run once more to judge the belief, for a progress bar.

    Args:
        specs: the rows.
        policies: names; baselines have no belief.
        episodes: runs a row.
        calibration_episodes: of each row at most.

    Returns:
        Runs of all rows and policies.
    """
    believers = sum(policy in POLICIES for policy in policies)
    return len(specs) * believers * min(episodes, calibration_episodes)


def _calibration(
    specs: Sequence[RowSpec],
    tasks: Task,
    sentences: GroundedSentences,
    policy: str,
    num_particles: int,
    params: NavigatorParams | None,
    judged: int,
    on_progress: Progress | None,
) -> list[dict[str, Any]]:
    """Judge the belief in the first episodes of every row; no scores where none is judged."""
    if not judged:
        nothing = {"ece": None, "brier": None, "coverage90": None, "reliability": None}
        return [dict(nothing) for _ in specs]
    size = int(tasks.instruction_index.shape[0]) // len(specs)
    index = np.concatenate([place * size + np.arange(judged) for place in range(len(specs))])
    tally = tally_tasks(
        take_tasks(tasks, index),
        sentences.instructions,
        params=default_params() if params is None else params,
        config=navigator_config(policy, num_particles),
        on_progress=on_progress,
    )
    parts = [
        jax.tree.map(lambda leaf, at=at: leaf[at * judged : (at + 1) * judged], tally)
        for at in range(len(specs))
    ]
    return [scores(part) | {"reliability": bin_sums(part)} for part in parts]


def _row(one: RowSpec, policy: str, results: EpisodeResult, known: np.ndarray, span: slice) -> Row:
    """Summarise the episodes of one row."""
    mine = jax.tree.map(lambda leaf: leaf[span], results)
    metrics = dataclasses.asdict(summarize(mine, known[span]))
    return one.heading() | {"policy": policy} | metrics | {"success_ci": [*metrics["success_ci"]]}


def _columns(specs: Sequence[RowSpec], policy: str, episodes: int, seed: int) -> dict[str, Any]:
    """Say of every episode which it is."""
    number = len(specs) * episodes
    return {
        "world": np.repeat([one.world for one in specs], episodes),
        "range": np.repeat([one.range for one in specs], episodes),
        "relation": np.repeat([one.relation for one in specs], episodes),
        "policy": np.full(number, policy),
        "seed": np.full(number, seed),
        "episode": np.tile(np.arange(episodes), len(specs)),
    }


def result_columns(results: EpisodeResult, known: np.ndarray) -> dict[str, Any]:
    """Lay results out as tidy columns of numbers.

    Args:
        results: leaves [E, …].
        known: f32[E], the known map's distance, metres.

    Returns:
        Arrays [E] by name; the final position as ``final_x`` and ``final_y``.
    """
    columns: dict[str, Any] = {}
    for field in dataclasses.fields(results):
        values = np.asarray(getattr(results, field.name))
        if values.ndim == 1:
            columns[field.name] = values
        else:
            columns |= {f"{field.name}_x": values[:, 0], f"{field.name}_y": values[:, 1]}
    return columns | {"known_distance": np.asarray(known)}


def printed_rows(printed: Sequence[TableRow]) -> list[Row]:
    """List rows as the paper prints them, rates in percent, distances in metres.

    Args:
        printed: of ``world.templates.TABLE_2``.

    Returns:
        One per row.
    """
    return [
        RowSpec(world=row.world, range=row.range, relation=row.relation).heading()
        | {
            "policy": "paper",
            "success_rate": row.success_ours,
            "distance_mean": row.distance_ours,
            "distance_sd": row.distance_ours_sd,
            "known_success_rate": row.success_known,
            "known_distance_mean": row.distance_known,
            "known_distance_sd": row.distance_known_sd,
        }
        for row in printed
    ]


def bound_rows(specs: Sequence[RowSpec]) -> list[Row]:
    """Compute the limits of every row.

    Args:
        specs: the rows.

    Returns:
        One per row; lengths in metres, ``success`` in percent.
    """
    return [one.heading() | limits(one.world, one.relation, one.range) for one in specs]


def default_noise() -> dict[str, float]:
    """Say the noise all rows run under unless they say otherwise, as ``describe_noise``."""
    return describe_noise(default_sensor(), default_motion())


def describe_noise(sensor: SensorParams, motion: MotionParams) -> dict[str, float]:
    """Say the noise of a detector and an odometry.

    Args:
        sensor: the detector.
        motion: the odometry.

    Returns:
        Metres, radians, shares.
    """
    return {
        "detection_probability": round(float(sensor.detection_probability), 6),
        "detection_noise": round(float(sensor.noise), 6),
        "field_of_view": round(float(sensor.field_of_view), 6),
        "odometry_noise": round(float(motion.odometry_noise), 6),
        "step_length": round(float(motion.step_length), 6),
    }


def row_key(row: Row) -> tuple[str, float, str | None]:
    """Identify a row of a table, whatever the policy."""
    return row["world"], row["range"], row["relation"]
