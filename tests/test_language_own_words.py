"""A lexicon file of one's own: types and synonyms by one line each, without code or training."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from jaxlangnav.language.lexicon import OWN_LEXICON, load_lexicon, read_lexicon

OWN = """
[types]
lamp = ["lamp post", "street lamp", "lantern"]
car = ["truck", "lorry"]
[class.adj]
plain = ["teal"]
"""


def run(path: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the command line as a user does, in a process of its own."""
    environment = {**os.environ, OWN_LEXICON: str(path), "JAX_PLATFORMS": "cpu"}
    return subprocess.run(
        [sys.executable, "-m", "jaxlangnav", *words],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_a_new_type_and_a_synonym_are_grounded_without_training(tmp_path: Path) -> None:
    path = tmp_path / "words.toml"
    path.write_text(OWN, "utf-8")
    done = run(path, "ground", "find the teal lorry behind the nearest lamp posts", "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["unknown_words"] == []
    said = {(a["figure"], a["relation"], a["landmark"], a["superlative"]): a["probability"]
            for a in document["annotations"]}  # fmt: skip
    assert said.keys() == {("car", "behind", "lamp", False), ("lamp", "near", "robot", True)}
    assert min(said.values()) > 0.95


def test_without_the_file_the_words_are_unknown(tmp_path: Path) -> None:
    path = tmp_path / "words.toml"
    path.write_text("", "utf-8")
    done = run(path, "ground", "find the lorry", "--json")
    assert done.returncode == 2
    assert "'lorry'" in done.stderr


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[types]\nlamp = 'lamp'", r"\[types\] lamp must be a list"),
        ("[types]\nlamp = ['']", r"\[types\] lamp must be a list"),
        ("types = 3", "must be tables"),
        ("[class]\nadj = 3", "must be tables"),
        ("[types]\nlamp = ['pylon']", "'pylon' is a name of cone already"),
        ("[class.zork]\nplain = ['x']", r"\[class.zork\]: no such class"),
        ("[refused]\npath = ['x']", r"only \[types\] and \[class.X\]"),
        ("[types", "Expected"),
    ],
)
def test_a_faulty_file_is_named(
    text: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "words.toml"
    path.write_text(text, "utf-8")
    monkeypatch.setenv(OWN_LEXICON, str(path))
    with pytest.raises(ValueError, match=says) as error:
        load_lexicon.__wrapped__()
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_a_missing_file_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(OWN_LEXICON, str(tmp_path / "nowhere.toml"))
    with pytest.raises(ValueError, match=r"nowhere\.toml"):
        load_lexicon.__wrapped__()


def test_own_lines_come_after_those_of_the_package() -> None:
    base = "[types]\ncone = ['cone']\n[class.adj]\ntag = 'JJ'\nplain = ['red']\n[tags]\n[refused]\n"
    lexicon = read_lexicon(
        base, "[types]\nLamp = ['Lamp']\ncone = ['Pylon']\n[class.adj]\nplain = ['teal']\n"
    )
    assert lexicon.type_names == ("cone", "lamp")
    assert lexicon.entries["type"]["pylons",].senses == (("type:cone",),)
    assert lexicon.entries["adj"]["teal",].tags == ("JJ",)
