"""``train``, ``evaluate``, ``reproduce``, ``sweep``, ``summarize``: documents and refusals."""

import json
from importlib import resources
from pathlib import Path

import pytest
from test_cli_hostile import document

from jaxlangnav.cli import main as cli, reproduction
from jaxlangnav.grounding.weights import load, load_shipped

CORPUS_39 = str(resources.files("jaxlangnav.language") / "data" / "corpus39.jsonl")
ROW_KEYS = {
    "world", "range", "relation", "policy", "episodes", "success_rate", "success_ci",
    "distance_mean", "distance_sd", "known_distance_mean", "known_distance_sd", "spl",
    "overflows", "degenerate", "contradictions", "faults", "timeouts", "not_found",
}  # fmt: skip


@pytest.mark.slow
def test_train_writes_weights_that_other_commands_take(tmp_path, capsys):
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
    words = ["ground", "go to the hydrant", "--world", "2H1C", "--weights", str(file)]
    grounded = document(words, capsys)
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
def test_reproduce_table2_judges_beliefs(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["reproduce", "table2", "--episodes", "3", "--policy", "faithful"]
    found = document([*words, "--params.planner.discount", "0.7"], capsys)
    for row in found["rows"]:
        assert 0 <= row["coverage90"] <= 100
        assert row["ece"] is None or 0 <= row["ece"] <= 1
        assert row["brier"] is None or 0 <= row["brier"] <= 1
    panels = reproduction.reliability_panels(found)
    assert set(panels) == {"faithful"}
    assert "“… behind the cone”" in panels["faithful"]
    judged = sum(row["calibration_events"] for row in found["rows"])
    drawn = sum(float(curve[4].sum()) for curve in panels["faithful"].values())
    assert drawn == pytest.approx(judged)


@pytest.mark.slow
def test_reproduce_table2_takes_the_detector_and_the_odometry(tmp_path, capsys):
    words = ["reproduce", "table2", "--episodes", "8", "--policy", "frontier,known"]
    usual = document([*words, "--out", str(tmp_path)], capsys)
    assert len(usual["rows"]) == 7 * 2
    assert all(set(row) >= ROW_KEYS for row in usual["rows"])
    assert {row["relation"] for row in usual["rows"]} == {None, "behind", "nearest"}
    assert usual["paper"][0]["success_rate"] == 93.9
    assert len(usual["bounds"]) == 7
    assert "| 2H1C | 3 | null | limit | ≤ 50 |" in (tmp_path / "table2.md").read_text("utf-8")
    assert all(Path(name).stat().st_size > 0 for name in usual["files"])
    worse = ["--sensor.field-of-view", "90 deg", "--sensor.detection-probability", "60 %"]
    other = document([*words, *worse, "--motion.odometry-noise", "0"], capsys)
    noise = other["noise"]
    assert noise["field_of_view"] == pytest.approx(1.5708, abs=1e-4)
    assert (noise["detection_probability"], noise["odometry_noise"]) == (0.6, 0.0)
    assert noise["detection_noise"] == usual["noise"]["detection_noise"]
    ways = [[row["distance_mean"] for row in found["rows"]] for found in (usual, other)]
    # Who sees a quarter as much and forgets some of it searches longer; the rows' ranges stay.
    assert sum(ways[1][:7]) > 1.2 * sum(ways[0][:7])
    assert [row["range"] for row in other["rows"]] == [row["range"] for row in usual["rows"]]
    # The known map needs no detector; without odometry noise it goes straight, to a centimetre.
    for row, noisy in zip(other["rows"][7:], usual["rows"][7:], strict=True):
        assert row["distance_mean"] == pytest.approx(row["known_distance_mean"], abs=0.01)
        assert row["distance_mean"] != noisy["distance_mean"]


def test_reproduce_table2_has_rows_and_ranges_that_the_paper_lacks(tmp_path, capsys):
    words = ["reproduce", "table2", "--episodes", "2", "--policy", "known", "--extra"]
    found = document([*words, "--ranges", "10, 200 cm", "--out", str(tmp_path)], capsys)
    rows = [(row["world"], row["relation"], row["range"]) for row in found["rows"]]
    assert rows[:2] == [("1H1C", None, 2.0), ("1H1C", None, 10.0)]
    assert len(rows) == 2 * 15
    extra = {world: {one for name, one, _ in rows if name == world} for world, _, _ in rows[14:]}
    every = {None, "behind", "nearest"}
    assert extra == {"2H2C": every, "1H3C": {None, "behind"}, "3H1C": every}
    limits = {(one["world"], one["relation"]): one["success"] for one in found["bounds"]}
    assert limits["3H1C", None] == pytest.approx(100 / 3)
    # At another range than the paper's there is nothing to set beside.
    assert found["paper"] == []
    assert "Success nowhere falls" in (tmp_path / "table2.md").read_text("utf-8")
    manifest = json.loads((tmp_path / "table2_manifest.json").read_text("utf-8"))
    assert manifest["settings"]["noise"]["step_length"] == 1.0


def test_reproduce_fig5_without_the_navigator(tmp_path, capsys):
    words = ["reproduce", "fig5", "--episodes", "2", "--policy", "known,frontier"]
    found = document([*words, "--out", str(tmp_path)], capsys)
    assert sorted({row["range"] for row in found["rows"]}) == [2, 3, 5, 10, 15, 20]
    assert {row["relation"] for row in found["rows"]} == {"behind", "nearest"}
    assert (tmp_path / "figure5.svg").is_file()
    assert "falls" in found


@pytest.mark.slow
def test_reproduce_fig4_tells_where_the_goal_is_believed_to_be(tmp_path, capsys):
    # The policy and size whose program other tests compile too.
    words = ["reproduce", "fig4", "--policy", "informed", "--particles", "64"]
    found = document([*words, "--out", str(tmp_path)], capsys)
    assert (found["policy"], found["world"], found["num_particles"]) == ("informed", "figure4", 64)
    assert found["success"]
    first, last = found["moments"][0], found["moments"][-1]
    # Two cones in view: the hydrant may be behind either; in the end it has been seen.
    assert first["event"] == "discovers two cones"
    assert min(first["unseen_left"], first["unseen_right"]) > 0.2
    assert last["goal_seen"] > 0.9
    names = {Path(name).name for name in found["files"]}
    ends = ".png", ".svg", ".html", ".md", "_manifest.json"
    assert names == {f"figure4{end}" for end in ends}
    assert {path.name for path in tmp_path.iterdir()} == names


def test_reproduce_fig3_counts_the_paper_s_graph(capsys: pytest.CaptureFixture[str]) -> None:
    found = document(["reproduce", "fig3"], capsys)
    for kind, printed in found["paper"].items():
        assert {name: found["graph"][kind][name] for name in printed} == printed


def test_all_writes_one_page_of_its_parts(tmp_path, capsys, monkeypatch):
    """The parts that need no long run; the page joins whatever has been run."""
    monkeypatch.setattr(reproduction, "REPORTED", ("fig3", "table2"))
    words = ["reproduce", "all", "--episodes", "2", "--policy", "known", "--seed", "4", "--out"]
    words += [str(tmp_path), "--sensor.detection-probability", "0.9"]
    with monkeypatch.context() as broken:
        broken.setattr(reproduction, "_write_page", None)
        assert cli.main(words) == 1
    capsys.readouterr()
    # What was finished is taken as it is found, and kept no longer than until all is.
    part = tmp_path / "fig3_part.json"
    part.write_text(part.read_text("utf-8").replace('"figure3"', '"finished"'), "utf-8")
    found = document(words, capsys)
    assert (found["fig3"]["experiment"], part.exists()) == ("finished", False)
    assert set(found) == {"fig3", "table2", "report"}
    page = Path(found["report"]).read_text("utf-8")
    assert "jaxlangnav reproduce all --episodes 2 --policy known --seed 4" in page
    assert "sensor.detection_probability = 0.9" in page
    assert found["table2"]["models_sha256"] in page
    assert page.count("data:image/svg+xml;base64,") == 2
    assert "8.75 (1.69)" in page
    assert 'src="http' not in page
