"""``jaxlangnav bench``: speed, as ratios against baselines in the same run."""

import dataclasses

from jaxlangnav.cli.output import Document, Output
from jaxlangnav.cli.runtime import keep_compiled_programs, progress_bar


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
        keep_compiled_programs()
        from jaxlangnav.speed.bench import render, run_bench, set_up, stages

        bench = set_up(is_quick=self.quick)
        with progress_bar("stages", len(stages(bench))) as advance:

            def tell(what: str, done: int) -> None:
                output.note(f"measuring {what}")
                advance(done)

            document = run_bench(bench, on_progress=tell)
        output.say(render(document))
        return document
