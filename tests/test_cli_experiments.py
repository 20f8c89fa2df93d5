"""``train``, ``evaluate``, ``reproduce``, ``sweep``, ``summarize``: documents and refusals."""

import json
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from jaxlangnav import cli
from jaxlangnav.grounding.weights import load, load_shipped

CORPUS_39 = str(resources.files("jaxlangnav.language") / "data" / "corpus39.jsonl")
ROW_KEYS = {
    "world", "range", "relation", "policy", "episodes", "success_rate", "success_ci",
    "distance_mean", "distance_sd", "known_distance_mean", "known_distance_sd", "spl",
    "overflows", "degenerate", "timeouts",
}  # fmt: skip


def document(words: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert cli.main([*words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_train_writes_weights_that_other_commands_take(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "new" / "weights.npz"
    report = document(["train", "behavior", "--corpus", CORPUS_39, "--out", str(file)], capsys)
    assert report["file"] == str(file)
    assert report["sentences"] == 39
    assert set(report["behavior"]) >= {"examples", "features", "train_s", "steps"}
    assert "annotation" not in report
    # The other model is the shipped one, unchanged.
    kept, shipped = load(file), load_shipped()
    assert kept.annotation.num_features == shipped.annotation.num_features
    assert kept.behavior.num_features == report["behavior"]["features"]
    grounded = document(
        ["ground", "go to the hydrant", "--world", "2H1C", "--weights", str(file)], capsys
    )
    assert grounded["behaviors"][0]["goal"]["object"] == "hydrant"


@pytest.mark.slow
def test_evaluate_gives_table_1(capsys: pytest.CaptureFixture[str]) -> None:
    found = document(["evaluate", "--splits", "2"], capsys)
    for model in ("annotation", "behavior"):
        assert found[model]["splits"] == 2
        assert 0 <= found[model]["accuracy_mean"] <= 100
        assert set(found[model]) >= {"accuracy_ci95", "train_s", "infer_s"}
    assert found["paper"]["annotation"]["accuracy_mean"] == 62.5


@pytest.mark.slow
def test_reproduce_table2_gives_the_seven_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = document(["reproduce", "table2", "--episodes", "3", "--out", str(tmp_path)], capsys)
    assert len(found["rows"]) == 7
    assert all(set(row) >= ROW_KEYS for row in found["rows"])
    assert {row["relation"] for row in found["rows"]} == {None, "behind", "nearest"}
    assert {row["policy"] for row in found["rows"]} == {"faithful"}
    assert found["paper"][0]["success_rate"] == 93.9
    assert found["wall_s"] > 0
    assert found["compile_s"] > 0
    assert (tmp_path / "table2.md").is_file()


@pytest.mark.slow
def test_a_sweep_runs_and_is_summarised(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    grid = tmp_path / "grid.toml"
    grid.write_text(
        'worlds = ["1H1C"]\ncommands = ["behind"]\nranges = [3, 5]\nepisodes = 3\n', "utf-8"
    )
    out = str(tmp_path / "results")
    ran = document(["sweep", str(grid), "--out", out], capsys)
    assert ran["episodes"] == 6
    assert document(["sweep", str(grid), "--out", out, "--resume"], capsys)["episodes"] == 0
    found = document(["summarize", out], capsys)
    assert found["episodes"] == 6
    assert [row["range"] for row in found["rows"]] == [3.0, 5.0]
    assert cli.main(["summarize", out]) == 0
    assert "1H1C" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["train", "grammar"], "grammar"),
        (["train", "behavior", "--corpus", "nowhere.jsonl"], "nowhere.jsonl"),
        (["train", "behavior", "--base", "nowhere.npz"], "nowhere.npz"),
        (["train", "behavior", "--out", "weights.txt"], "must end in .npz"),
        (["evaluate", "--splits", "1"], "--splits is 1"),
        (["evaluate", "--seed", "-1"], "--seed is -1"),
        (["reproduce", "table9"], "table9"),
        (["reproduce", "table2", "--episodes", "0"], "--episodes is 0"),
        (["reproduce", "table2", "--particles", "1"], "--particles is 1"),
        (["reproduce", "table2", "--policy", "infromed"], "informed"),
        (["reproduce", "table2", "--out", __file__], "is a file"),
        (["sweep", "nowhere.toml", "--out", "results"], "nowhere.toml: no such file"),
        (["sweep", "nowhere.toml"], "missing --out"),
        (["sweep", "nowhere.toml", "--out", __file__], "is a file"),
        (["summarize", "nowhere"], "nowhere holds no sweep"),
        (["ground", "go to the cone", "--weights", "nowhere.npz"], "nowhere.npz"),
    ],
)
def test_bad_input_is_one_line(
    words: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.splitlines()
    assert len(lines) == 1 + (words[0] == "train" and "--corpus" in words)
    assert expected in lines[-1]
