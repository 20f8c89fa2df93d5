"""A lexicon file of one's own: types and synonyms by one line each, without code or training."""

import json
import os
import subprocess
import sys
from importlib import resources
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


def test_a_new_type_and_a_synonym_are_grounded_without_training(tmp_path: Path) -> None:
    path = tmp_path / "words.toml"
    path.write_text(OWN, "utf-8")
    assert not {"lorry", "teal", "lamp"} & load_lexicon().vocabulary
    said = "find the teal lorry behind the nearest lamp posts"
    done = subprocess.run(
        [sys.executable, "-m", "jaxlangnav", "ground", said, "--json"],
        env={**os.environ, OWN_LEXICON: str(path), "JAX_PLATFORMS": "cpu"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["unknown_words"] == []
    said = {(a["figure"], a["relation"], a["landmark"], a["superlative"]): a["probability"]
            for a in document["annotations"]}  # fmt: skip
    assert said.keys() == {("car", "behind", "lamp", False), ("lamp", "near", "robot", True)}
    assert min(said.values()) > 0.95


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[types]\nlamp = 'lamp'", r"\[types\] lamp must be a list"),
        ("[types]\nlamp = ['']", r"\[types\] lamp must be a list"),
        ("types = 3", "must be tables"),
        ("[types]\nlamp = ['pylon']", "'pylon' is a name of cone already"),
        ("[class.zork]\nplain = ['x']", r"\[class.zork\]: no such class"),
        ("[refused]\npath = ['x']", r"only \[types\] and \[class.X\]"),
        ("[types", "is no valid TOML"),
        ("[types]\nlamp = ['the']", "'the' has a meaning of its own"),
        ("[types]\nlamp = ['behind']", "'behind' has a meaning of its own"),
        ("[types]\nlamp = ['the cone']", "'the' has a meaning .* an end of a name"),
        ("[types]\nrobot = ['droid']", "'robot' has a meaning of its own"),
        ("[types]\nlamp = ['comma']", "'comma' has a meaning of its own"),
        ("[types]\nlamp = ['cones']", "'cones' is a name of cone already"),
        ("[types]\nlamp = ['a=b']", "'a=b' could not be read as a word"),
        ('[types]\nlamp = ["cone\'s"]', "could not be read as a word"),
        ('[types]\nlamp = ["a\\u001b[31m"]', r"control character U\+001B"),
        (f"[types]\nlamp = ['{'x' * 31}']", "has more than 30 letters"),
        (f"[types]\nlamp = ['{'x' * 5000}']", "has 5000 characters"),
        (f"[types]\nlamp = ['{'x ' * 9}']", "has more than 8 words"),
        ("[class.adj]\nplain = ['the']", "'the' has another meaning already"),
        ('[class.rel]\n"relation:left" = ["behind"]', "'behind' has another meaning"),
        ('[class.rel]\n"relation:sideways" = ["athwart"]', "no such sense"),
        ("[class.adj]\ntag = ['x']", "no such sense"),
        ('[class.rel]\n"a\\nb" = ["athwart"]', r"a\\nb: no such sense"),
        ('[class.rel]\n"relation:left" = ["*a *b"]', "more than one word marked"),
        (f"[types]\nlamp = {[f'w{i}' for i in range(2000)]}", "at most 1000 may be added"),
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


def test_own_lines_come_after_those_of_the_package() -> None:
    base = "[types]\ncone = ['cone']\n[class.adj]\ntag = 'JJ'\nplain = ['red']\n[tags]\n[refused]\n"
    lexicon = read_lexicon(
        base, "[types]\nLamp = ['Lamp']\ncone = ['Pylon']\n[class.adj]\nplain = ['teal']\n"
    )
    assert lexicon.type_names == ("cone", "lamp")
    assert lexicon.entries["type"]["pylons",].senses == (("type:cone",),)
    assert lexicon.entries["adj"]["teal",].tags == ("JJ",)


@pytest.mark.parametrize(
    "text",
    [
        "[types]\nsign = ['stop sign', 'road sign']",
        "[types]\npark = []",
        "[types]\nlamp = ['light', 'ﬂoor lamp', 'Straßenlaterne', 'лампа']",
        "[types]\ncone = ['cone', 'bollard']",
        "[types]\ndoor = ['front door', 'fire exit']",
        '[class.rel]\n"relation:behind" = ["in the *lee of", "overlooking"]',
        "[class.adj]\nplain = ['red', 'teal']",
    ],
)
def test_honest_words_are_taken(text: str) -> None:
    shipped = resources.files("jaxlangnav.language").joinpath("data/lexicon.toml")
    assert read_lexicon(shipped.read_text("utf-8"), text).type_names[0] == "hydrant"


def test_what_is_no_file_is_refused_by_name_and_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large").write_bytes(b"#" * 300_000)
    for path, says in (
        (tmp_path / "pipe", "is a pipe, not a regular file"),
        (tmp_path, "is a folder, not a regular file"),
        (tmp_path / "large", "more than 262,144 bytes"),
        (tmp_path / "nowhere.toml", r"nowhere\.toml"),
    ):
        monkeypatch.setenv(OWN_LEXICON, str(path))
        with pytest.raises(ValueError, match=says):
            load_lexicon.__wrapped__()
