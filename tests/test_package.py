"""The package as a user gets it: public names, version, lightness."""

import importlib
import importlib.metadata
import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import jaxlangnav
from jaxlangnav.inputs.old_names import MOVED, RENAMED

ROOT = Path(__file__).parent.parent


def project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


def test_every_mutant_changes_one_line_that_is_there() -> None:
    for mutant in tomllib.loads((ROOT / "scripts/mutants.toml").read_text("utf-8"))["mutant"]:
        source = (ROOT / "jaxlangnav" / mutant["file"]).read_text("utf-8")
        assert source.count(mutant["before"]) == 1, mutant["name"]


def test_version_is_the_installed_one() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+(\.?(dev|a|b|rc)\d+)?", jaxlangnav.__version__)
    assert importlib.metadata.version("jaxlangnav") == jaxlangnav.__version__


def test_citation_names_the_version() -> None:
    assert f"version: {jaxlangnav.__version__}" in (ROOT / "CITATION.cff").read_text("utf-8")


@pytest.mark.parametrize("name", sorted(jaxlangnav.__all__))
def test_public_name_exists_and_is_documented(name: str) -> None:
    value = getattr(jaxlangnav, name)
    assert name in dir(jaxlangnav)
    assert name == "__version__" or value.__doc__


def test_unknown_name_is_an_attribute_error() -> None:
    name = "Navigater"
    with pytest.raises(AttributeError, match=f"no attribute '{name}'"):
        getattr(jaxlangnav, name)


@pytest.mark.parametrize("old", MOVED)
@pytest.mark.filterwarnings("ignore:jaxlangnav")  # of the package that it stood in
def test_a_module_that_has_moved_is_found_by_its_old_name(old: str) -> None:
    sys.modules.pop(f"jaxlangnav.{old}", None)
    with pytest.warns(DeprecationWarning, match=f"{old} is now jaxlangnav.{MOVED[old]}"):
        found = importlib.import_module(f"jaxlangnav.{old}")
    new = importlib.import_module(f"jaxlangnav.{MOVED[old]}")
    assert all(getattr(found, name) is one for name, one in vars(new).items() if name[:2] != "__")
    assert all(vars(found)[name] is vars(new)[now] for name, now in RENAMED.get(old, {}).items())


def test_import_is_light() -> None:
    code = "import sys, jaxlangnav, jaxlangnav.cli.main; print('jax' in sys.modules)"
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "False"


def test_every_dependency_has_a_floor_and_no_cap() -> None:
    extras = project()["optional-dependencies"].values()
    for requirement in [*project()["dependencies"], *(one for extra in extras for one in extra)]:
        assert re.fullmatch(r"[a-z0-9_-]+(\[[a-z0-9,]+\])?>=[0-9.]+(,!=[0-9.]+)*", requirement)


def test_constraints_satisfy_the_floors() -> None:
    pinned = re.findall(r"(?m)^([a-z0-9-]+)==", (ROOT / "constraints.txt").read_text("utf-8"))
    for requirement in project()["dependencies"]:
        assert re.split(r"[\[>]", requirement)[0] in pinned
