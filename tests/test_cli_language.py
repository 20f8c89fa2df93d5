"""``parse`` and ``ground``: documents with the keys scripts read, and clear refusals."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_cli_hostile import document

from jaxlangnav.cli import main as cli

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


def test_parse_draws_the_tree_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["parse", COMMAND]) == 0
    drawn = capsys.readouterr().out.splitlines()
    assert drawn[0] == "VP go/VB"
    assert drawn[-1].endswith("NP the/DT cone/NN")


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
