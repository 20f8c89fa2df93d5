"""The files of an experiment: episodes, table, document, manifest; each whole or not at all."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxlangnav.experiments.archive import manifest, write_manifest, write_table, write_text

_RESULTS = ("rows", "paper", "bounds", "wall_s", "compile_s", "files")


def write_report(
    folder: Path,
    name: str,
    document: Mapping[str, Any],
    columns: Mapping[str, Any],
    text: str,
    models: Any,
) -> list[Path]:
    """Write an experiment's files.

    Args:
        folder: where; made if it is not there.
        name: of the experiment; every file's name begins with it.
        document: what the experiment found; its settings go into the manifest.
        columns: one entry per episode.
        text: the Markdown table.
        models: the trained weights, for their hash.

    Returns:
        The files' paths.
    """
    settings = {key: value for key, value in document.items() if key not in _RESULTS}
    results = {key: value for key, value in document.items() if key != "files"}
    return [
        write_table(columns, folder / f"{name}_episodes.parquet"),
        write_text(text, folder / f"{name}.md"),
        write_manifest(results, folder / f"{name}.json"),
        write_manifest(manifest(settings, models=models), folder / f"{name}_manifest.json"),
    ]
