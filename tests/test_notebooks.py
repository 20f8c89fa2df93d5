"""The notebooks run from top to bottom, and what is shipped is what their sources say."""

import os
import subprocess
import sys
from pathlib import Path

import jupytext
import pytest

from notebooks import MAX_BYTES, cells, lacking, sources

ROOT = Path(__file__).parent.parent
SOURCES = sources()


def test_sources_and_notebooks_come_in_pairs() -> None:
    assert SOURCES
    notebooks = sorted((ROOT / "notebooks").glob("*.ipynb"))
    assert [path.stem for path in notebooks] == [path.stem for path in SOURCES]


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_notebook_is_made_from_its_source(path: Path) -> None:
    """If this fails: make notebooks."""
    pair = path.with_suffix(".ipynb")
    assert cells(pair) == cells(path)
    assert pair.stat().st_size <= MAX_BYTES
    code = [cell for cell in jupytext.read(pair).cells if cell.cell_type == "code"]
    outputs = [output for cell in code for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs), "without pictures"
    assert not any(output.output_type == "error" for output in outputs)


@pytest.mark.slow
@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_notebook_runs_from_top_to_bottom(path: Path, tmp_path: Path) -> None:
    """In a process of its own, with the compiled programs that the tests keep."""
    if missing := lacking(path):
        pytest.skip(missing)
    environment = os.environ | {
        "MPLBACKEND": "Agg",
        "JAX_PLATFORMS": "cpu",
        "JAX_COMPILATION_CACHE_DIR": str(ROOT / ".pytest_cache" / "jax"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
    }
    result = subprocess.run(
        [sys.executable, str(path)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert result.returncode == 0, result.stderr[-4000:]
    assert list(tmp_path.iterdir()) == [], "a notebook leaves files behind"
