"""The wheel works outside the checkout: code, weights, corpora, worlds and pages are in it."""

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
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel and install it, alone, into a folder."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    wheel = next(folder.glob("jaxlangnav-*.whl"))
    target = folder / "site"
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target"]
    subprocess.run([*install, str(target), str(wheel)], check=True, capture_output=True)
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    assert "jaxlangnav/py.typed" in names
    assert not [name for name in names if name.startswith(("tests/", "docs/", "examples/"))]
    return target


def run(site: Path, *words: str) -> str:
    """Run Python outside the checkout, the installed wheel first on its path."""
    done = subprocess.run(
        [sys.executable, *words],
        cwd=site.parent,
        env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_wheel_is_what_runs(site: Path) -> None:
    where = run(site, "-c", "import jaxlangnav; print(jaxlangnav.__file__)")
    assert where.strip() == str(site / "jaxlangnav" / "__init__.py")


def test_data_files_are_in_it(site: Path) -> None:
    code = (
        "from jaxlangnav.grounding.form import annotation_schema;"
        "from jaxlangnav.language.corpus import load_corpus;"
        "from jaxlangnav.world.files import open_world, shipped_worlds;"
        "print(annotation_schema()['type'], len(load_corpus('corpus39')));"
        "print(*[open_world(name).name for name in shipped_worlds()])"
    )
    worlds = ["empty-corner", "figure1", "figure4", "street", "yard"]
    assert run(site, "-c", code).split() == ["object", "39", *worlds]


def test_a_sentence_is_followed(site: Path) -> None:
    text = "go to the hydrant behind the cone"
    words = ["-m", "jaxlangnav", "follow", text, "--world", "yard", "--out", "pictures", "--json"]
    document = json.loads(run(site, *words))
    assert document["success"]
    assert all((site.parent / name).is_file() for name in document["pictures"])
