"""Wheel and source archive, installed in fresh environments: code, weights, corpora and worlds."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build both, the wheel from the archive."""
    folder = tmp_path_factory.mktemp("built")
    build = [sys.executable, "-m", "build", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module", params=["*.whl", "*.tar.gz"])
def installed(request: pytest.FixtureRequest, built: Path) -> Path:
    """Install one into an environment of its own, what it depends on too."""
    (package,) = built.glob(request.param)
    python = built / f"environment-{package.suffix[1:]}" / "bin" / "python"
    subprocess.run([sys.executable, "-m", "venv", str(python.parent.parent)], check=True)
    install = [str(python), "-m", "pip", "install", "--quiet", "--constraint"]
    subprocess.run(
        [*install, str(ROOT / "constraints.txt"), f"{package}[viz]"],
        check=True,
        capture_output=True,
    )
    return python


def run(python: Path, *words: str) -> str:
    """Run Python outside the checkout."""
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [python, *words], cwd=python.parent, env=clean, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_what_is_built_holds_what_it_should(built: Path) -> None:
    names = [name for one in built.glob("*.whl") for name in zipfile.ZipFile(one).namelist()]
    assert "jaxlangnav/py.typed" in names
    assert not [name for name in names if name.startswith(("tests/", "docs/", "examples/"))]


def test_a_sentence_is_followed(installed: Path) -> None:
    assert str(ROOT) not in run(installed, "-c", "import jaxlangnav; print(jaxlangnav.__file__)")
    text = "go to the hydrant behind the cone"
    words = ["-m", "jaxlangnav", "follow", text, "--world", "yard", "--out", "pictures", "--json"]
    document = json.loads(run(installed, *words))
    assert document["success"]
    assert all((installed.parent / name).is_file() for name in document["pictures"])


def test_data_files_are_in_it(installed: Path) -> None:
    code = "from jaxlangnav.language.corpus import load_corpus; print(len(load_corpus('corpus39')))"
    assert run(installed, "-c", code).split() == ["39"]
