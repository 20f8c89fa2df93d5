"""Monte Carlo experiments: run a grid of settings and arms, then write rows, tables, files (4.2).

A *setting* is where episodes run: world, command, range, detector, seed. An *arm* is a policy with
its parameters and capacities. Every arm runs in every setting, in the same worlds with the same
noise (common random numbers). A sweep uses only the grid, and builds settings and arms lazily.
"""

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pyarrow as pa

from jaxlangnav.episode import EpisodeResult, Task
from jaxlangnav.experiments.archive import CompileClock, pytree_hash, write_experiment
from jaxlangnav.experiments.calibration import Tally, scores
from jaxlangnav.experiments.metrics import summarize
from jaxlangnav.experiments.monte_carlo import OnProgress
from jaxlangnav.experiments.policies import (
    DEFAULT_PARTICLES,
    POLICY_NAMES,
    Arm,
    check_policies,
    policy_arm,
)
from jaxlangnav.experiments.reliability import bin_sums
from jaxlangnav.experiments.rows import RowSpec, describe_noise, published_rows
from jaxlangnav.experiments.sizes import check_count, check_engine, result_bytes, task_bytes
from jaxlangnav.experiments.table import Report, Row
from jaxlangnav.experiments.tasks import (
    SENTENCES,
    Cell,
    draw_tasks,
    ground_sentences,
    known_distances,
    take_tasks,
)
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.inputs.limits import check_minimum
from jaxlangnav.messages import MotionParams, SensorParams
from jaxlangnav.navigator import NavigatorParams, check
from jaxlangnav.world.templates import TABLE_2

_INTEGER_COLUMNS = ("particles", "seed", "episode")
_LABEL_BYTES = 4 * (len("1H1C") + len("nearest") + len("lawnmower")) + 3 * 8
"""Bytes of an episode's label columns: texts of four bytes a letter, three numbers."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Grid:
    """Grid of settings × arms × episodes; an arm's episodes are indexed setting by setting."""

    settings: Sequence[Cell]
    arms: Sequence[Arm]
    episodes: int  # per arm and setting
    names: tuple[str, ...]
    """Label columns of settings and arms; ``seed`` and ``episode`` follow them."""

    def draw(self, indices: np.ndarray) -> Task:
        """Draw the tasks, leaves [E, …], of the episodes with the given indices in an arm, i[E]."""
        return draw_tasks(*self._locate(indices))

    def columns(
        self, arm: Arm, indices: np.ndarray, results: EpisodeResult, known_distances: np.ndarray
    ) -> dict[str, Any]:
        """Build columns [E] by name for episodes of an arm: their labels and results.

        ``indices``: i[E], within the arm; ``known_distances``: f32[E] metres, from start to goal
        in the known map. The final position stands in ``final_x`` and ``final_y``.
        """
        columns: dict[str, Any] = {}
        for name, labels in self._labels(arm, indices).items():
            # A column that is empty in one file still has the type that it has in the others.
            dtype = pa.string() if isinstance(labels[0], str) else pa.float64()
            columns[name] = pa.array(labels, pa.int64() if name in _INTEGER_COLUMNS else dtype)
        for field in dataclasses.fields(results):
            values = np.asarray(getattr(results, field.name))
            if values.ndim == 1:
                columns[field.name] = values
            else:
                columns |= {f"{field.name}_x": values[:, 0], f"{field.name}_y": values[:, 1]}
        return columns | {"known_distance": np.asarray(known_distances)}

    def _labels(self, arm: Arm, indices: np.ndarray) -> dict[str, list[Any]]:
        """Build the label columns of episodes; None for parameters that the arm does not have."""
        cells, cell_index, episodes = self._locate(indices)
        labels = [{**cell.labels, **arm.labels, "seed": cell.seed} for cell in cells]
        columns = {name: [labels[i][name] for i in cell_index] for name in (*self.names, "seed")}
        return columns | {"episode": [int(episode) for episode in episodes]}

    def _locate(self, indices: np.ndarray) -> tuple[list[Cell], np.ndarray, np.ndarray]:
        """Split episode indices into cells used, index into them, and index within the cell."""
        cell_ids, cell_index = np.unique(indices // self.episodes, return_inverse=True)
        return [self.settings[int(i)] for i in cell_ids], cell_index, indices % self.episodes


@dataclasses.dataclass(frozen=True, kw_only=True)
class ArmResults:
    """Results of one arm in all settings."""

    grid: Grid
    arm: Arm
    results: EpisodeResult
    known_distances: np.ndarray  # f32[E] metres, from start to goal in the known map
    tally: Tally | None = None
    """Calibration sums of the first episodes of each setting; leaves [E, …]."""

    def of_setting(self, i: int) -> tuple[EpisodeResult, np.ndarray]:
        """Select the results of one setting, and its distances in the known map."""
        span = slice(i * self.grid.episodes, (i + 1) * self.grid.episodes)
        return jax.tree.map(lambda leaf: leaf[span], (self.results, self.known_distances))


def run_grid(
    grid: Grid, instructions: Instruction, *, on_progress: OnProgress | None = None
) -> Iterator[ArmResults]:
    """Run a grid arm by arm, all settings in one batch; yields each arm's results.

    ``instructions``: leaves [I, …], as the settings number them.
    """
    all_tasks = grid.draw(np.arange(len(grid.settings) * grid.episodes))
    for arm in grid.arms:
        tasks = arm.tasks(all_tasks)
        results, tally = _run_arm(grid, arm, tasks, instructions, on_progress)
        extra = {"known_distances": known_distances(tasks), "tally": tally}
        yield ArmResults(grid=grid, arm=arm, results=results, **extra)


def _run_arm(
    grid: Grid, arm: Arm, tasks: Task, instructions: Instruction, on_progress: OnProgress | None
) -> tuple[EpisodeResult, Tally | None]:
    """Run an arm in all settings, batching episodes that share overrides and calibration."""
    groups: dict[tuple[Any, ...], list[np.ndarray]] = {}
    ids, limit = np.arange(grid.episodes), 0 if arm.config is None else arm.calibration_episodes
    for i, setting in enumerate(grid.settings):
        overrides = () if arm.config is None else tuple(sorted(setting.overrides.items()))
        for with_tally, ids_part in ((True, ids[:limit]), (False, ids[limit:])):
            if len(ids_part):
                groups.setdefault((with_tally, overrides), []).append(i * len(ids) + ids_part)
    parts: list[tuple[np.ndarray, EpisodeResult, Tally | None]] = []
    for (with_tally, overrides), chunks in groups.items():
        indices, variant = np.concatenate(chunks), arm.with_overrides(dict(overrides))
        kwargs: dict[str, Any] = {"with_tally": with_tally, "on_progress": on_progress}
        parts.append((indices, *variant.run(take_tasks(tasks, indices), instructions, **kwargs)))

    def merge(chunks: list[tuple[np.ndarray, Any]]) -> Any:
        ordered = np.argsort(np.concatenate([indices for indices, _ in chunks]))
        trees = [leaves for _, leaves in chunks]
        return jax.tree.map(lambda *leaves: np.concatenate(leaves)[ordered], *trees)

    tallies = [(indices, tally) for indices, _, tally in parts if tally is not None]
    results = merge([(indices, values) for indices, values, _ in parts])
    return results, merge(tallies) if tallies else None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options:
    """Options of an experiment: its size, seed and parameters."""

    episodes: int = 100  # per row and arm
    policies: Sequence[str] = POLICY_NAMES
    seed: int = 0  # root seed of worlds and noise
    num_particles: int = DEFAULT_PARTICLES  # P, of the navigator's policies
    params: NavigatorParams | None = None  # the navigator's defaults if None
    sensor: SensorParams | None = None
    """Sensor model; its range is that of each row. The default one if None."""
    motion: MotionParams | None = None
    """Motion model, which the filter assumes too; the default one if None."""


def _policy_arms(options: Options) -> list[Arm]:
    kwargs: dict[str, Any] = {n: getattr(options, n) for n in ("num_particles", "params", "motion")}
    return [policy_arm(policy, **kwargs) for policy in check_policies(options.policies)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Experiment(Report):
    """An experiment: its rows, arms and measures, its report, and the name of its files."""

    name: str
    specs: tuple[RowSpec, ...]
    arms: Callable[[Options], list[Arm]] = _policy_arms
    """Builds the arms to compare, at least one; raises for an unknown policy."""
    measure: Callable[[Row, RowSpec, EpisodeResult], Row] = lambda *_: {}
    """Computes further entries of a row from the row, its spec and its episodes."""
    derived: Callable[[Sequence[Row], Options], Row] = lambda *_: {}
    """Computes further entries of the document from all rows."""
    calibration_episodes: int = 0
    """Episodes of a row in which the belief's calibration is measured at every step."""
    sentences: Mapping[str, str] = dataclasses.field(default_factory=lambda: SENTENCES)
    """Commands, by the relation of the rows that use them."""

    def total_episodes(self, options: Options) -> int:
        """Count the runs of all rows and arms."""
        return len(self.specs) * len(self.arms(options)) * options.episodes

    def check(self, options: Options) -> list[Arm]:
        """Validate the options and build the arms, before anything is run.

        ``ValueError``: fewer than one episode, an unknown policy, more than memory holds, or
        numbers with which the robot could never stop.
        """
        limit, rows = min(options.episodes, self.calibration_episodes), len(self.specs)
        arms = [
            dataclasses.replace(arm, calibration_episodes=arm.calibration_episodes or limit)
            for arm in self.arms(options)
        ]
        check_minimum(1, episodes=options.episodes)
        # Tasks and columns are laid out in parts and then put together: for a moment twice.
        episode_bytes = 2 * rows * (task_bytes() + len(arms) * (result_bytes() + _LABEL_BYTES))
        context = f"{rows} rows run {len(arms)} times"
        check_count("episodes", options.episodes, each=episode_bytes, context=context)
        for arm in arms:
            if arm.config is not None and arm.params is not None:
                check_engine(arm.config)
                check(arm.params, policy=arm.config.planner.chosen)
        return arms

    def run(
        self,
        options: Options | None = None,
        *,
        out: str | Path | None = None,
        on_progress: OnProgress | None = None,
    ) -> dict[str, Any]:
        """Run all rows for every arm; raises as ``check``, and for an unknown world or relation.

        Args:
            options: size and parameters; 100 episodes of every policy if None.
            out: folder for Parquet, Markdown, JSON and manifest; nothing is written if None.
            on_progress: called with the number of episodes just finished: ``total_episodes``.

        Returns:
            The document: ``rows``, ``paper``, ``sentences``, ``noise``, ``wall_s`` with
            compilation, ``compile_s`` of it, ``models_sha256`` of the trained weights, ``files``,
            and what ``derived`` adds. Rates in percent, distances in metres.
        """
        options = Options() if options is None else options
        arms, begin = self.check(options), time.perf_counter()
        settings = [spec.setting(seed=options.seed, sensor=options.sensor) for spec in self.specs]
        names = (*settings[0].labels, *arms[0].labels)
        grid = Grid(settings=settings, arms=arms, episodes=options.episodes, names=names)
        rows, parts = list[Row](), list[pa.Table]()
        with CompileClock() as clock:
            sentences = ground_sentences(list(self.sentences.values()))
            for run in run_grid(grid, sentences.instructions, on_progress=on_progress):
                rows += self.rows(run)
                distances, indices = run.known_distances, np.arange(len(run.known_distances))
                parts.append(pa.table(grid.columns(run.arm, indices, run.results, distances)))
        document = {
            "experiment": self.name,
            "episodes": options.episodes,
            "seed": options.seed,
            "policies": list(dict.fromkeys(arm.policy for arm in arms)),
            "num_particles": options.num_particles,
            "calibration_episodes": min(options.episodes, self.calibration_episodes),
            "sentences": dict(self.sentences),
            "noise": describe_noise(options.sensor, options.motion),
            "rows": rows,
            "paper": published_rows([row for row in TABLE_2 if RowSpec.of(row) in self.specs]),
            **self.derived(rows, options),
            "wall_s": time.perf_counter() - begin,
            "compile_s": clock.seconds,
            "models_sha256": pytree_hash(sentences.models),
            "files": [],
        }
        if out is not None:
            contents = document, pa.concat_tables(parts), self.markdown(document), sentences.models
            files = write_experiment(Path(out), self.name, *contents)
            document["files"] = [str(path) for path in files]
        return document

    def rows(self, run: ArmResults) -> list[Row]:
        """Summarise an arm's results, one row a setting: metrics, calibration and ``measure``."""
        rows, num_rows = [], len(self.specs)
        for i, spec in enumerate(self.specs):
            labels = {**run.grid.settings[i].labels, **run.arm.labels}
            episodes, distances = run.of_setting(i)
            row = labels | dataclasses.asdict(summarize(episodes, distances))
            # None where calibration was not measured.
            calibration: Row = dict.fromkeys(("ece", "brier", "coverage90", "reliability"))
            if run.tally is not None:
                # Of valid worlds, as the other metrics.
                count = len(run.tally.steps) // num_rows
                chosen = i * count + np.flatnonzero(episodes.is_valid[:count])
                tally = jax.tree.map(lambda leaf, chosen=chosen: leaf[chosen], run.tally)
                calibration = scores(tally) | {"reliability": bin_sums(tally)}
            row = row | spec.heading() | calibration
            rows.append(row | self.measure(row, spec, episodes))
        return rows
