"""``jaxlangnav reproduce``: an experiment of the paper, beside its printed numbers (section 4)."""

import dataclasses
import importlib
import importlib.util
from pathlib import Path
from typing import Literal

import tyro

from jaxlangnav.commands.checks import check_at_least, check_folder, check_seed
from jaxlangnav.commands.output import Document, Output
from jaxlangnav.commands.runtime import keep_compiled_programs, progress_bar

_MONTE_CARLO = {"table2": "table2", "fig5": "figure5"}
"""Experiments made of episodes, and their modules in ``experiments``."""
_SPLITS = 8
"""Random splits of Table 1, as in the paper; ``jaxlangnav evaluate`` takes any number."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Reproduce:
    """Run an experiment of the paper and set it beside the printed numbers.

    table1: how often sentences are understood. table2: success and distance by world and command.
    fig5: both against the sensing range. all: the three of them.

    Policies: faithful (the paper's), informed (ours), frontier (nearest frontier, no language),
    lawnmower (a sweep of the area), known (the map is known); a comma-separated list, or all.
    All of them run in the same worlds with the same noise.

    Examples:
      jaxlangnav reproduce table2 --episodes 100
      jaxlangnav reproduce table2 --policy all --episodes 1000 --out results
      jaxlangnav reproduce fig5 --policy faithful,informed --out results
      jaxlangnav reproduce table2 --json > table2.json
    """

    what: tyro.conf.Positional[Literal["table1", "table2", "fig5", "all"]]
    """Which experiment."""
    episodes: int = 100
    """Runs a row."""
    policy: str = "faithful"
    """One policy, several with commas between, or all."""
    seed: int = 0
    """Root seed of worlds and noise."""
    particles: int = 64
    """Hypotheses of the map kept at once."""
    out: Path | None = None
    """Folder for episodes (Parquet), tables (Markdown), manifest and figures (PNG, SVG)."""
    json: bool = False
    """Print one JSON document: rows, paper, wall_s, compile_s; for all, one by experiment."""

    def run(self, output: Output) -> Document:
        """Run the experiment, print its table and write the files.

        Args:
            output: where the table is printed for people.

        Returns:
            The document.

        Raises:
            ValueError: an option is outside its limits.
        """
        check_at_least("--episodes", self.episodes, 1)
        check_at_least("--particles", self.particles, 2)
        check_seed(self.seed)
        check_folder("--out", self.out)
        keep_compiled_programs()
        if self.what == "all":
            return {name: self._one(name, output) for name in ("table1", *_MONTE_CARLO)}
        return self._one(self.what, output)

    def _one(self, name: str, output: Output) -> Document:
        """Run one experiment, print its table and write its files."""
        return self._table1(output) if name == "table1" else self._monte_carlo(name, output)

    def _table1(self, output: Output) -> Document:
        """Run the paper's protocol for understanding."""
        from jaxlangnav.experiments.table1 import evaluate, render

        with progress_bar("splits", _SPLITS) as advance:
            document = evaluate(splits=_SPLITS, seed=self.seed, on_progress=advance)
        output.say(render(document))
        return document

    def _monte_carlo(self, name: str, output: Output) -> Document:
        """Run episodes for every row and policy."""
        from jaxlangnav.experiments.policies import POLICY_NAMES, check_policies

        named = [one.strip() for one in self.policy.split(",") if one.strip()]
        policies = check_policies(list(POLICY_NAMES) if named == ["all"] else named)
        module_name = _MONTE_CARLO[name]
        experiment = importlib.import_module(f"jaxlangnav.experiments.{module_name}")
        total = experiment.total_episodes(episodes=self.episodes, policies=policies)
        with progress_bar("episodes", total) as advance:
            document = getattr(experiment, f"reproduce_{module_name}")(
                episodes=self.episodes,
                policies=policies,
                seed=self.seed,
                out=self.out,
                on_progress=advance,
                num_particles=self.particles,
            )
        output.say(experiment.render(document))
        wall, compiling = document["wall_s"], document["compile_s"]
        output.say(f"{total} episodes in {wall:.1f} s, {compiling:.1f} s of them compilation.")
        if self.out is not None:
            document["files"] = [*document.get("files", ()), *self._draw(name, document, output)]
        for path in document.get("files", ()):
            output.say(f"Wrote {path}")
        return document

    def _draw(self, name: str, document: Document, output: Output) -> list[Path]:
        """Draw the figure of an experiment, where there is something to draw with."""
        if importlib.util.find_spec("matplotlib") is None:
            output.note('note: no figure without matplotlib: pip install "jaxlangnav[viz]"')
            return []
        from jaxlangnav.viz.style import save
        from jaxlangnav.viz.sweep import range_figure, table_figure

        assert self.out is not None
        draw = range_figure if name == "fig5" else table_figure
        return [*save(draw(document), self.out / _MONTE_CARLO[name])]
