"""``jaxlangnav sweep`` and ``summarize``: grids of episodes and their tables (section 4.2)."""

import dataclasses
import importlib.util
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro

from jaxlangnav.cli.checks import Folder, check_folder
from jaxlangnav.cli.output import Document, Output
from jaxlangnav.cli.runtime import keep_compiled_programs, progress_bar
from jaxlangnav.cli.settings import read_options


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sweep:
    """Run any grid of worlds, commands, ranges and policies; resumable.

    Writes one row per episode in Parquet shards, with a manifest. A run that was killed goes on
    with --resume and ends with the same rows; shards that are damaged are named and made again.
    --shard 2/8 does the second of eight parts; a part has one process at a time. All
    devices of the machine are used; with --distributed the processes that a launcher has started
    (srun, mpirun) divide the work among them. Numbers of filter, planner, detector and motion can
    be set here in place of the file's, as in --params.planner.discount 0.9: see --help-params.

    Examples:
      jaxlangnav sweep grid.toml --out results
      jaxlangnav sweep grid.toml --out results --resume
      jaxlangnav sweep grid.toml --out results --shard 2/8
      srun jaxlangnav sweep grid.toml --out results --resume --distributed
      jaxlangnav sweep grid.toml --out wide --sensor.field-of-view "120 deg"
    """

    SETTINGS: ClassVar = ("params.map", "params.planner", "sensor", "motion")

    config: tyro.conf.Positional[Path]
    """What to run, TOML."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the shards."""
    resume: bool = False
    """Go on with what is in the folder."""
    shard: Annotated[str, tyro.conf.arg(metavar="I/N")] = "1/1"
    """Which part of how many."""
    distributed: bool = False
    """Divide the work among the processes of the launcher: SLURM, Open MPI, Kubernetes."""
    coordinator: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None
    """Address of the first process, under any other launcher."""
    processes: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """How many processes there are, under any other launcher."""
    process: Annotated[int | None, tyro.conf.arg(metavar="I")] = None
    """Which one this is, from 0, under any other launcher."""
    json: bool = False
    """Print one JSON document: the manifest and what has run."""
    settings: tyro.conf.Suppress[Any] = None

    def run(self, output: Output) -> Document:
        """Run the grid."""
        check_folder("--out", self.out)
        keep_compiled_programs()
        shard = self._shard()
        from jaxlangnav.experiments.sweep import run_sweep, total_episodes
        from jaxlangnav.experiments.sweep_config import read_config

        overrides: dict[str, dict[str, float]] = {}
        for path, value in read_options(self.settings, self.SETTINGS).items():
            overrides.setdefault(path[-2], {})[path[-1]] = value
        config = read_config(self.config, overrides=overrides)
        options = {"resume": self.resume, "shard": shard, "on_note": output.note}
        with progress_bar("episodes", total_episodes(config, shard=shard)) as advance:
            document = run_sweep(config, self.out, **options, on_progress=advance)
        output.print(f"Wrote {self.out}. See it: jaxlangnav summarize {self.out}")
        return document

    def _shard(self) -> str:
        """Return the shard of this process, "i/n"."""
        launcher = (self.coordinator, self.processes, self.process)
        if not self.distributed and launcher == (None, None, None):
            return self.shard
        if self.shard != "1/1":
            raise ValueError(
                f"--shard is {self.shard}, but processes that are joined divide the work "
                "themselves: leave one of them out"
            )
        from jaxlangnav.experiments.monte_carlo import join_devices

        process, count = join_devices(*launcher)
        return f"{process + 1}/{count}"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Summarize:
    """Print the tables of a sweep, with confidence intervals and paired tests.

    Examples:
      jaxlangnav summarize results
      jaxlangnav summarize results --out summary
      jaxlangnav summarize results --json
    """

    directory: tyro.conf.Positional[Path]
    """Folder that jaxlangnav sweep has written."""
    out: Folder = None
    """Where to write the tables (Markdown) and a figure of them (PNG, SVG)."""
    json: bool = False
    """Print one JSON document."""

    def run(self, output: Output) -> Document:
        """Summarise the folder."""
        check_folder("--out", self.out)
        from jaxlangnav.experiments.summary import render, summarize_directory

        document = summarize_directory(self.directory)
        for line in document["damaged"]:
            output.note(f"note: {line}; it is left out: make it again with sweep --resume")
        output.print(render(document))
        if self.out is None:
            return document
        files = [str(path) for path in self._write(document, self.out, output)]
        for path in files:
            output.print(f"Wrote {path}")
        return {**document, "written": files}

    def _write(self, document: Document, out: Path, output: Output) -> list[Path]:
        """Write the tables, and the figure if matplotlib is installed."""
        from jaxlangnav.experiments.summary import summary_markdown
        from jaxlangnav.inputs.atomic_files import write_text

        paths = [write_text(summary_markdown(document), out / "summary.md")]
        if importlib.util.find_spec("matplotlib") is None:
            output.note('note: no figure without matplotlib: pip install "jaxlangnav[viz]"')
            return paths
        from jaxlangnav.viz.rows import MAX_LINES, summary_figure, summary_lines
        from jaxlangnav.viz.style import save

        if len({setting for setting, _, _ in summary_lines(document)}) > MAX_LINES:
            output.note(f"note: no figure of more than {MAX_LINES} settings; the tables have all")
            return paths
        return [*paths, *save(summary_figure(document), out / "summary")]
