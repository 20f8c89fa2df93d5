"""``jaxlangnav summarize``: tables of a sweep (section 4.2)."""

import dataclasses
import importlib.util
from pathlib import Path

import tyro

from jaxlangnav.cli.checks import Folder, check_folder
from jaxlangnav.cli.output import Document, Output


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
        output.say(render(document))
        if self.out is None:
            return document
        files = [str(path) for path in self._write(document, self.out, output)]
        for path in files:
            output.say(f"Wrote {path}")
        return {**document, "written": files}

    def _write(self, document: Document, out: Path, output: Output) -> list[Path]:
        """Write the tables, and the figure where there is something to draw with."""
        from jaxlangnav.experiments.summary import summary_markdown
        from jaxlangnav.inputs.whole_files import write_text

        paths = [write_text(summary_markdown(dict(document)), out / "summary.md")]
        if importlib.util.find_spec("matplotlib") is None:
            output.note('note: no figure without matplotlib: pip install "jaxlangnav[viz]"')
            return paths
        from jaxlangnav.viz.rows import MOST_LINES, summary_figure, summary_lines
        from jaxlangnav.viz.style import save

        if len({setting for setting, _, _ in summary_lines(document)}) > MOST_LINES:
            output.note(f"note: no figure of more than {MOST_LINES} settings; the tables have all")
            return paths
        return [*paths, *save(summary_figure(document), out / "summary")]
