"""Table 3: what is kept is not run again, and what is refused."""

import importlib.util
import json

import jax
import numpy as np
import pytest

from jaxlangnav.cli.main import main
from jaxlangnav.experiments.table import Table
from jaxlangnav.robots import trials
from jaxlangnav.robots.table3 import STOP_DISTANCE, TABLE3, draw_environment
from jaxlangnav.robots.trials import KNOWN_MAP, TrialPlan


def result(row, trial, *, success: bool = True) -> dict:
    return {
        "row": row.name,
        "trial": trial,
        "ending": "arrived" if success else "blocked",
        "why": "",
        "success": success,
        "distance": 5.0 + (0 if isinstance(trial, str) else trial),
        "goal_distance": 1.0,
        "seconds": 20.0,
    }


@pytest.fixture
def ran(monkeypatch) -> list:
    """Run nothing; tell what would have been run."""
    told: list = []

    def run(plan, missing):
        told.extend((row.name, trial) for row, trial in missing)
        for row, trial in missing:
            yield row, trial, result(row, trial, success=trial != 1)

    monkeypatch.setattr(trials, "_run_missing", run)
    monkeypatch.setattr(trials, "check_libraries", lambda: None)
    return told


def test_what_has_been_kept_is_not_run_again(ran: list, tmp_path) -> None:
    plan, done = TrialPlan(trials=2, out=tmp_path), []
    first = trials.reproduce_table3(plan, rows=TABLE3[:2], on_progress=done.append)
    assert len(ran) == sum(done) == 6
    assert first["resumed"] == 0
    ran.clear()
    damaged = plan.path(TABLE3[0], 1)
    damaged.write_text(damaged.read_text()[:20])
    for trial, change in enumerate(({"made": {"version": "0"}}, {"ending": "crashed"})):
        other = plan.path(TABLE3[1], trial)
        other.write_text(json.dumps({**json.loads(other.read_text()), **change}))
    again = trials.reproduce_table3(TrialPlan(trials=3, out=tmp_path), rows=TABLE3[:2])
    assert set(ran) == {
        (row.name, trial) for row in TABLE3[:2] for trial in range(row is TABLE3[0], 3)
    }  # fmt: skip
    assert again["resumed"] == 3
    ran.clear()
    trials.reproduce_table3(TrialPlan(trials=1, out=tmp_path, seed=1), rows=TABLE3[:1])
    assert ran == [(TABLE3[0].name, KNOWN_MAP), (TABLE3[0].name, 0)]


def test_first_trials_and_failures_are_recorded(monkeypatch, tmp_path) -> None:
    pages = []

    def run(row, trial, *, navigator, seed, page):
        pages.append((trial, page and page.relative_to(tmp_path).as_posix()))
        return result(row, trial, success=trial != 2)

    monkeypatch.setattr(trials, "run_trial", run)
    monkeypatch.setattr(trials, "navigator_of", lambda robot, policy: None)
    plan = TrialPlan(trials=3, out=tmp_path)
    for trial in range(3):
        trials._run_one(TABLE3[6], trial, plan)
    stem = "recordings/husky-1H1C-3-behind-informed-seed0"
    assert pages == [(0, f"{stem}-0.html"), (1, None), (2, None), (2, f"{stem}-2.html")]
    pages.clear()
    trials._run_one(TABLE3[6], 2, TrialPlan(trials=3))
    assert pages == [(2, None)]


def test_the_table_stands_beside_the_papers(ran: list) -> None:
    document = trials.reproduce_table3(TrialPlan(trials=3))
    assert document["success"] == pytest.approx(2 / 3)
    rows = Table.of(document["rows"], trials.TRIAL_COLUMNS).rows
    assert len(rows) == 7
    for cells, row in zip(rows, TABLE3, strict=True):
        assert cells[0] == row.robot
        assert cells[5] == f"{row.success:g}%"
        assert cells[6] == "6.00 (1.00)"
        assert "1 blocked" in cells[-1]
    assert rows[3][7] == "6.00 (1.38)"
    assert rows[6][7] == "–"
    assert document["rows"][0]["failures"][0]["trial"] == 1


def test_environments_are_as_far_as_the_paper_prints() -> None:
    drawn = [draw_environment(row, 0) for row in TABLE3]
    for row, scenario in zip(TABLE3, drawn, strict=True):
        assert bool(scenario.is_valid)
        hydrants, cones = int(row.world[0]), int(row.world[2])
        kinds = np.asarray(scenario.object_type)[np.asarray(scenario.is_object)].tolist()
        assert (kinds.count(0), kinds.count(1)) == (hydrants, cones)
        if row.known_distance is not None:
            assert np.hypot(*scenario.goal) == pytest.approx(
                row.known_distance + STOP_DISTANCE, abs=0.15
            )
    jax.tree.map(np.testing.assert_array_equal, drawn[0], drawn[1])
    assert not np.allclose(draw_environment(TABLE3[0], 1).goal, drawn[0].goal)


def hide(monkeypatch, *missing: str) -> None:
    """Let libraries not be installed."""
    find = importlib.util.find_spec
    monkeypatch.setattr(
        "importlib.util.find_spec", lambda name: None if name in missing else find(name)
    )


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("table3 --trials 0", "--trials is 0"),
        ("table2 --trials 3", "--trials is for table3"),
        ("table3 --episodes 5", "--episodes changes nothing"),
        ("table3 --policy known", "informed or faithful"),
        ("table3 --params.planner.discount 0.9", "changes nothing in table3"),
        ("table3", "jaxlangnav[robot]"),
    ],
)
def test_what_cannot_be_run_is_refused_in_one_line(monkeypatch, capsys, words, says) -> None:
    hide(monkeypatch, "cv2")
    assert main(["reproduce", *words.split()]) == 2
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1


def test_plans_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="trials is 0"):
        TrialPlan(trials=0)
    with pytest.raises(ValueError, match="processes is 0"):
        TrialPlan(trials=1, processes=0)
