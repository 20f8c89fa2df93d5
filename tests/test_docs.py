"""The documentation is true: links lead somewhere, names exist, commands are understood."""

import importlib
import re
import shlex
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from jaxlangnav.cli.arguments import parse_arguments
from jaxlangnav.experiments.sweep_config import config_from_dict
from jaxlangnav.language.lexicon import read_lexicon
from jaxlangnav.world.files import world_from_dict

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"(?ms)^```(\w*)\n(.*?)^```")
LINK = re.compile(r"\]\(([^)\s]+)\)")
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


def commands() -> list[str]:
    lines = [
        line.removeprefix("$ ").strip()
        for page in PAGES
        for _, block in BLOCK.findall(page.read_text("utf-8"))
        for line in block.splitlines()
    ]
    return sorted({line for line in lines if line.startswith("jaxlangnav ")})


def test_there_are_commands() -> None:
    assert len(commands()) > 10


@pytest.mark.parametrize("line", commands())
def test_commands_are_understood(line: str) -> None:
    assert parse_arguments(shlex.split(line)[1:])


def test_files_in_the_text_are_accepted() -> None:
    text = (ROOT / "docs" / "how-to.md").read_text("utf-8")
    texts = [block for kind, block in BLOCK.findall(text) if kind == "toml"]
    world, _, grid = (tomllib.loads(block) for block in texts)
    base = resources.files("jaxlangnav.language").joinpath("data/lexicon.toml").read_text("utf-8")
    assert read_lexicon(base, texts[1]).type_names[-1] == "lamp"
    assert world_from_dict(world, file="yard.toml").name == "yard"
    grid["worlds"].remove("yard.toml")
    assert config_from_dict(grid).episodes == 200


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
