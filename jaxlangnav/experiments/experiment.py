"""An experiment made of episodes, as one record: rows for every arm, tables, files (4.2)."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pyarrow as pa

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.experiments.archive import CompileClock, pytree_hash, write_experiment
from jaxlangnav.experiments.calibration import scores
from jaxlangnav.experiments.grid import Grid, Played, Row, run_grid
from jaxlangnav.experiments.judging import bin_sums
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
from jaxlangnav.experiments.table import Document, Table
from jaxlangnav.experiments.tasks import SENTENCES, ground_sentences
from jaxlangnav.messages import MotionParams, SensorParams
from jaxlangnav.navigator import NavigatorParams, check
from jaxlangnav.world.templates import TABLE_2

_NAMES = 4 * (len("1H1C") + len("nearest") + len("lawnmower")) + 3 * 8
"""Bytes of an episode's row that say which it is: texts of four bytes a letter, three numbers."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options:
    """How much of an experiment is run, and under which numbers."""

    episodes: int = 100
    """Runs a row and arm."""
    policies: Sequence[str] = POLICY_NAMES
    seed: int = 0
    """Root seed of worlds and noise."""
    num_particles: int = DEFAULT_PARTICLES
    """P, of the navigator's policies."""
    environments: int = 0
    """Worlds of a template taken in turn, ten in the paper; 0 for a fresh one per episode."""
    params: NavigatorParams | None = None
    """The navigator's numbers; its defaults if None."""
    sensor: SensorParams | None = None
    """The detector; its range is that of each row. The default one if None."""
    motion: MotionParams | None = None
    """The odometry, of which the belief is told; the default one if None."""


def _policy_arms(options: Options) -> list[Arm]:
    """Build an arm for each policy, in the order of their names."""
    numbers: dict[str, Any] = {
        name: getattr(options, name) for name in ("num_particles", "params", "motion")
    }
    return [policy_arm(policy, **numbers) for policy in check_policies(options.policies)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Experiment:
    """What is run, what is measured of it, how it is told, and under which name it is written."""

    name: str
    title: str
    specs: tuple[RowSpec, ...]
    tables: Callable[[Document], list[Table]]
    """Lays out a document; the terminal draws the first of them."""
    notes: Callable[[Document], list[str]]
    """What stands beneath: what the tables show, and what they were measured under."""
    lead: str = ""
    """What it is and what to see in it, for people."""
    arms: Callable[[Options], list[Arm]] = _policy_arms
    """What is compared: at least one arm; refuses an unknown policy."""
    measure: Callable[[Row, RowSpec, EpisodeResult, EpisodeResult], Row] = lambda *_: {}
    """What a row holds besides: from the row, which one it is, its episodes and the first arm's."""
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
        """Build the arms of a run, or refuse, before anything is run, what cannot be.

        Raises:
            ValueError: fewer than one episode, an unknown policy, more than memory holds, or
                numbers with which the robot could never stop.
        """
        judged, rows = min(options.episodes, self.calibration_episodes), len(self.specs)
        arms = [dataclasses.replace(one, judged=one.judged or judged) for one in self.arms(options)]
        if options.episodes < 1:
            raise ValueError(f"episodes is {options.episodes}, but must be at least 1")
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
        """Run all rows for every arm.

        Args:
            options: what is run; 100 episodes of every policy if None.
            out: folder for Parquet, Markdown, JSON and manifest; nothing is written if None.
            on_progress: called with the number of episodes just finished: ``total_episodes``.

        Returns:
            The document: ``rows``, ``paper``, ``sentences``, ``noise``, ``wall_s`` with
            compilation, ``compile_s`` of it, ``models_sha256`` of the trained weights, ``files``,
            and what ``found`` adds. Rates in percent, distances in metres.

        Raises:
            ValueError: as ``check``, or an unknown world or relation.
        """
        options = Options() if options is None else options
        arms, begin = self.check(options), time.perf_counter()
        seed, worlds, sensor = options.seed, options.environments, options.sensor
        settings = [of.setting(seed=seed, environments=worlds, sensor=sensor) for of in self.specs]
        names = (*settings[0].labels, *arms[0].told)
        grid = Grid(settings=settings, arms=arms, episodes=options.episodes, names=names)
        rows, parts = list[Row](), list[pa.Table]()
        first: Played | None = None
        with CompileClock() as clock:
            sentences = ground_sentences(list(self.sentences.values()))
            for played in run_grid(grid, sentences.instructions, on_progress=on_progress):
                first = first or played
                rows += self.rows(played, first, _scores(played))
                parts.append(pa.table(played.columns()))
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
            columns, text = pa.concat_tables(parts), self.markdown(document)
            given = document, columns, text, sentences.models
            files = write_experiment(Path(out), self.name, *given)
            document["files"] = [str(path) for path in files]
        return document

    def rows(self, played: Played, first: Played, judged: Sequence[Row]) -> list[Row]:
        """Summarise what an arm did, one row a setting: its episodes, its scores, ``measure``."""
        rows = []
        listed = zip(played.rows(), self.specs, judged, strict=True)
        for place, (row, spec, scored) in enumerate(listed):
            row = row | spec.heading() | scored
            episodes = (one.of_setting(place)[0] for one in (played, first))
            rows.append(row | self.measure(row, spec, *episodes))
        return rows

    def markdown(self, document: Document) -> str:
        """Write heading, tables and notes in Markdown."""
        tables = "\n".join(one.markdown() for one in self.tables(document))
        return f"# {self.title}\n\n{tables}\n" + "\n".join(self.notes(document)) + "\n"

    def render(self, document: Document) -> Any:
        """Draw the first table and the notes for the terminal, with rich."""
        notes = "\n".join(self.notes(document))
        first = self.tables(document)[0]
        return dataclasses.replace(first, title=self.title, caption=notes).text()


def _scores(played: Played) -> list[Row]:
    """Score the belief in the episodes of every row that were judged; None where none was."""
    rows = len(played.grid.settings)
    if played.tally is None:
        return [dict.fromkeys(("ece", "brier", "coverage90", "reliability")) for _ in range(rows)]
    parts = [
        jax.tree.map(lambda leaf, at=at: np.split(leaf, rows)[at], played.tally)
        for at in range(rows)
    ]
    return [scores(part) | {"reliability": bin_sums(part)} for part in parts]
