"""The one engine of all tables: a grid of settings and arms, its episodes, their columns (4.2).

A *setting* is where episodes run: world, command, range, detector, seed. An *arm* is what is
compared in all of them: a policy with its numbers and sizes. Every arm runs the very same worlds
with the same noise. Table 2, Figure 5, the study of the paper's unknowns and sweeps are presets;
a sweep lays out neither settings nor arms, but works each out from its number.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import numpy as np
import pyarrow as pa

from jaxlangnav.episode import EpisodeResult, Task
from jaxlangnav.experiments.calibration import Tally
from jaxlangnav.experiments.metrics import summarize
from jaxlangnav.experiments.monte_carlo import OnProgress
from jaxlangnav.experiments.policies import Arm, policy_arm
from jaxlangnav.experiments.tasks import Cell, draw_tasks, known_distances, take_tasks
from jaxlangnav.grounding.instruction import Instruction

__all__ = ["Arm", "Grid", "Played", "Row", "policy_arm", "run_grid"]
Row = dict[str, Any]
_WHOLE = ("particles", "seed", "episode")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Grid:
    """Settings × arms × episodes; an arm's episodes are numbered setting by setting."""

    settings: Sequence[Cell]
    arms: Sequence[Arm]
    episodes: int
    """Of an arm in a setting."""
    names: tuple[str, ...]
    """Columns that settings and arms fill; ``seed`` and ``episode`` follow them."""

    def draw(self, places: np.ndarray) -> Task:
        """Draw the tasks, leaves [E, …], of an arm's episodes by their numbers, i[E].

        An episode's task depends on its setting and its number in it only.
        """
        used, index, numbers = self._locate(places)
        return draw_tasks(used, index, numbers)

    def columns(
        self, arm: Arm, places: np.ndarray, results: EpisodeResult, known: np.ndarray
    ) -> dict[str, Any]:
        """Lay episodes of an arm out as columns [E] by name: which each is, and what came of it.

        ``places``: i[E], their numbers among the arm's; ``results``: leaves [E, …]; ``known``:
        f32[E], the known map's distance, metres. The final position stands in ``final_x`` and
        ``final_y``.
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
    known: np.ndarray
    """f32[E], the known map's distance, metres."""
    tally: Tally | None = None
    """Of the episodes that are judged: the belief against the truth; leaves [E, …]."""

    def columns(self) -> dict[str, Any]:
        """Lay labels and results out, a column each, E long."""
        places = np.arange(len(self.known))
        return self.grid.columns(self.arm, places, self.results, self.known)

    def of_setting(self, place: int) -> tuple[EpisodeResult, np.ndarray]:
        """Take the results of one setting, and the known map's distances there."""
        span = slice(place * self.grid.episodes, (place + 1) * self.grid.episodes)
        mine = jax.tree.map(lambda leaf: np.asarray(leaf)[span], self.results)
        return mine, self.known[span]

    def rows(self) -> list[Row]:
        """Summarise the episodes of each setting."""
        return [
            dict(setting.labels) | dict(self.arm.told) | summarize(*self.of_setting(place)).row()
            for place, setting in enumerate(self.grid.settings)
        ]


def run_grid(
    grid: Grid, instructions: Instruction, *, on_progress: OnProgress | None = None
) -> Iterator[Played]:
    """Run a grid arm by arm; all settings go through one compiled program as one batch.

    ``instructions``: leaves [I, …], as the settings number them; ``on_progress`` is called with the
    number of episodes just finished. Yields what each arm did.
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
        places = np.concatenate(listed)
        mine, told = take_tasks(tasks, places), arm.believing(dict(believed))
        found = told.run(mine, instructions, is_judged=is_judged, on_progress=on_progress)
        parts.append((places, *found))

    def joined(pairs: list[tuple[np.ndarray, Any]]) -> Any:
        order = np.argsort(np.concatenate([places for places, _ in pairs]))
        together = [leaves for _, leaves in pairs]
        return jax.tree.map(lambda *leaves: np.concatenate(leaves)[order], *together)

    tallies = [(places, tally) for places, _, tally in parts if tally is not None]
    results = joined([(places, found) for places, found, _ in parts])
    return results, joined(tallies) if tallies else None
