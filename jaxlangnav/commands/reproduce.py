"""``jaxlangnav reproduce``: an experiment of the paper, beside its printed numbers (section 4)."""

import dataclasses
import importlib
from pathlib import Path
from typing import Literal

import tyro

from jaxlangnav.commands.checks import check_at_least, check_folder, check_seed
from jaxlangnav.commands.output import Document, Output
from jaxlangnav.commands.runtime import keep_compiled_programs, progress_bar


@dataclasses.dataclass(frozen=True, kw_only=True)
class Reproduce:
    """Run an experiment of the paper and set it beside the printed numbers.

    table2: success and distance by world and command. fig5: both against the sensing range.

    Policies: faithful (the paper's), informed (ours), frontier (nearest frontier, no language),
    lawnmower (a sweep of the area), known (the map is known); a comma-separated list, or all.
    All of them run in the same worlds with the same noise.

    Examples:
      jaxlangnav reproduce table2 --episodes 100
      jaxlangnav reproduce table2 --policy all --episodes 1000 --out results
      jaxlangnav reproduce fig5 --policy faithful,informed --out results
      jaxlangnav reproduce table2 --json > table2.json
    """

    what: tyro.conf.Positional[Literal["table2", "fig5"]]
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
    """Folder for episodes (Parquet), tables (Markdown), manifest and figures."""
    json: bool = False
    """Print one JSON document: rows, paper, wall_s, compile_s."""

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
        from jaxlangnav.experiments.policies import POLICY_NAMES, check_policies

        named = [name.strip() for name in self.policy.split(",") if name.strip()]
        policies = check_policies(list(POLICY_NAMES) if named == ["all"] else named)
        module_name = {"table2": "table2", "fig5": "figure5"}[self.what]
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
        output.say(f"{total} episodes in {wall:.1f} s; compilation took {compiling:.1f} s.")
        for path in document.get("files", ()):
            output.say(f"Wrote {path}")
        return document
