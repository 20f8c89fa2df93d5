"""``jaxlangnav bench``: speed, as ratios against baselines in the same run."""

import dataclasses
import importlib
import sys
from pathlib import Path
from typing import Any

import jaxlangnav
from jaxlangnav.cli.output import Document, Output, UsageError
from jaxlangnav.cli.runtime import keep_compiled_programs, progress_bar

FOLDER = Path(jaxlangnav.__file__).resolve().parents[1] / "benchmarks"
"""What measures speed stands beside the package in a checkout, and is not installed with it."""


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
        speed: Any = importlib.import_module("bench")
        keep_compiled_programs()
        bench = speed.set_up(is_quick=self.quick)
        with progress_bar("stages", len(speed.stages(bench))) as advance:

            def tell(what: str, done: int) -> None:
                output.note(f"measuring {what}")
                advance(done)

            document = speed.run_bench(bench, on_progress=tell)
        output.say(speed.render(document))
        return document
