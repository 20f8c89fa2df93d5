"""``jaxlangnav bench``: run-time benchmarks, as ratios to baselines in the same process."""

import dataclasses
import importlib
import sys
from pathlib import Path
from typing import Any

import jaxlangnav
from jaxlangnav.cli.output import Document, Output, UsageError
from jaxlangnav.cli.runtime import keep_compiled_programs, progress_bar

FOLDER = Path(jaxlangnav.__file__).resolve().parents[1] / "benchmarks"
"""Folder of the benchmarks; it exists in a checkout and is not installed."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Bench:
    """Measure speed, against the baselines, as ratios.

    Warm and cold apart, median of several; every baseline runs in the same process.

    Examples:
      jaxlangnav bench
      jaxlangnav bench --quick --json
    """

    quick: bool = False
    """Smaller sizes and fewer repetitions."""
    json: bool = False
    """Print one JSON document: machine, entries."""

    def run(self, output: Output) -> Document:
        """Run the benchmarks."""
        if not (FOLDER / "numpy_twin.py").is_file():
            raise UsageError(
                f"bench measures from a checkout, but {FOLDER} is not there: "
                "clone the repository and install it with pip install --editable"
            )
        sys.path.insert(0, str(FOLDER))
        benchmarks: Any = importlib.import_module("bench")
        keep_compiled_programs()
        bench = benchmarks.set_up(is_quick=self.quick)
        with progress_bar("stages", len(benchmarks.stages(bench))) as advance:

            def report(stage: str, num_done: int) -> None:
                output.note(f"measuring {stage}")
                advance(num_done)

            document = benchmarks.run_bench(bench, on_progress=report)
        output.print(benchmarks.render(document))
        return document
