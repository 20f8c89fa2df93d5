"""The command line's manners: help, one document, exit codes; what is parsed and grounded."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
import pytest
import tyro
from test_cli_hostile import document, refused

from jaxlangnav import __version__
from jaxlangnav.cli import SUMMARIES, main as cli
from jaxlangnav.cli.output import Output, UsageError, is_user_error, one_line, to_jsonable
from jaxlangnav.world import files

FAULTS = {
    "usage": UsageError("no such\n  sentence"),
    "file": FileNotFoundError(2, "No such file or directory", "world.toml"),
    "bug": KeyError("slot"),
    "stop": KeyboardInterrupt(),
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Echo:
    """Say a sentence again.

    Examples:
      jaxlangnav echo "hello"
    """

    text: tyro.conf.Positional[str]
    """The sentence."""
    times: int = 1
    """How often."""
    how: Literal["loud", "soft"] = "soft"
    """In which voice."""
    json: bool = False
    """Print one JSON document."""

    def run(self, output: Output) -> dict:
        if self.text == "numpy":
            np.zeros(3).reshape(2, 2)
        if self.text in FAULTS:
            raise FAULTS[self.text]
        print("a stray print")
        output.note("working")
        for _ in range(self.times):
            output.print(self.text)
        return {"text": self.text, "times": np.int64(self.times), "score": float("nan")}


@pytest.fixture
def echo(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SUMMARIES, "echo", "Say a sentence again.")
    monkeypatch.setitem(sys.modules, "jaxlangnav.cli.echo", SimpleNamespace(Echo=Echo))


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0
    told = capsys.readouterr().out
    assert all(name in told and line in told for name, line in SUMMARIES.items())


def test_nothing_typed_shows_help_and_fails_and_the_version_is_told(capsys) -> None:
    assert cli.main([]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "examples:" in captured.err
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"jaxlangnav {__version__}\n"


@pytest.mark.parametrize("name", sorted(SUMMARIES))
def test_every_command_has_help_with_examples(name, capsys):
    assert cli.main([name, "--help"]) == 0
    told = capsys.readouterr().out
    described = told.partition("╭")[0]
    assert max(len(line) for line in described.splitlines() if "jaxlangnav" not in line) <= 88
    assert f"usage: jaxlangnav {name}" in told
    assert f"\n  jaxlangnav {name}" in told
    assert "--json" in told


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["folow", "x"], 'unknown command "folow"; did you mean "follow"?'),
        (["zzz"], 'unknown command "zzz"; choose from follow, serve'),
        (["--json", "echo"], 'expected a command before "--json"'),
        (["echo", "x", "--tims", "2"], 'unknown option "--tims"; did you mean "--times"?'),
        (["echo", "x", "--times", "two"], '--times is "two", but must be a whole number'),
        (["echo", "x", "--times"], "--times needs a value"),
        (["echo", "x", "--how", "lowd"], 'must be one of loud, soft; did you mean "loud"?'),
        (["echo", "x", "--json=yes"], "--json takes no value"),
        (["echo"], "missing TEXT: The sentence"),
        (["echo", "go", "to", "it"], 'unexpected "to, it"; a sentence of several words goes in'),
        (["echo", "usage"], "no such sentence"),
        (["echo", "file"], "world.toml: No such file or directory"),
    ],
)
@pytest.mark.usefixtures("echo")
def test_bad_input_is_one_line_and_code_2(words, expected, capsys):
    assert expected in refused(words, capsys)


@pytest.mark.usefixtures("echo")
def test_a_fault_of_ours_is_one_line_and_code_1(capsys, monkeypatch):
    monkeypatch.delenv(cli.DEBUG, raising=False)
    assert cli.main(["echo", "bug"]) == 1
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert "internal error: KeyError" in captured.err
    # So is a ValueError of a library.
    assert cli.main(["echo", "numpy"]) == 1
    assert "internal error: ValueError: cannot reshape" in capsys.readouterr().err
    monkeypatch.setenv(cli.DEBUG, "1")
    with pytest.raises(KeyError):
        cli.main(["echo", "bug"])
    # The world files' own ValueError is a refusal.
    with pytest.raises(ValueError, match="unknown world") as caught:
        files.open_world("yrad")
    assert is_user_error(caught.value)
    # An interrupt is quiet.
    assert cli.main(["echo", "stop"]) == 130
    assert capsys.readouterr().err == "jaxlangnav: interrupted\n"


@pytest.mark.usefixtures("echo")
def test_json_is_one_document_and_nothing_else(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["echo", "hello", "--times", "2", "--json"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out) == {"text": "hello", "times": 2, "score": None}
    assert "a stray print" in captured.err
    assert "working" in captured.err
    # Without it people read the narrative.
    assert cli.main(["echo", "hello", "--times", "2"]) == 0
    assert capsys.readouterr().out == "a stray print\nhello\nhello\n"


def test_a_story_hangs_under_its_heads_on_a_terminal(capsys, monkeypatch):
    lines = ["You said: “go”.", f"[    0 ·  0.0 m] {'2.5 m word ' * 20}".rstrip()]
    Output(is_json=False).print_wrapped(lines)
    assert capsys.readouterr().out.splitlines() == lines
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "72")
    Output(is_json=False).print_wrapped(lines)
    told = capsys.readouterr().out.splitlines()
    assert max(map(len, told)) <= 72
    assert len(told) > 4
    assert all(line.startswith(" " * 17) for line in told[2:])
    assert not any(line.endswith("2.5") for line in told)
    assert " ".join(" ".join(told[1:]).split()) == " ".join(lines[1].split())
    Output(is_json=True).print_wrapped(lines)
    assert capsys.readouterr().out == ""


def test_to_json_turns_arrays_and_paths() -> None:
    value = {"a": jnp.arange(3), "b": (np.float32(0.5), True), 3: Path("x"), "c": float("inf")}
    assert to_jsonable(value) == {"a": [0, 1, 2], "b": [0.5, True], "3": "x", "c": None}
    json.dumps(to_jsonable(value), allow_nan=False)


def test_an_error_is_said_in_one_line() -> None:
    assert one_line(ValueError("a\n  b")) == "a b"
    assert one_line(ValueError()) == "ValueError"


@pytest.mark.parametrize("words", [["--help"], ["folow"], ["follow", "--help"], ["follow", "--x"]])
def test_help_and_errors_load_nothing_heavy(words: list[str]) -> None:
    code = f"import sys; from jaxlangnav.cli.main import main; main({words})"
    code += "; sys.exit(not {'jax', 'numpy'}.isdisjoint(sys.modules))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert result.returncode == 0, result.stderr


# ------------------------------------------- parse and ground: documents with the keys scripts read

COMMAND = "go to the hydrant behind the cone"


def labels(tree: dict[str, Any]) -> list[tuple[str, str]]:
    own = (tree["label"], " ".join(word["text"] for word in tree["words"]))
    return [own, *(one for child in tree["children"] for one in labels(child))]


def test_parse_gives_the_six_phrases(capsys: pytest.CaptureFixture[str]) -> None:
    parsed = document(["parse", COMMAND], capsys)
    assert parsed["instruction"] == COMMAND
    assert parsed["unknown_words"] == []
    assert labels(parsed["tree"]) == [
        ("VP", "go"), ("PP", "to"), ("NP", ""), ("NP", "the hydrant"), ("PP", "behind"),
        ("NP", "the cone"),
    ]  # fmt: skip
    assert set(parsed["tree"]["words"][0]) == {"text", "tag"}


def test_repairs_and_unknown_words_are_noted(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["parse", "go to the hyrdant"]) == 0
    assert 'note: "hyrdant" is read as "hydrant"' in capsys.readouterr().err
    assert cli.main(["parse", "go to the flurb", "--json"]) == 0
    captured = capsys.readouterr()
    assert '"flurb" (word 4) is not in the lexicon' in captured.err
    assert json.loads(captured.out)["unknown_words"]


def test_ground_gives_annotations_and_the_papers_graph(capsys: pytest.CaptureFixture[str]) -> None:
    grounded = document(["ground", COMMAND], capsys)
    probabilities = [said["probability"] for said in grounded["annotations"]]
    assert probabilities == sorted(probabilities, reverse=True)
    assert probabilities[0] > 0.5
    assert grounded["graph"]["annotation"] == {"phrases": 6, "factors": 2964, "variables": 5934}
    behavior = {"phrases": 6, "factors": 383, "variables": 772, "objects": 7}
    assert grounded["graph"]["behavior"] == behavior
    assert grounded["unknown_words"] == []
    assert "behaviors" not in grounded


def test_ground_in_a_world_finds_the_goal(capsys: pytest.CaptureFixture[str]) -> None:
    grounded = document(["ground", COMMAND, "--world", "2H1C", "--seed", "3"], capsys)
    assert grounded["world"] == "2H1C"
    assert [one["type"] for one in grounded["objects"]] == ["hydrant", "hydrant", "cone"]
    assert grounded["graph"]["behavior"]["objects"] == 3
    best = grounded["behaviors"][0]
    assert (best["action"], best["mode"]) == ("navigate", "normal")
    assert (best["goal"]["region"], best["goal"]["object"]) == ("at", "hydrant")
    # Seen from the start, the goal stands beyond the cone and about in line with it.
    goal, cone = np.array(best["goal"]["position"]), np.array(grounded["objects"][2]["position"])
    assert np.linalg.norm(goal) > np.linalg.norm(cone)
    assert goal @ cone > 0.9 * np.linalg.norm(goal) * np.linalg.norm(cone)
    assert sum(one["probability"] for one in grounded["behaviors"]) <= 1.0 + 1e-5


def test_ground_draws_the_factor_graph(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    grounded = document(["ground", "go to the cone", "--out", str(tmp_path)], capsys)
    assert grounded["pictures"] == [str(tmp_path / "graph.png"), str(tmp_path / "graph.svg")]
    assert all(Path(name).stat().st_size > 1000 for name in grounded["pictures"])
