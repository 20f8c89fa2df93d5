"""The documentation is true: links, names and commands; what is frozen is what is printed."""

import importlib
import json
import re
import runpy
import shlex
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import ages
import frozen
import numpy as np
import pytest
import results_page

from jaxlangnav.cli.main import parse_arguments
from jaxlangnav.experiments.sweep_config import config_from_dict
from jaxlangnav.language.lexicon import read_lexicon
from jaxlangnav.world.files import world_from_dict

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"(?ms)^```(\w*)\n(.*?)^```")
LINK = re.compile(r"\]\(([^)\s]+)\)")
IMPORT = re.compile(r"(?m)^from (jaxlangnav[\w.]*) import ([\w, ]+)$")
NAME = re.compile(r"\]\[(jaxlangnav[\w.]+)\]|^::: (jaxlangnav[\w.]+)$", re.MULTILINE)


def anchors(page: Path) -> set[str]:
    headings = re.findall(r"(?m)^#+ (.*)$", page.read_text("utf-8"))
    return {
        re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", heading.lower()).strip())
        for heading in headings
    }


def find(name: str) -> Any:
    """Import the longest prefix that is a module and take attributes from there."""
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for part in parts[cut:]:
            found = getattr(found, part)
        return found
    raise ModuleNotFoundError(name)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_and_names_lead_somewhere(page: Path) -> None:
    text = page.read_text("utf-8")
    for link in LINK.findall(BLOCK.sub("", text)):
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link
    for names in NAME.findall(text):
        assert find(names[0] or names[1]) is not None
    for module, names in IMPORT.findall(text):
        for name in names.split(","):
            assert find(f"{module}.{name.strip()}") is not None


def commands() -> list[str]:
    lines = [
        line.removeprefix("$ ").strip()
        for page in PAGES
        for _, block in BLOCK.findall(page.read_text("utf-8"))
        for line in block.splitlines()
    ]
    return sorted({line for line in lines if line.startswith("jaxlangnav ")})


@pytest.mark.parametrize("line", commands())
def test_commands_are_understood(line: str) -> None:
    assert parse_arguments(shlex.split(line)[1:])


def test_files_in_the_text_are_accepted() -> None:
    tables = {}
    for page in ("start", "language", "experiments"):
        blocks = BLOCK.findall((ROOT / "docs" / f"{page}.md").read_text("utf-8"))
        (tables[page],) = (block for kind, block in blocks if kind == "toml")
    base = resources.files("jaxlangnav.language").joinpath("data/lexicon.toml").read_text("utf-8")
    assert read_lexicon(base, tables["language"]).type_names[-1] == "lamp"
    assert world_from_dict(tomllib.loads(tables["start"]), file="yard.toml").name == "yard"
    grid = tomllib.loads(tables["experiments"])
    grid["worlds"].remove("yard.toml")
    assert config_from_dict(grid).episodes == 200


def test_documents_stay_short() -> None:
    words = {page: len(page.read_text("utf-8").split()) for page in PAGES}
    assert len(commands()) > 10
    assert words.pop(ROOT / "README.md") <= 700
    assert sum(number for page, number in words.items() if "docs" in page.parts) <= 14_000
    assert (ROOT / "CHANGELOG.md").read_text("utf-8").count("\n") <= 60


def test_every_page_is_in_the_menu() -> None:
    menu = (ROOT / "mkdocs.yml").read_text("utf-8")
    for page in sorted((ROOT / "docs").rglob("*.md")):
        assert str(page.relative_to(ROOT / "docs")) in menu


def test_stylesheets_are_there() -> None:
    """MkDocs says nothing of one that is missing, and the site cuts code and tables off."""
    menu = (ROOT / "mkdocs.yml").read_text("utf-8")
    sheets = re.findall(r"[\w/]+\.css", menu)
    assert sheets
    assert all((ROOT / "docs" / sheet).is_file() for sheet in sheets)


# ---------------------------------------------------------------- what is frozen

AGES = json.loads((ROOT / "scripts" / "ages.json").read_text("utf-8"))
SHOWN = [
    pytest.param(command, text, id=f"{page.name}-{command}")
    for page in frozen.pages()
    for command, text in frozen.shown(page)
]
CHEAP = [one for one in SHOWN if not str(one.values[0]).startswith("jaxlangnav follow")]
"""Those that compile nothing; test_cli_follow.py has the rest, where the engine is compiled."""


def test_every_frozen_file_has_an_age() -> None:
    pictures = {f"docs/{path.name}" for path in (ROOT / "docs").glob("*.[gp][in][fg]")}
    of_results = {f"docs/{name}.png" for name in results_page.PICTURES}
    notebooks = {f"notebooks/{path.name}" for path in (ROOT / "notebooks").glob("*.ipynb")}
    assert set(AGES) == notebooks | (pictures - of_results) | {"docs/results.md"}
    assert of_results <= pictures


@pytest.mark.parametrize("name", AGES)
def test_nothing_frozen_is_older_than_the_results(name: str) -> None:
    """If this fails: make frozen (or say in ages.json what the page waits for)."""
    waits = AGES[name].get("waits")
    if waits and not ages.is_current(ROOT / name):
        pytest.xfail(f"{name} is of an older engine and waits for {waits}")
    assert ages.is_current(ROOT / name)
    assert not waits, f"{name} waits for nothing any more: take the entry out of ages.json"


@pytest.mark.parametrize(("command", "text"), CHEAP)
def test_what_a_page_shows_is_what_is_printed(command: str, text: str, tmp_path: Path) -> None:
    """If this fails: make frozen."""
    assert frozen.printed(command, tmp_path) == text


def test_there_are_shown_commands() -> None:
    assert CHEAP
    assert len(SHOWN) > len(CHEAP)


def test_the_readme_has_the_figures_of_the_results_page() -> None:
    """If this fails: make frozen."""
    table = frozen.short_table((ROOT / "docs" / "results.md").read_text("utf-8"))
    assert table.count("\n") == 9
    assert table in (ROOT / "README.md").read_text("utf-8")


def test_only_what_changes_results_makes_old(tmp_path: Path) -> None:
    weights = tmp_path / "jaxlangnav" / "grounding" / "data" / "weights.npz"
    weights.parent.mkdir(parents=True)
    weights.write_bytes(b"one")
    log = tmp_path / "CHANGELOG.md"

    def engine(text: str) -> str:
        log.write_text(text, "utf-8")
        return ages.engine(tmp_path)

    first, second = "- **results** One,\n  two.\n", "- Three. **results** Four.\n"
    whole = engine(f"{first}- Five.\n{second}")
    assert engine(f"{second}- Six.\n{first}") == whole
    assert engine("- **results** One, two.\n" + second) == whole
    assert engine(first) != whole
    weights.write_bytes(b"other")
    assert engine(f"{first}{second}") != whole


# ----------------------------------------------------------- the examples run, and do what they say

EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.mark.slow
def test_own_world_ends_at_the_hydrant(capsys: pytest.CaptureFixture[str]) -> None:
    example = runpy.run_path(str(EXAMPLES / "own_world.py"))
    end = example["main"]("go to the hydrant behind the cone")
    assert np.linalg.norm(end - example["OBJECTS"]["hydrant"]) <= 1.5
    assert "arrived at" in capsys.readouterr().out
    # Other sentences, the same compiled program and the same world.
    example["main"]("go to the tree", "go to the bench")
    told = capsys.readouterr().out
    assert "arrived at" in told
    assert "never seen: bench" in told


@pytest.mark.slow
def test_a_network_is_trained_and_stands_beside_the_policies() -> None:
    found = runpy.run_path(str(EXAMPLES / "trained_policy.py"))["main"]("2")
    assert all(row.success_rate > 95.0 for row in found.values())
    assert abs(found["learned"].distance_mean - found["faithful"].distance_mean) < 2.0


@pytest.mark.slow
def test_agents_are_compared_on_the_same_worlds() -> None:
    found = runpy.run_path(str(EXAMPLES / "agents.py"))["main"]("0.2")
    rates = {name.split(",")[0]: rate for name, (rate, metres) in found.items()}
    assert rates["random"] < 10.0 < 40.0 < rates["PPO"]
    assert min(rates[name] for name in ("scripted", "faithful", "informed")) > 95.0


def test_own_world_is_short() -> None:
    """The promise is some thirty lines of program."""
    code = (EXAMPLES / "own_world.py").read_text("utf-8").split("def main")[1].splitlines()
    assert len([line for line in code if line.strip()]) <= 30
