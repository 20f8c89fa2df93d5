"""Run the sources in ``notebooks/*.py`` and write the executed ``.ipynb`` files.

    python scripts/notebooks.py                     # run those that are old
    python scripts/notebooks.py --all               # run all of them

The ``.py`` files (jupytext's percent format) are the truth; the ``.ipynb`` files are made from
them, with their pictures, so that a reader of the repository sees what a notebook shows without
running it. Old is a notebook whose source has changed, or that an engine of other results has made
(``ages.py``); ``make frozen`` runs them with all else that is frozen. Pictures are reduced to a
palette, which keeps a notebook well below ``MAX_BYTES``.
"""

import argparse
import base64
import importlib
import io
import sys
import time
from pathlib import Path
from typing import Any

import ages
import jupytext
import nbformat

FOLDER = Path(__file__).resolve().parent.parent / "notebooks"
MAX_BYTES = 1_500_000
"""Largest executed notebook; the repository is to stay lean."""
_TIMEOUT = 600
_NUM_COLORS = 255


def sources(folder: Path = FOLDER) -> list[Path]:
    """List the sources of the notebooks."""
    return sorted(folder.glob("*.py"))


def cells(path: Path) -> list[tuple[str, str]]:
    """Read the kind and the text of every cell of a source or a notebook."""
    notebook = jupytext.read(path)
    return [(cell.cell_type, cell.source.rstrip()) for cell in notebook.cells]


def is_current(path: Path) -> bool:
    """Test whether a source's notebook has the same cells, run by the current engine."""
    pair = path.with_suffix(".ipynb")
    return pair.exists() and cells(pair) == cells(path) and ages.is_current(pair)


def lacking(path: Path) -> str:
    """Describe why a source cannot be run here, else "": robots need an extra and EGL."""
    if "check_libraries()" not in path.read_text("utf-8"):
        return ""
    from jaxlangnav.robots.libraries import check_libraries

    try:
        check_libraries()
    except ValueError as error:
        return str(error)
    return ""


def reduce_picture(picture: str) -> str:
    """Reduce a PNG to a palette; base64 in and out."""
    from PIL import Image

    image = Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")
    out = io.BytesIO()
    image.quantize(_NUM_COLORS, dither=Image.Dither.NONE).save(out, "PNG", optimize=True)
    return base64.b64encode(out.getvalue()).decode("ascii")


def tidy(notebook: Any) -> None:
    """Remove metadata that varies between runs, and reduce the pictures."""
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
        "jupytext": {"formats": "py:percent,ipynb"},
    }
    for index, cell in enumerate(notebook.cells):
        cell["id"], cell["metadata"] = f"cell-{index:02d}", {}
        if "outputs" in cell:
            cell["outputs"] = [item for item in cell["outputs"] if not _is_alarm(item)]
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if "image/png" in data:
                data["image/png"] = reduce_picture(data["image/png"])
                data.pop("text/plain", None)
                output["metadata"] = {}


def _is_alarm(output: Any) -> bool:
    """Test whether an output is XLA's warning of a slow compilation."""
    return output.get("name") == "stderr" and "slow_operation_alarm" in output["text"]


def build(path: Path) -> Path:
    """Run a source in Jupyter and write its notebook.

    Args:
        path: the ``.py`` file.

    Returns:
        The ``.ipynb`` file.

    Raises:
        ValueError: the notebook is larger than ``MAX_BYTES``.
        CellExecutionError: a cell has failed.
    """
    nbclient = importlib.import_module("nbclient")
    notebook = jupytext.read(path)
    resources = {"metadata": {"path": str(path.parent)}}
    client = nbclient.NotebookClient(
        notebook, timeout=_TIMEOUT, kernel_name="python3", resources=resources, record_timing=False
    )
    client.execute()
    tidy(notebook)
    text = nbformat.writes(notebook) + "\n"
    if len(text) > MAX_BYTES:
        raise ValueError(f"{path.name}: {len(text)} bytes executed, but at most {MAX_BYTES}")
    pair = path.with_suffix(".ipynb")
    pair.write_text(text, "utf-8")
    ages.record(pair)
    return pair


def main() -> int:
    """Run the notebooks given on the command line."""
    parser = argparse.ArgumentParser(description="Run the notebooks and write them with pictures.")
    parser.add_argument("names", nargs="*", help="notebooks; all by default")
    parser.add_argument("--all", action="store_true", help="also those that are not old")
    arguments = parser.parse_args()
    known = {path.stem: path for path in sources()}
    if unknown := [name for name in arguments.names if name not in known]:
        print(f'no notebook "{unknown[0]}": choose from {", ".join(known)}', file=sys.stderr)
        return 2
    for path in [known[name] for name in arguments.names] or list(known.values()):
        begin, why = time.perf_counter(), lacking(path)
        if why:
            print(f"{path.stem}: left as it is: {why}")
        elif arguments.all or arguments.names or not is_current(path):
            size = build(path).stat().st_size
            print(f"{path.stem}: {size / 1000:.0f} kB, {time.perf_counter() - begin:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
