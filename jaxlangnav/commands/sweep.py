"""``jaxlangnav sweep``: any grid of worlds, commands, ranges and policies (section 4.2)."""

import dataclasses
from pathlib import Path

import tyro

from jaxlangnav.commands.checks import check_folder
from jaxlangnav.commands.output import Document, Output
from jaxlangnav.commands.runtime import keep_compiled_programs, progress_bar


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sweep:
    """Run any grid of worlds, commands, ranges and policies; resumable.

    Writes one row per episode in Parquet shards, with a manifest. A run that was killed goes on
    with --resume and ends with the same rows. --shard 2/8 does the second of eight parts.

    Examples:
      jaxlangnav sweep grid.toml --out results
      jaxlangnav sweep grid.toml --out results --resume
      jaxlangnav sweep grid.toml --out results --shard 2/8
    """

    config: tyro.conf.Positional[Path]
    """What to run, TOML."""
    out: Path
    """Folder for the shards."""
    resume: bool = False
    """Go on with what is in the folder."""
    shard: str = "1/1"
    """Which part of how many."""
    json: bool = False
    """Print one JSON document: the manifest and what has run."""

    def run(self, output: Output) -> Document:
        """Run the grid.

        Args:
            output: where people read what has been written.

        Returns:
            The document of the run.

        Raises:
            ValueError: a mistake in the configuration or an option.
        """
        check_folder("--out", self.out)
        keep_compiled_programs()
        from jaxlangnav.experiments.sweep import run_sweep, total_episodes
        from jaxlangnav.experiments.sweep_config import read_config

        config = read_config(self.config)
        with progress_bar("episodes", total_episodes(config, shard=self.shard)) as advance:
            document = run_sweep(
                config, self.out, resume=self.resume, shard=self.shard, on_progress=advance
            )
        output.say(f"Wrote {self.out}. See it: jaxlangnav summarize {self.out}")
        return document
