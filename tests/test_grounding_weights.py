"""Shipped weights: where they come from, and that they can be made again."""

import json
from importlib import resources

import numpy as np
import pytest

from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.grounding.behavior_properties import PROPERTY_NAMES
from jaxlangnav.grounding.evaluation import Scores, calibration_error, fit_temperature
from jaxlangnav.grounding.fitting import train_models
from jaxlangnav.grounding.weights import about, load, save, shipped_path

TABLE_2 = (
    "go to the hydrant",
    "go to the hydrant behind the cone",
    "go to the hydrant nearest to the cone",
)


def test_round_trip(tmp_path):
    model = load_shipped()
    save(tmp_path / "w.npz", model, command="test", corpus_hash="abc")
    again = load(tmp_path / "w.npz")
    assert again.annotation.vocabulary == model.annotation.vocabulary
    assert again.behavior.temperature == model.behavior.temperature
    for kind, weight in model.behavior.weights.items():
        np.testing.assert_array_equal(again.behavior.weights[kind], weight)
    assert about(tmp_path / "w.npz")["command"] == "test"


def test_weights_of_other_properties_are_refused(tmp_path, monkeypatch):
    """Columns are told by name: two that have changed places would be read without a sound."""
    save(tmp_path / "w.npz", load_shipped(), command="test", corpus_hash="abc")
    first, second, *rest = PROPERTY_NAMES["region"]
    monkeypatch.setitem(PROPERTY_NAMES, "region", (second, first, *rest))
    with pytest.raises(ValueError, match="the properties of 'region' are others"):
        load(tmp_path / "w.npz")


def test_every_property_has_a_name_and_a_column():
    weights = load_shipped().behavior.weights
    assert {kind: len(names) for kind, names in PROPERTY_NAMES.items()} == {
        kind: weight.shape[1] for kind, weight in weights.items()
    }
    assert all(len(set(names)) == len(names) for names in PROPERTY_NAMES.values())


def test_weights_say_where_they_come_from():
    record = about(shipped_path())
    assert record["command"] == "python scripts/train_models.py"
    assert len(str(record["corpus"])) == 16


@pytest.mark.parametrize("content", [b"", b"no weights", None])
def test_bad_files_are_refused_in_one_line(tmp_path, content):
    path = tmp_path / "bad.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError, match="not a file of weights") as caught:
        load(path)
    assert "\n" not in str(caught.value)


def test_the_commands_of_table_2_are_in_no_corpus():
    for name in ("corpus", "corpus39"):
        lines = (resources.files("jaxlangnav.language") / f"data/{name}.jsonl").read_text("utf-8")
        texts = {json.loads(line)["text"] for line in lines.splitlines() if line[:1] == "{"}
        assert texts
        assert not texts & set(TABLE_2)


def test_calibration_error_by_hand():
    right = np.array([True, True, False, True])
    confidence = np.array([0.95, 0.95, 0.95, 0.55])
    scores = Scores(right, confidence, np.zeros(4))
    # Bin 0.9-1.0: accuracy 2/3 against 0.95, weight 3/4; bin 0.5-0.6: 1 against 0.55, weight 1/4.
    assert calibration_error(scores) == pytest.approx(0.75 * (0.95 - 2 / 3) + 0.25 * 0.45)


def test_temperature_is_where_gold_is_likeliest():
    def score(t):
        return Scores(np.ones(1, bool), np.ones(1), np.array([-abs(t - 1.3)]))

    assert fit_temperature(score) == 1.3


@pytest.mark.slow
def test_training_again_gives_the_accuracy_reported():
    trained = train_models()
    report = trained.report
    assert report["corpus"] == about(shipped_path())["corpus"]
    assert report["annotation"]["accuracy"] >= 0.95
    assert report["behavior"]["accuracy"] >= 0.95
    assert report["annotation"]["calibration_error"] < 0.03
    for text in TABLE_2:
        again, shipped = (understand(text, m) for m in (trained.model, load_shipped()))
        assert json.dumps(again.annotations[0]["relation"]) == json.dumps(
            shipped.annotations[0]["relation"]
        )
