"""``jaxlangnav summarize``: tables of a sweep (section 4.2)."""

import dataclasses
from pathlib import Path

import tyro

from jaxlangnav.commands.output import Document, Output


@dataclasses.dataclass(frozen=True, kw_only=True)
class Summarize:
    """Print the tables of a sweep, with confidence intervals and paired tests.

    Examples:
      jaxlangnav summarize results
      jaxlangnav summarize results --json
    """

    directory: tyro.conf.Positional[Path]
    """Folder that jaxlangnav sweep has written."""
    json: bool = False
    """Print one JSON document."""

    def run(self, output: Output) -> Document:
        """Summarise the folder.

        Args:
            output: where the tables are printed.

        Returns:
            The document.

        Raises:
            ValueError: not the folder of a sweep.
        """
        from jaxlangnav.experiments.summary import render, summarize_directory

        document = summarize_directory(self.directory)
        output.say(render(document))
        return document
