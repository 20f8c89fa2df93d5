"""What is frozen in README, docs and notebooks is what the code as it is would print."""

import importlib
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parent.parent
AGES = json.loads((ROOT / "scripts" / "ages.json").read_text("utf-8"))


def script(name: str) -> ModuleType:
    """Import one of the scripts; they stand beside the package, not in it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [str(ROOT / "scripts"), *sys.path])
        return importlib.import_module(name)


ages, frozen, results_page = (script(name) for name in ("ages", "frozen", "results_page"))
SHOWN = [
    pytest.param(command, text, id=f"{page.name}-{command}")
    for page in frozen.pages()
    for command, text in frozen.shown(page)
]
CHEAP = [one for one in SHOWN if not str(one.values[0]).startswith("jaxlangnav follow")]
"""Those that compile nothing; test_cli_follow.py has the rest, where the engine is compiled."""


def test_every_frozen_file_has_an_age() -> None:
    pictures = {f"docs/{path.name}" for path in (ROOT / "docs").glob("*.png")}
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
