"""An experiment of the paper: rows for every policy, a document, its files (section 4.2)."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypedDict

from jaxlangnav.experiments.archive import pytree_hash, write_experiment
from jaxlangnav.experiments.compilation import CompileClock
from jaxlangnav.experiments.monte_carlo import Progress
from jaxlangnav.experiments.policies import (
    DEFAULT_PARTICLES,
    POLICY_NAMES,
    check_policies,
    navigator_config,
)
from jaxlangnav.experiments.rows import (
    RowSpec,
    bound_rows,
    check_episodes,
    describe_noise,
    judged_episodes,
    printed_rows,
    run_rows,
)
from jaxlangnav.experiments.sentences import SENTENCES, ground_sentences
from jaxlangnav.experiments.sizes import check_engine
from jaxlangnav.experiments.tables import caption, markdown_table, rich_table
from jaxlangnav.messages import MotionParams, SensorParams, default_motion, default_sensor
from jaxlangnav.navigator import NavigatorParams
from jaxlangnav.planner.config import POLICIES
from jaxlangnav.world.templates import TABLE_2


class Options(TypedDict, total=False):
    """What all experiments take; ``Experiment.run`` says what it means and what is the default."""

    episodes: int
    policies: Sequence[str]
    seed: int
    out: str | Path | None
    on_progress: Progress | None
    num_particles: int
    environments: int
    params: NavigatorParams | None
    sensor: SensorParams | None
    motion: MotionParams | None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Experiment:
    """What is run, and under which name it is written."""

    name: str
    title: str
    specs: tuple[RowSpec, ...]
    remark: Callable[[dict[str, Any]], str] | None = None
    """Says beneath the table what its rows show."""
    calibration_episodes: int = 0
    """Episodes of a row in which every step's belief is held against the truth."""

    def markdown(self, document: dict[str, Any]) -> str:
        """Write the table, ours beside the paper's.

        Args:
            document: of ``run``.

        Returns:
            A heading, the table, the remark, and what it was measured under; Markdown.
        """
        remark = f"{self.remark(document)}\n\n" if self.remark else ""
        return f"# {self.title}\n\n{markdown_table(document)}\n{remark}{caption(document)}\n"

    def render(self, document: dict[str, Any]) -> Any:
        """Draw the table for the terminal.

        Args:
            document: of ``run``.

        Returns:
            A rich table.
        """
        return rich_table(document, title=self.title)

    def total_episodes(self, *, episodes: int, policies: Sequence[str]) -> int:
        """Count the runs.

        Args:
            episodes: runs a row.
            policies: names.

        Returns:
            Runs of all rows and policies.
        """
        return len(self.specs) * len(check_policies(policies)) * episodes

    def total_work(self, *, episodes: int, policies: Sequence[str]) -> int:
        """Count the runs and those held against the truth once more, for a progress bar.

        Args:
            episodes: runs a row.
            policies: names.

        Returns:
            What ``on_progress`` of ``run`` adds up to.
        """
        judged = judged_episodes(
            self.specs,
            policies,
            episodes=episodes,
            calibration_episodes=self.calibration_episodes,
        )
        return self.total_episodes(episodes=episodes, policies=policies) + judged

    def check(
        self, *, episodes: int, policies: Sequence[str], num_particles: int
    ) -> tuple[str, ...]:
        """Refuse, before anything is run, what cannot be.

        Args:
            episodes: runs a row.
            policies: names.
            num_particles: P, of the navigator's policies.

        Returns:
            The names, each once.

        Raises:
            ValueError: fewer than one episode, an unknown policy, or more than memory holds.
        """
        names = check_policies(policies)
        check_episodes(episodes, rows=len(self.specs), kept=len(names))
        for policy in names:
            if policy in POLICIES:
                check_engine(navigator_config(policy, num_particles))
        return names

    def run(
        self,
        *,
        episodes: int = 100,
        policies: Sequence[str] = POLICY_NAMES,
        seed: int = 0,
        out: str | Path | None = None,
        on_progress: Progress | None = None,
        num_particles: int = DEFAULT_PARTICLES,
        environments: int = 0,
        params: NavigatorParams | None = None,
        sensor: SensorParams | None = None,
        motion: MotionParams | None = None,
    ) -> dict[str, Any]:
        """Run all rows for every policy.

        Args:
            episodes: runs a row, a fresh world each.
            policies: names; all of ``policies.POLICY_NAMES`` by default.
            seed: root seed of worlds and noise.
            out: folder for Parquet, Markdown and manifest; nothing is written if None.
            on_progress: called with the number of episodes just finished, those held against the
                truth included: ``total_work`` in all.
            num_particles: P, of the navigator's policies.
            environments: worlds of a template taken in turn, ten in the paper; 0 for a fresh one
                per episode.
            params: the navigator's numbers; its defaults if None.
            sensor: the detector; its range is that of each row. The default one if None.
            motion: the odometry, of which the belief is told; the default one if None.

        Returns:
            The document: ``rows``, ``paper``, ``bounds``, ``sentences``, ``noise``, ``wall_s``
            with compilation, ``compile_s`` of it, ``models_sha256`` of the trained weights,
            ``files``. Rates in percent, distances in metres.

        Raises:
            ValueError: fewer than one episode, an unknown policy, or more than memory holds.
        """
        names = self.check(episodes=episodes, policies=policies, num_particles=num_particles)
        begin = time.perf_counter()
        with CompileClock() as clock:
            sentences = ground_sentences(list(SENTENCES.values()))
            found = run_rows(
                self.specs,
                sentences,
                policies=names,
                episodes=episodes,
                seed=seed,
                num_particles=num_particles,
                params=params,
                calibration_episodes=self.calibration_episodes,
                environments=environments,
                sensor=sensor,
                motion=motion,
                on_progress=on_progress,
            )
        keys = {(one.world, one.range, one.relation) for one in self.specs}
        printed = [row for row in TABLE_2 if (row.world, row.range, row.relation) in keys]
        document: dict[str, Any] = {
            "experiment": self.name,
            "episodes": episodes,
            "environments": environments,
            "policies": list(names),
            "seed": seed,
            "num_particles": num_particles,
            "calibration_episodes": min(episodes, self.calibration_episodes),
            "sentences": SENTENCES,
            "noise": describe_noise(sensor or default_sensor(), motion or default_motion()),
            "rows": found.rows,
            "paper": printed_rows(printed),
            "bounds": bound_rows(self.specs),
            "wall_s": time.perf_counter() - begin,
            "compile_s": clock.seconds,
            "models_sha256": pytree_hash(sentences.models),
            "files": [],
        }
        if out is not None:
            text = self.markdown(document)
            files = write_experiment(
                Path(out), self.name, document, found.columns, text, sentences.models
            )
            document["files"] = [str(path) for path in files]
        return document
