"""The rows of ``reproduce conversation``, and their table."""

import dataclasses
import math

import numpy as np
import pytest

from jaxlangnav.cli import main as cli
from jaxlangnav.experiments import conversation
from jaxlangnav.experiments.conversation import ROWS, dialogue_table, run_row
from jaxlangnav.experiments.dialogue import sentence_with
from jaxlangnav.navigator import default_params
from jaxlangnav.world.person import params_of


def test_every_row_has_a_person_and_pairs_with_its_worlds() -> None:
    for row in ROWS:
        params_of(**row.person)
        answers = row.person.get("answers", True) and row.person.get("num_corrections", 1) == 0
        assert math.isfinite(row.cost) == answers
    costs = [row.cost for row in ROWS if row.name == "questions" and row.world == "2H1C"]
    assert len(set(costs)) == len(costs) >= 5


def test_what_is_stated_is_joined_once_for_all() -> None:
    said = sentence_with("go to the hydrant", conversation._TRUTH, conversation._FALSEHOOD)
    shape = said.instruction.readings.relation.shape[1:]
    for joined in (said.truth, said.falsehood):
        assert joined.readings.relation.shape == shape
        assert (np.asarray(joined.readings.relation) >= 0).any()
    assert (np.asarray(said.instruction.readings.relation) < 0).all()


def test_a_row_without_a_cost_weighs_no_questions() -> None:
    entry = {
        "world": "2H1C", "relation": "null", "said": "one correction", "question_cost": None,
        "success": 99.0, "distance": 20.0, "questions": 0.0, "corrections": 0.5,
        "corrected_way_seen": 1.05, "corrected_seen": 12, "corrected_way_unseen": None,
        "corrected_unseen": 0, "weighted": 99.0,
    }  # fmt: skip
    table = dialogue_table({"rows": [entry]})
    assert table.rows[0][3] == table.rows[0][9] == ""
    assert table.rows[0][8] == "1.05 (12)"
    assert "one correction" in table.markdown()


def test_another_policy_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["reproduce", "conversation", "--policy", "faithful"]) == 2
    assert "in conversation it is informed" in capsys.readouterr().err


@pytest.mark.slow
def test_a_correction_finds_the_other() -> None:
    """Paired episode by episode; the same seed gives the same row."""
    numbers = {"seed": 0, "particles": 64, "params": default_params()}
    silent, corrected = ROWS[0], ROWS[1]
    alone = run_row(silent, episodes=20, **numbers)
    told = run_row(corrected, episodes=20, **numbers)
    assert told["success"] > alone["success"]
    assert told["questions"] == 0.0
    assert told["corrections"] > 0.0
    again = run_row(dataclasses.replace(corrected), episodes=20, **numbers)
    assert again == told
