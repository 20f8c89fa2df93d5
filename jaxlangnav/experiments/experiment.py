"""Experiments made of episodes: a grid of settings and arms, its rows, tables and files (4.2).

A *setting* is where episodes run: world, command, range, detector, seed. An *arm* is what is
compared in all of them: a policy with its numbers and sizes. Every arm runs the very same worlds
with the same noise. A sweep takes the grid alone, and works settings and arms out one by one.
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
from jaxlangnav.experiments.judging import bin_sums
from jaxlangnav.experiments.metrics import summarize
from jaxlangnav.experiments.monte_carlo import OnProgress
from jaxlangnav.experiments.policies import (
    DEFAULT_PARTICLES,
    POLICY_NAMES,
    Arm,
    check_policies,
    policy_arm,
)
from jaxlangnav.experiments.rows import RowSpec, describe_noise, printed_rows
from jaxlangnav.experiments.sizes import check_count, check_engine, result_bytes, task_bytes
from jaxlangnav.experiments.table import Row, Told
from jaxlangnav.experiments.tasks import (
    SENTENCES,
    Cell,
    draw_tasks,
    ground_sentences,
    known_distances,
    take_tasks,
)
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.inputs.limits import refuse_below
from jaxlangnav.messages import MotionParams, SensorParams
from jaxlangnav.navigator import NavigatorParams, check
from jaxlangnav.world.templates import TABLE_2

_WHOLE = ("particles", "seed", "episode")
_NAMES = 4 * (len("1H1C") + len("nearest") + len("lawnmower")) + 3 * 8
"""Bytes of an episode's row that say which it is: texts of four bytes a letter, three numbers."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Grid:
    """Settings × arms × episodes; an arm's episodes are numbered setting by setting."""

    settings: Sequence[Cell]
    arms: Sequence[Arm]
    episodes: int  # of an arm in a setting
    names: tuple[str, ...]
    """Columns that settings and arms fill; ``seed`` and ``episode`` follow them."""

    def draw(self, places: np.ndarray) -> Task:
        """Draw the tasks, leaves [E, …], of an arm's episodes by their numbers alone, i[E]."""
        used, index, numbers = self._locate(places)
        return draw_tasks(used, index, numbers)

    def columns(
        self, arm: Arm, places: np.ndarray, results: EpisodeResult, known: np.ndarray
    ) -> dict[str, Any]:
        """Lay episodes of an arm out as columns [E] by name: which each is, and what came of it.

        ``places``: i[E], their numbers among the arm's; ``known``: f32[E], the known map's
        distance, metres. The final position stands in ``final_x`` and ``final_y``.
        """
        columns: dict[str, Any] = {}
        for name, labels in self._labels(arm, places).items():
            # A column that is empty in one file has the type that it has in all others.
            kind = pa.string() if isinstance(labels[0], str) else pa.float64()
            columns[name] = pa.array(labels, pa.int64() if name in _WHOLE else kind)
        for field in dataclasses.fields(results):
            values = np.asarray(getattr(results, field.name))
            if values.ndim == 1:
                columns[field.name] = values
            else:
                columns |= {f"{field.name}_x": values[:, 0], f"{field.name}_y": values[:, 1]}
        return columns | {"known_distance": np.asarray(known)}

    def _labels(self, arm: Arm, places: np.ndarray) -> dict[str, list[Any]]:
        """Say of every episode which it is; what an arm does not have is None."""
        used, index, numbers = self._locate(places)
        told = [{**one.labels, **arm.told, "seed": one.seed} for one in used]
        columns = {name: [told[at][name] for at in index] for name in (*self.names, "seed")}
        return columns | {"episode": [int(number) for number in numbers]}

    def _locate(self, places: np.ndarray) -> tuple[list[Cell], np.ndarray, np.ndarray]:
        """Find the settings of episodes, which of them each is of, and its number in it."""
        where, index = np.unique(places // self.episodes, return_inverse=True)
        return [self.settings[int(at)] for at in where], index, places % self.episodes


@dataclasses.dataclass(frozen=True, kw_only=True)
class Played:
    """An arm that has run in all settings."""

    grid: Grid
    arm: Arm
    results: EpisodeResult
    known: np.ndarray  # f32[E], the known map's distance, metres
    tally: Tally | None = None
    """Of the episodes that are judged: the belief against the truth; leaves [E, …]."""

    def of_setting(self, place: int) -> tuple[EpisodeResult, np.ndarray]:
        """Take the results of one setting, and the known map's distances there."""
        span = slice(place * self.grid.episodes, (place + 1) * self.grid.episodes)
        mine = jax.tree.map(lambda leaf: np.asarray(leaf)[span], self.results)
        return mine, self.known[span]


def run_grid(
    grid: Grid, instructions: Instruction, *, on_progress: OnProgress | None = None
) -> Iterator[Played]:
    """Run a grid arm by arm, all settings in one batch; yields what each arm did.

    ``instructions``: leaves [I, …], as the settings number them.
    """
    drawn = grid.draw(np.arange(len(grid.settings) * grid.episodes))
    for arm in grid.arms:
        tasks = arm.tasks(drawn)
        results, tally = _play(grid, arm, tasks, instructions, on_progress)
        known = known_distances(tasks)
        yield Played(grid=grid, arm=arm, results=results, known=known, tally=tally)


def _play(
    grid: Grid, arm: Arm, tasks: Task, instructions: Instruction, on_progress: OnProgress | None
) -> tuple[EpisodeResult, Tally | None]:
    """Run an arm in all settings: at once, what is judged alike and believes the same numbers."""
    groups: dict[tuple[Any, ...], list[np.ndarray]] = {}
    numbers, judged = np.arange(grid.episodes), arm.judged if arm.config is not None else 0
    for place, setting in enumerate(grid.settings):
        believed = () if arm.config is None else tuple(sorted(setting.believed.items()))
        for is_judged, mine in ((True, numbers[:judged]), (False, numbers[judged:])):
            if len(mine):
                groups.setdefault((is_judged, believed), []).append(place * len(numbers) + mine)
    parts: list[tuple[np.ndarray, EpisodeResult, Tally | None]] = []
    for (is_judged, believed), listed in groups.items():
        places, told = np.concatenate(listed), arm.believing(dict(believed))
        given = take_tasks(tasks, places), instructions
        parts.append((places, *told.run(*given, is_judged=is_judged, on_progress=on_progress)))

    def joined(pairs: list[tuple[np.ndarray, Any]]) -> Any:
        order = np.argsort(np.concatenate([places for places, _ in pairs]))
        together = [leaves for _, leaves in pairs]
        return jax.tree.map(lambda *leaves: np.concatenate(leaves)[order], *together)

    tallies = [(places, tally) for places, _, tally in parts if tally is not None]
    results = joined([(places, found) for places, found, _ in parts])
    return results, joined(tallies) if tallies else None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options:
    """How much of an experiment is run, and under which numbers."""

    episodes: int = 100  # runs a row and arm
    policies: Sequence[str] = POLICY_NAMES
    seed: int = 0  # root seed of worlds and noise
    num_particles: int = DEFAULT_PARTICLES  # P, of the navigator's policies
    environments: int = 0
    """Worlds of a template taken in turn, ten in the paper; 0 for a fresh one per episode."""
    params: NavigatorParams | None = None  # the navigator's numbers; its defaults if None
    sensor: SensorParams | None = None
    """The detector; its range is that of each row. The default one if None."""
    motion: MotionParams | None = None
    """The odometry, of which the belief is told; the default one if None."""


def _policy_arms(options: Options) -> list[Arm]:
    numbers: dict[str, Any] = {
        name: getattr(options, name) for name in ("num_particles", "params", "motion")
    }
    return [policy_arm(policy, **numbers) for policy in check_policies(options.policies)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Experiment(Told):
    """What is run, what is measured of it, how it is told, and under which name it is written."""

    name: str
    specs: tuple[RowSpec, ...]
    arms: Callable[[Options], list[Arm]] = _policy_arms
    """What is compared: at least one arm; refuses an unknown policy."""
    measure: Callable[[Row, RowSpec, EpisodeResult], Row] = lambda *_: {}
    """What a row holds besides: from the row, which one it is, and its episodes."""
    found: Callable[[Sequence[Row], Options], Row] = lambda *_: {}
    """What the document holds besides the rows."""
    calibration_episodes: int = 0
    """Episodes of a row in which every step's belief is held against the truth."""
    sentences: Mapping[str, str] = dataclasses.field(default_factory=lambda: SENTENCES)
    """What is said, by the name that a row has for it."""

    def total_episodes(self, options: Options) -> int:
        """Count the runs of all rows and arms."""
        return len(self.specs) * len(self.arms(options)) * options.episodes

    def check(self, options: Options) -> list[Arm]:
        """Build the arms of a run, or refuse what cannot be, before anything is run.

        ``ValueError``: fewer than one episode, an unknown policy, more than memory holds, or
        numbers with which the robot could never stop.
        """
        judged, rows = min(options.episodes, self.calibration_episodes), len(self.specs)
        arms = [dataclasses.replace(one, judged=one.judged or judged) for one in self.arms(options)]
        refuse_below(1, episodes=options.episodes)
        # Tasks and columns are laid out in parts and then put together: for a moment twice.
        each = 2 * rows * (task_bytes() + len(arms) * (result_bytes() + _NAMES))
        beside = f"{rows} rows run {len(arms)} times"
        check_count("episodes", options.episodes, each=each, beside=beside)
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
        """Run all rows for every arm; refuses as ``check``, and an unknown world or relation.

        Args:
            options: what is run; 100 episodes of every policy if None.
            out: folder for Parquet, Markdown, JSON and manifest; nothing is written if None.
            on_progress: called with the number of episodes just finished: ``total_episodes``.

        Returns:
            The document: ``rows``, ``paper``, ``sentences``, ``noise``, ``wall_s`` with
            compilation, ``compile_s`` of it, ``models_sha256`` of the trained weights, ``files``,
            and what ``found`` adds. Rates in percent, distances in metres.
        """
        options = Options() if options is None else options
        arms, begin = self.check(options), time.perf_counter()
        given = {name: getattr(options, name) for name in ("seed", "environments", "sensor")}
        settings = [one.setting(**given) for one in self.specs]
        names = (*settings[0].labels, *arms[0].told)
        grid = Grid(settings=settings, arms=arms, episodes=options.episodes, names=names)
        rows, parts = list[Row](), list[pa.Table]()
        with CompileClock() as clock:
            sentences = ground_sentences(list(self.sentences.values()))
            for played in run_grid(grid, sentences.instructions, on_progress=on_progress):
                rows += self.rows(played)
                told = played.arm, np.arange(len(played.known)), played.results, played.known
                parts.append(pa.table(grid.columns(*told)))
        document = {
            "experiment": self.name,
            "episodes": options.episodes,
            "environments": options.environments,
            "policies": list(dict.fromkeys(arm.policy for arm in arms)),
            "seed": options.seed,
            "num_particles": options.num_particles,
            "calibration_episodes": min(options.episodes, self.calibration_episodes),
            "sentences": dict(self.sentences),
            "noise": describe_noise(options.sensor, options.motion),
            "rows": rows,
            "paper": printed_rows([row for row in TABLE_2 if RowSpec.of(row) in self.specs]),
            **self.found(rows, options),
            "wall_s": time.perf_counter() - begin,
            "compile_s": clock.seconds,
            "models_sha256": pytree_hash(sentences.models),
            "files": [],
        }
        if out is not None:
            given = document, pa.concat_tables(parts), self.markdown(document), sentences.models
            files = write_experiment(Path(out), self.name, *given)
            document["files"] = [str(path) for path in files]
        return document

    def rows(self, played: Played) -> list[Row]:
        """Summarise what an arm did, one row a setting: its episodes, its scores, ``measure``."""
        rows, number = [], len(self.specs)
        for place, spec in enumerate(self.specs):
            labels = {**played.grid.settings[place].labels, **played.arm.told}
            episodes, known = played.of_setting(place)
            row = labels | summarize(episodes, known).row()
            # None where no belief was judged.
            scored: Row = dict.fromkeys(("ece", "brier", "coverage90", "reliability"))
            if played.tally is not None:
                of = jax.tree.map(lambda leaf, at=place: np.split(leaf, number)[at], played.tally)
                scored = scores(of) | {"reliability": bin_sums(of)}
            row = row | spec.heading() | scored
            rows.append(row | self.measure(row, spec, episodes))
        return rows
