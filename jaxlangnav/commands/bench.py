"""``jaxlangnav bench``: speed, as ratios against baselines in the same run."""

import dataclasses

from jaxlangnav.commands.output import Document, Output


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
        """Run the benchmarks.

        Args:
            output: where the table is printed.

        Returns:
            ``machine`` and ``entries``.
        """
        from jaxlangnav.experiments.bench import render, run_bench

        document = run_bench(
            is_quick=self.quick, on_progress=lambda what: output.note(f"measuring {what}")
        )
        output.say(render(document))
        return document
