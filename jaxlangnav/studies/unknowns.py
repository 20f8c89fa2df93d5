"""What the paper leaves open, one thing at a time: which of it explains its figures (section 4.2)?

The paper prints no field of view, no frontier spacing, no γ, no number of particles, no threshold
of stopping and no geometry. ``faithful`` runs the rows of Table 2 once as in all our tables and
once with each of these set otherwise, in the same worlds with the same noise, and every figure is
held against the printed one in standard errors of both. A variation *explains* a row where both its
success and its distance then lie within two standard errors. Seven rows and two dozen variations
are many looks: one that explains a single row and spoils the others explains little, so the rows
that each variation brings near are counted too.
"""

import dataclasses
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.episode import MAX_STEPS, EpisodeResult, Task
from jaxlangnav.experiments.archive import pytree_hash, write_experiment
from jaxlangnav.experiments.compilation import CompileClock
from jaxlangnav.experiments.deviations import NEAR, deviations, distance_error, rate_error
from jaxlangnav.experiments.metrics import summarize
from jaxlangnav.experiments.monte_carlo import Progress, known_distances, run_tasks
from jaxlangnav.experiments.paired import compare
from jaxlangnav.experiments.policies import DEFAULT_PARTICLES, navigator_config
from jaxlangnav.experiments.rows import (
    Row,
    RowSpec,
    check_episodes,
    describe_noise,
    printed_rows,
    result_columns,
    row_tasks,
)
from jaxlangnav.experiments.sentences import SENTENCES, GroundedSentences, ground_sentences
from jaxlangnav.experiments.sizes import check_engine
from jaxlangnav.messages import MotionParams, SensorParams, default_motion, default_sensor
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams, check, default_params
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.pytree import replace
from jaxlangnav.studies.unknowns_tables import markdown
from jaxlangnav.world.placement import BEARING_MAX
from jaxlangnav.world.templates import TABLE_2

SEED = 3000
"""Root seed if none is given: worlds of their own, none that a table or a tuning has used."""
POLICY = "faithful"
OURS = "as in all our tables"
SPECS = tuple(RowSpec(world=one.world, range=one.range, relation=one.relation) for one in TABLE_2)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Variation:
    """One thing that the paper leaves open, set to one value."""

    unknown: str
    value: str
    """For people."""
    sensor: Mapping[str, float] = dataclasses.field(default_factory=dict)
    map: Mapping[str, float] = dataclasses.field(default_factory=dict)
    planner: Mapping[str, float] = dataclasses.field(default_factory=dict)
    particle_factor: float = 1.0
    num_blocks: int = PlannerConfig().num_blocks
    """Blocks of the area a side, each with one frontier node at most."""
    max_steps: int = MAX_STEPS
    is_turned: bool = False
    """Whether each world is turned about the start by an angle of its own."""

    def params(self, params: NavigatorParams) -> NavigatorParams:
        """Set the navigator's numbers."""
        return replace(
            params,
            map=replace(params.map, **_as_arrays(self.map)),
            planner=replace(params.planner, **_as_arrays(self.planner)),
        )

    def config(self, num_particles: int) -> NavigatorConfig:
        """Set the navigator's sizes."""
        config = navigator_config(POLICY, max(2, round(self.particle_factor * num_particles)))
        planner = dataclasses.replace(config.planner, num_blocks=self.num_blocks)
        return dataclasses.replace(config, planner=planner)

    def tasks(self, tasks: Task, seed: int) -> Task:
        """Set detector and worlds; keys stay, so that all variations are paired."""
        number = tasks.instruction_index.shape[0]
        chosen = {name: jnp.full(number, value) for name, value in self.sensor.items()}
        tasks = replace(tasks, sensor=replace(tasks.sensor, **chosen))
        return turned(tasks, seed) if self.is_turned else tasks


def _degrees(angle: float) -> dict[str, float]:
    """Open the field of view by an angle in degrees."""
    return {"field_of_view": float(np.radians(angle))}


VARIATIONS = (
    Variation(unknown=OURS, value=""),
    Variation(unknown="field of view", value="180°", sensor=_degrees(180.0)),
    Variation(unknown="field of view", value="90°", sensor=_degrees(90.0)),
    Variation(unknown="field of view", value="60°", sensor=_degrees(60.0)),
    Variation(unknown="frontier spacing", value="doubled", num_blocks=3),
    Variation(unknown="frontier spacing", value="halved", num_blocks=12),
    Variation(unknown="discount γ", value="0.5", planner={"discount": 0.5}),
    Variation(unknown="discount γ", value="0.95", planner={"discount": 0.95}),
    Variation(unknown="discount γ", value="0.99", planner={"discount": 0.99}),
    Variation(unknown="particles", value="÷ 4", particle_factor=0.25),
    Variation(unknown="particles", value="× 4", particle_factor=4.0),
    Variation(unknown="stop threshold τ", value="0.3", planner={"stop_probability": 0.3}),
    Variation(unknown="stop threshold τ", value="0.5", planner={"stop_probability": 0.5}),
    Variation(unknown="further objects α", value="0.02", map={"concentration": 0.02}),
    Variation(unknown="further objects α", value="0.1", map={"concentration": 0.1}),
    Variation(unknown="reach", value="0.8 m", planner={"reach": 0.8}),
    Variation(unknown="reach", value="1.45 m", planner={"reach": 1.45}),
    Variation(unknown="detection", value="50 %", sensor={"detection_probability": 0.5}),
    Variation(unknown="time-out", value="480 steps", max_steps=4 * MAX_STEPS),
    Variation(unknown="direction of the goal", value="any", is_turned=True),
)
"""What is varied; the first one is what all our tables run. Two values of one unknown are two
points of a line: what lies between them is for ``jaxlangnav sweep``."""


def turned(tasks: Task, seed: int) -> Task:
    """Turn each world about the start by an angle of its own, uniform over the circle.

    Places relative to each other and to whoever looks from the start stay: what was behind a cone
    still is. The operating area becomes the square [-D, D]² around the start. A world of which
    something then stands outside the area counts as invalid.

    Args:
        tasks: leaves [E, …]; each starts at the origin.
        seed: of the angles.

    Returns:
        Tasks, leaves [E, …].
    """
    scenario = tasks.scenario
    number = tasks.instruction_index.shape[0]
    angle = jax.random.uniform(
        jax.random.fold_in(jax.random.key(seed), 1), (number,), maxval=2.0 * jnp.pi
    )
    cosine, sine = jnp.cos(angle)[:, None], jnp.sin(angle)[:, None]

    def turn(x: Array, y: Array) -> tuple[Array, Array]:
        return cosine * x - sine * y, sine * x + cosine * y

    x, y = turn(scenario.object_x, scenario.object_y)
    goal_x, goal_y = turn(scenario.goal[:, :1], scenario.goal[:, 1:])
    depth = scenario.area[:, 1:2]
    is_inside = (jnp.maximum(jnp.abs(x), jnp.abs(y)) <= depth) | ~scenario.is_object
    return replace(
        tasks,
        scenario=replace(
            scenario,
            object_x=x,
            object_y=y,
            goal=jnp.concatenate([goal_x, goal_y], axis=1),
            area=jnp.concatenate([-depth, depth, -depth, depth], axis=1),
            is_valid=scenario.is_valid & jnp.all(is_inside, axis=1),
        ),
    )


def total_episodes(*, episodes: int) -> int:
    """Count the runs, for a progress bar."""
    return len(VARIATIONS) * len(SPECS) * episodes


def check_sizes(
    *, episodes: int, num_particles: int, variations: Sequence[Variation] = VARIATIONS
) -> None:
    """Refuse, before anything is run, what cannot be.

    Args:
        episodes: runs a row and variation.
        num_particles: P, where the number of particles is not what varies.
        variations: what is varied.

    Raises:
        ValueError: fewer than one episode, or more than memory holds.
    """
    check_episodes(episodes, rows=len(SPECS), kept=len(variations))
    for one in variations:
        check_engine(one.config(num_particles))


def reproduce_unknowns(
    *,
    episodes: int = 100,
    seed: int = SEED,
    out: str | Path | None = None,
    on_progress: Progress | None = None,
    num_particles: int = DEFAULT_PARTICLES,
    params: NavigatorParams | None = None,
    sensor: SensorParams | None = None,
    motion: MotionParams | None = None,
    variations: Sequence[Variation] = VARIATIONS,
) -> dict[str, Any]:
    """Run the rows of Table 2 for every variation.

    Args:
        episodes: runs a row and variation, a fresh world each.
        seed: root seed of worlds and noise.
        out: folder for Parquet, Markdown, JSON and manifest; nothing is written if None.
        on_progress: called with the number of episodes just finished.
        num_particles: P, where the number of particles is not what varies.
        params: the navigator's numbers, where they are not what varies; its defaults if None.
        sensor: the detector; its range is that of each row. The default one if None.
        motion: the odometry, of which the belief is told; the default one if None.
        variations: what is varied; the first one is what the others are compared with.

    Returns:
        The document: ``rows`` (one per variation and row of Table 2, with standard errors, z
        against the printed figures, and paired differences from the first variation), ``paper``,
        ``variations`` (how near each comes over all rows), ``explained`` (by row), ``ours`` and
        ``noise`` (what holds where it is not varied), ``wall_s`` with compilation, ``compile_s``,
        ``models_sha256``, ``files``. Rates in percent, distances in metres.

    Raises:
        ValueError: fewer than one episode, more than memory holds, or numbers with which the
            robot could never stop.
    """
    check_sizes(episodes=episodes, num_particles=num_particles, variations=variations)
    params = default_params() if params is None else params
    if motion is not None:
        params = replace(params, map=replace(params.map, motion=motion))
    for one in variations:
        check(one.params(params))
    begin = time.perf_counter()
    printed = printed_rows(TABLE_2)
    rows: list[Row] = []
    parts: list[dict[str, Any]] = []
    with CompileClock() as clock:
        sentences = ground_sentences(list(SENTENCES.values()))
        drawn = row_tasks(SPECS, episodes=episodes, seed=seed, sensor=sensor, motion=motion)
        first: EpisodeResult | None = None
        for one in variations:
            tasks = one.tasks(drawn, seed)
            results = _run(one, tasks, sentences, params, num_particles, on_progress)
            first = results if first is None else first
            known = known_distances(tasks)
            rows += _rows(one, results, first, known, printed, episodes)
            parts.append(_columns(one, seed, episodes) | result_columns(results, known))
    document: dict[str, Any] = {
        "experiment": "unknowns",
        "policy": POLICY,
        "episodes": episodes,
        "seed": seed,
        "num_particles": num_particles,
        "sentences": SENTENCES,
        "noise": describe_noise(sensor or default_sensor(), motion or default_motion()),
        "ours": _settings(params),
        "variations": [_fit(one, rows) for one in variations],
        "rows": rows,
        "paper": printed,
        "explained": [_explained(index, rows) for index in range(len(SPECS))],
        "wall_s": time.perf_counter() - begin,
        "compile_s": clock.seconds,
        "models_sha256": pytree_hash(sentences.models),
        "files": [],
    }
    if out is not None:
        columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        files = write_experiment(
            Path(out), "unknowns", document, columns, markdown(document), sentences.models
        )
        document["files"] = [str(path) for path in files]
    return document


def _run(
    one: Variation,
    tasks: Task,
    sentences: GroundedSentences,
    params: NavigatorParams,
    num_particles: int,
    on_progress: Progress | None,
) -> EpisodeResult:
    """Run the tasks of all rows under one variation; only sizes compile anew."""
    return run_tasks(
        tasks,
        sentences.instructions,
        params=one.params(params),
        config=one.config(num_particles),
        on_progress=on_progress,
        max_steps=one.max_steps,
    )


def _rows(
    one: Variation,
    results: EpisodeResult,
    first: EpisodeResult,
    known: np.ndarray,
    printed: Sequence[Row],
    episodes: int,
) -> list[Row]:
    """Summarise the episodes of one variation, row by row of Table 2."""
    rows = []
    for index, (spec, paper) in enumerate(zip(SPECS, printed, strict=True)):
        span = slice(index * episodes, (index + 1) * episodes)
        mine, base = (
            jax.tree.map(lambda leaf, span=span: np.asarray(leaf)[span], part)
            for part in (results, first)
        )
        metrics = dataclasses.asdict(summarize(mine, known[span]))
        row = spec.heading() | {"policy": POLICY, "unknown": one.unknown, "value": one.value}
        row |= metrics | {"success_ci": [*metrics["success_ci"]]}
        rows.append(row | _against_paper(row, paper) | _against_first(mine, base))
    return rows


def _against_paper(row: Row, paper: Row) -> Row:
    """Hold a row against the printed one."""
    far = deviations(row, paper)
    return {
        "success_se": rate_error(row["success_rate"], row["episodes"]),
        "distance_se": distance_error(row),
        "paper_success_rate": paper["success_rate"],
        "paper_distance_mean": paper["distance_mean"],
        "z_success": far["success"],
        "z_distance": far["distance"],
        "is_success_near": abs(far["success"]) <= NEAR,
        "is_distance_near": abs(far["distance"]) <= NEAR,
        "is_near": max(abs(z) for z in far.values()) <= NEAR,
    }


def _against_first(mine: EpisodeResult, base: EpisodeResult) -> Row:
    """Compare a variation with the first one, episode by episode."""
    both = np.asarray(mine.is_valid) & np.asarray(base.is_valid)
    if not both.any():
        return {"paired": None}
    pair = compare(
        np.asarray(base.is_success)[both],
        np.asarray(mine.is_success)[both],
        np.asarray(base.distance)[both],
        np.asarray(mine.distance)[both],
    )
    return {"paired": dataclasses.asdict(pair) | {"distance_ci": [*pair.distance_ci]}}


def _fit(one: Variation, rows: Sequence[Row]) -> dict[str, Any]:
    """Say how near a variation comes to the paper over all rows."""
    mine = [row for row in rows if (row["unknown"], row["value"]) == (one.unknown, one.value)]
    z = np.array([[row["z_success"], row["z_distance"]] for row in mine])
    return {
        "unknown": one.unknown,
        "value": one.value,
        "rows_near": int(sum(row["is_near"] for row in mine)),
        "rms_z": float(np.sqrt((z**2).mean())),
    }


def _explained(index: int, rows: Sequence[Row]) -> dict[str, Any]:
    """List the variations that bring a row of Table 2 within two standard errors of the paper."""
    mine = rows[index :: len(SPECS)]
    first, *others = mine
    named = {
        key: [name_of(row) for row in others if row[f"is_{key}"]]
        for key in ("near", "success_near", "distance_near")
    }
    nearest = min(mine, key=lambda row: max(abs(row["z_success"]), abs(row["z_distance"])))
    return SPECS[index].heading() | {
        "is_near": first["is_near"],
        "is_success_near": first["is_success_near"],
        "is_distance_near": first["is_distance_near"],
        "both": named["near"],
        "success": named["success_near"],
        "distance": named["distance_near"],
        "nearest": name_of(nearest),
        "nearest_z": [nearest["z_success"], nearest["z_distance"]],
    }


def _settings(params: NavigatorParams) -> dict[str, float]:
    """Say what holds where it is not varied."""
    traced = {
        "discount": params.planner.discount,
        "stop_probability": params.planner.stop_probability,
        "reach": params.planner.reach,
        "concentration": params.map.concentration,
    }
    return {name: round(float(value), 6) for name, value in traced.items()} | {
        "num_blocks": PlannerConfig().num_blocks,
        "max_steps": MAX_STEPS,
        "bearing_max": BEARING_MAX,
    }


def name_of(row: Mapping[str, Any]) -> str:
    """Name a variation: "field of view 90°"."""
    return f"{row['unknown']} {row['value']}".strip()


def _columns(one: Variation, seed: int, episodes: int) -> dict[str, Any]:
    """Say of every episode which it is."""
    number = len(SPECS) * episodes
    return {
        "world": np.repeat([spec.world for spec in SPECS], episodes),
        "range": np.repeat([spec.range for spec in SPECS], episodes),
        "relation": np.repeat([spec.relation for spec in SPECS], episodes),
        "policy": np.full(number, POLICY),
        "unknown": np.full(number, one.unknown),
        "value": np.full(number, one.value),
        "seed": np.full(number, seed),
        "episode": np.tile(np.arange(episodes), len(SPECS)),
    }


def _as_arrays(chosen: Mapping[str, float]) -> dict[str, Array]:
    """Turn numbers into the traced scalars of Params."""
    return {name: jnp.float32(value) for name, value in chosen.items()}
