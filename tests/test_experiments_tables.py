"""Tables for people: every figure where it belongs, ours beside the paper's."""

import base64
import dataclasses
import io
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from grounding_fixture import TYPES, corpus
from pages import Page
from rich.console import Console

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.experiments import paper
from jaxlangnav.experiments.experiment import Options
from jaxlangnav.experiments.metrics import _sign_flip, compare, summarize
from jaxlangnav.experiments.rows import RowSpec, describe_noise, deviations, published_rows
from jaxlangnav.experiments.table import Section, Table, report_html
from jaxlangnav.experiments.table1 import _accuracy, _oov_accuracy, draw_splits, evaluate, table_1
from jaxlangnav.grounding import load_shipped
from jaxlangnav.messages import Status
from jaxlangnav.training.scoring import Scorer, Scores
from jaxlangnav.world.templates import TABLE_2

TABLE = paper.table_2()


def row(**changes: Any) -> dict[str, Any]:
    counts = ("overflows", "degenerate", "contradictions", "faults", "not_found", "invalid_worlds")
    return {
        "world": "2H1C", "range": 3.0, "relation": "behind", "policy": "faithful",
        "episodes": 400, "success_rate": 67.4, "success_ci": [62.0, 72.0],
        "distance_mean": 18.72, "distance_sd": 10.0, "known_distance_mean": 10.3,
        "known_distance_sd": 1.8, "spl": 0.5, "timeouts": 3, **dict.fromkeys(counts, 0),
    } | changes  # fmt: skip


def document(*rows: dict[str, Any]) -> dict[str, Any]:
    return {
        "episodes": 400,
        "policies": list(dict.fromkeys(one["policy"] for one in rows)),
        "seed": 0,
        "num_particles": 64,
        "noise": describe_noise(),
        "rows": list(rows),
        "paper": published_rows(TABLE_2),
    }


def test_cells_by_hand() -> None:
    text = paper.results_table(document(row(ece=0.0251, brier=None, coverage90=90.6))).markdown()
    expected = (
        "| 2H1C | 3 | behind | faithful | 67.4 (62.0-72.0) | 67.4 | 18.72 (10.00) | 18.72 (10.23) "
        "| 10.30 (1.80) | 10.38 (1.86) | 0.50 | 3 | 0.025 |  | 91 |"
    )
    assert expected in text.splitlines()


def test_the_paper_stands_beside_what_it_ran() -> None:
    """Its method beside both of ours, its known map beside ours, nothing beside other robots."""
    beside = {
        name: paper.results_table(document(row(policy=name))).rows[0][5:10:2]
        for name in ("informed", "faithful", "arc", "known")
    }
    known = "10.38 (1.86)"
    assert beside["informed"] == beside["faithful"] == ["67.4", "18.72 (10.23)", known]
    assert beside["arc"] == ["", "", known]
    assert beside["known"] == ["100.0", known, known]


def test_policies_of_a_row_stand_together() -> None:
    rows = [
        row(),
        row(world="1H1C", relation=None),
        row(policy="known"),
        row(world="1H1C", relation=None, policy="known"),
    ]
    order = [(one["world"], one["policy"]) for one in paper._join_published(document(*rows))]
    assert order == [(world, of) for world in ("2H1C", "1H1C") for of in ("faithful", "known")]


def test_a_row_the_paper_lacks_has_no_figure_beside_it() -> None:
    text = paper.results_table(document(row(world="2H2C"))).markdown()
    assert "| 2H2C | 3 | behind | faithful | 67.4 (62.0-72.0) |  | 18.72 (10.00) |  |" in text


def test_deviations_by_hand() -> None:
    printed = published_rows(TABLE_2)[5]
    assert deviations(row(), printed)["distance"] == pytest.approx(0.0)
    far = deviations(row(distance_mean=20.72, success_rate=100.0), printed)
    # Standard errors 10 / 20 and 10.23 / 10.
    assert far["distance"] == pytest.approx(2.0 / (0.5**2 + 1.023**2) ** 0.5)
    # 100 % of 400 counts as 399.5: error 0.1249 %; 67.4 % of 100: 4.687 %.
    assert far["success"] == pytest.approx(32.6 / (0.1249**2 + 4.6874**2) ** 0.5, rel=1e-3)


def test_the_terminal_table_fits_and_says_the_noise() -> None:
    console = Console(width=118, record=True, file=io.StringIO())
    console.print(TABLE.render(document(row(), row(policy="known"))))
    text = console.export_text()
    assert max(map(len, text.splitlines())) <= 118
    assert "…" not in text
    for part in ("faithful", "known", "detection 0.95", "360°", "odometry 2 %", "64 particles"):
        assert part in text


def test_the_caption_counts_each_way_to_go_wrong() -> None:
    one = row(overflows=3, degenerate=2, contradictions=5, faults=4, invalid_worlds=1)
    text = " ".join(paper.caption(document(one, row(policy="informed", contradictions=2))))
    assert "left out: 1; detections without a slot: 3; steps with all weights zero: 2" in text
    assert "the map: 7, with an invalid observation, at which it stood still: 4." in text


def test_falls_are_found() -> None:
    rows = [
        row(range=2.0, success_rate=80.0, success_ci=[75.0, 85.0]),
        row(range=3.0, success_rate=78.0, success_ci=[73.0, 83.0]),
        row(range=5.0, success_rate=60.0, success_ci=[55.0, 65.0]),
    ]
    found = paper._success_drops(rows[::-1])
    assert [(one["range"], one["from"], one["to"]) for one in found] == [(5.0, 78.0, 60.0)]


def test_totals_and_refusals() -> None:
    given = Options(episodes=100, policies=["faithful", "known"])
    assert (TABLE.total_episodes(given), TABLE.check(given)[0].calibration_episodes) == (1400, 32)
    with pytest.raises(ValueError, match="episodes is 0, but must be at least 1"):
        TABLE.run(Options(episodes=0))
    with pytest.raises(ValueError, match=r'unknown policy "faithfull".*did you mean "faithful"'):
        TABLE.run(Options(episodes=1, policies=["faithfull"]))


def test_an_experiment_and_its_files(tmp_path: Path) -> None:
    specs = (
        RowSpec(world="1H1C", range=3.0, relation="null"),
        RowSpec(world="2H1C", range=5.0, relation="nearest"),
    )
    experiment = dataclasses.replace(TABLE, name="small", specs=specs, calibration_episodes=0)
    done: list[int] = []
    options = Options(episodes=20, policies=["known", "frontier"], seed=3)
    found = experiment.run(options, out=tmp_path, on_progress=done.append)
    assert sum(done) == 80
    order = [(one["world"], one["policy"]) for one in found["rows"]]
    assert order == [(world, of) for of in ("known", "frontier") for world in ("1H1C", "2H1C")]
    assert {"ece", "brier", "coverage90"} <= set(found["rows"][0])
    assert found["rows"][0]["relation"] is None
    assert len(found["paper"]) == 2
    ends = (".md", ".json", "_manifest.json", "_episodes.parquet")
    assert {path.name for path in tmp_path.iterdir()} == {f"small{end}" for end in ends}
    table = pq.read_table(tmp_path / "small_episodes.parquet")
    assert table.num_rows == 80
    mean = table["distance"].to_numpy()[20:40].mean()
    assert found["rows"][1]["distance_mean"] == pytest.approx(mean, rel=1e-5)


# The one kind of table: the same cells in the terminal, in Markdown and on a page.


TABLE_TABLE = Table(
    title="Robots",
    headings=["World", "Policy", "Success %", "paper", "empty"],
    rows=[
        ["1H1C", "ours", "93.9 (90-97)", "93.9", ""],
        ["1H1C", "limit", "≤ 100", "", ""],
        ["2H|1C", "ours", "4", "", ""],
    ],
    group=1,
    dim=[False, True, False],
)


def drawn(table: Table) -> str:
    console = Console(width=90, record=True, file=io.StringIO(), markup=False)
    console.print(table.text())
    return console.export_text()


def test_a_block_says_once_what_it_shares() -> None:
    text = drawn(TABLE_TABLE)
    assert "Robots" in text
    assert text.count("1H1C") == 1
    assert TABLE_TABLE.html().count("<td>1H1C</td>") == 1
    assert TABLE_TABLE.html().count("class=first") == 2
    # In Markdown a row is read alone.
    assert TABLE_TABLE.markdown().count("1H1C") == 2
    assert drawn(Table(headings=TABLE_TABLE.headings, rows=TABLE_TABLE.rows)).count("1H1C") == 2


def test_cells_are_text_unless_they_are_marked() -> None:
    assert "| 2H\\|1C |" in TABLE_TABLE.markdown()
    bold = Table(headings=["a"], rows=[["**1**"]])
    assert bold.markdown() == "| a |\n| --- |\n| \\*\\*1\\*\\* |\n"
    assert "&lt;b&gt;" in Table(headings=["<b>"], rows=[["x"]]).html()


# The page of results: one file, nothing from outside, everything escaped.


SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="3" height="2"></svg>'


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    path = tmp_path / "figure.svg"
    path.write_text(SVG, "utf-8")
    return path


def read(*sections: Section, title: str = "Ours & theirs", **made: str) -> Page:
    return Page(report_html(title, sections, facts=made))


def test_pictures_stand_in_the_page_and_nothing_is_fetched(picture: Path) -> None:
    page = read(
        Section(title="One", pictures=[(picture, "a figure")]),
        Section(title="Two", pictures=[(picture, 'a "second" figure')]),
        seed="7",
    )
    assert all(link.startswith(("#", "data:")) for link in page.links)
    assert [link for link in page.links if link.startswith("#")] == ["#part1", "#part2"]
    assert {"part1", "part2"} <= set(page.ids)
    images = [link for link in page.links if link.startswith("data:image/svg+xml;base64,")]
    assert len(images) == 2
    assert base64.b64decode(images[0].split(",")[1]).decode() == SVG
    text = report_html("x", [Section(title="One", pictures=[(picture, "a")])], facts={})
    assert not re.search(r"https?://|@import|url\(|<script", text)


def test_tables_and_how_they_were_made(picture: Path) -> None:
    table = Table(headings=["World", "paper"], rows=[["1H1C", "93.9"], ["2H<1C", "54.4"]])
    made = {"command": "jaxlangnav reproduce table2", "nothing": ""}
    page = read(Section(title="T", intro="words", tables=[table], notes=["noise 2 %"], facts=made))
    assert page.cells == ["World", "paper", "1H1C", "93.9", "2H<1C", "54.4"]
    for part in ("words", "noise 2 %", "jaxlangnav reproduce table2"):
        assert part in page.text
    # A term without a value is not listed.
    assert "nothing" not in page.text


def test_what_is_written_cannot_break_the_page() -> None:
    evil = '</title><script>alert("x")</script>'
    page = report_html(evil, [Section(title=evil, intro=evil, notes=[evil])], facts={"a": evil})
    assert "<script" not in page
    assert page.startswith("<!doctype html>")


def test_text_that_names_a_place_of_the_page_stays_text() -> None:
    part = Section(title="__MADE__ <i>", intro="__CONTENTS__ \x1b[2J", notes=["__PARTS__"])
    text = report_html("__PARTS__ <b>", [part], facts={"command": "__TITLE__ \u202e"})
    page = Page(text)
    assert text.count("<section") == 1
    assert "__PARTS__ <b>" in page.text
    assert "__MADE__ <i>" in page.text
    assert "<b>" not in text
    assert "\x1b" not in text
    assert "\u202e" not in text


def results(**changes: Any) -> EpisodeResult:
    number = 4
    leaves: dict[str, Any] = {
        "is_success": np.array([True, True, False, True]),
        "is_stopped": np.array([True, True, False, True]),
        "ending": np.array([Status.ARRIVED, Status.NOT_FOUND, Status.SEARCHING, Status.ARRIVED]),
        "distance": np.array([10.0, 20.0, 100.0, 5.0]),
        "steps": np.array([10, 20, 120, 5]),
        "final": np.zeros((number, 2)),
        "goal_distance": np.zeros(number),
        "overflow": np.array([0, 2, 0, 0]),
        "degenerate": np.array([1, 0, 0, 0]),
        "contradictions": np.array([0, 1, 2, 0]),
        "faults": np.array([3, 0, 1, 7]),
        "mean_effective_sample_size": np.ones(number),
        "is_valid": np.array([True, True, True, False]),
    }
    return EpisodeResult(**(leaves | changes))


def test_a_row_by_hand() -> None:
    row = summarize(results(), np.array([10.0, 10.0, 10.0, 10.0]))
    assert row.episodes == 3
    assert row.success_rate == pytest.approx(200 / 3)
    assert row.distance_mean == pytest.approx(130 / 3)
    assert row.distance_sd == pytest.approx(np.std([10, 20, 100], ddof=1))
    # It may stop 1.5 m short of 10 m.
    assert row.spl == pytest.approx((8.5 / 10.0 + 8.5 / 20.0 + 0.0) / 3)
    assert (row.timeouts, row.overflows, row.degenerate, row.invalid_worlds) == (1, 2, 1, 1)
    assert row.not_found == 1
    assert row.contradictions == 3
    assert row.faults == 4

    # A robot may stop short of the goal: its SPL is at most 1 all the same.
    row = summarize(results(distance=np.full(4, 2.0)), np.full(4, 10.0))
    assert row.spl == pytest.approx(2 / 3)
    # One episode has no spread.
    row = summarize(results(is_valid=np.array([True, False, False, False])), np.full(4, 10.0))
    assert (row.episodes, row.distance_sd) == (1, 0.0)


def test_sign_flip_limits() -> None:
    assert _sign_flip(np.zeros(9)) == 1.0
    # All of 30 differences alike: only flips of none or all reach the sum.
    assert _sign_flip(np.ones(30)) == pytest.approx(1 / 4001)
    # Three equal differences: 2 of 8 sign patterns reach the sum.
    assert _sign_flip(np.full(3, 2.5)) == pytest.approx(0.25, abs=5 * math.sqrt(0.1875 / 4000))


def test_compare_by_hand() -> None:
    found = compare(
        np.array([True, True, False, False]),
        np.array([True, False, False, True]),
        np.array([1.0, 2.0, 3.0, 4.0]),
        np.array([2.0, 2.0, 5.0, 5.0]),
    )
    assert (found.pairs, found.success_only_first, found.success_only_second) == (4, 1, 1)
    assert found.success_p == 1.0
    assert found.distance_difference == pytest.approx(1.0)
    half = 1.959964 * np.std([1, 0, 2, 1], ddof=1) / 2
    assert found.distance_ci == pytest.approx((1 - half, 1 + half))
    empty = np.array([])
    with pytest.raises(ValueError, match="no episode"):
        compare(empty, empty, empty, empty)


def test_a_third_is_held_out_and_splits_differ():
    held_out = draw_splits(39, 20, seed=0)
    assert (held_out.sum(1) == 13).all()
    assert len({row.tobytes() for row in held_out}) == 20
    np.testing.assert_array_equal(held_out, draw_splits(39, 20, seed=0))


def test_new_words_are_those_of_no_training_sentence():
    instructions = corpus(
        num_worlds=0,
        sentences=("go to the box", "find the box", "go to the cone", "find the boxes"),
    )
    # Without the first and the third nobody has said "go" or "cone"; "boxes" is the lemma "box".
    held_out = np.array([[True, False, True, False], [True, False, False, True]])
    scores = [Scores(np.array(right), np.ones(2), np.zeros(2)) for right in ([1, 0], [1, 1])]
    found = _oov_accuracy("annotation", instructions, scores, held_out)
    assert found == {"accuracy_mean": 50.0, "share": 0.5}


def test_interval_by_hand():
    scores = [Scores(np.array(right), np.ones(2), np.zeros(2)) for right in ([1, 1], [1, 0])]
    interval = round(1.96 * np.std([100, 50], ddof=1) / np.sqrt(2), 2)
    assert _accuracy(scores) == {"accuracy_mean": 75.0, "accuracy_ci95": interval}


@pytest.mark.parametrize(
    ("arguments", "words"), [({"splits": 1}, "at least 2"), ({"beams": (0,)}, "1 or more")]
)
def test_bad_requests_are_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        evaluate(**arguments)


def test_exact_scores_are_those_of_the_beam_where_both_are_sure():
    model = load_shipped()
    instructions = corpus(
        num_worlds=2,
        sentences=("go to the box near the tree", "find the car", "go to the other box"),
    )
    both = [[one] for one in (model.annotation, model.behavior)]
    scorer = Scorer(instructions, TYPES, is_exact=True)
    for found, size in ((scorer.annotations(both[0]), 3), (scorer.behaviors(*both), 6)):
        beam, exact = found.by_width[4][0], found.exact[0]
        assert exact.is_right.shape == (size,)
        np.testing.assert_array_equal(exact.is_right, beam.is_right)
        # Half of the probability in one set proves it.
        assert exact.is_proven[(beam.confidence > 0.5) | (size == 3)].all()


@pytest.mark.slow
def test_protocol_end_to_end():
    done = []
    document = evaluate(splits=4, beams=(4, 1), is_exact=True, on_progress=done.append)
    assert sum(done) == 4
    for name in ("annotation", "behavior"):
        row = document[name]
        assert row["splits"] == 4
        assert row["accuracy_mean"] >= 80.0
        assert row["train_s"] < 20.0
        assert {"accuracy_ci95", "train_compile_s", "infer_s", "examples", "features"} <= set(row)
        assert set(row["beams"]) == {"4", "1", "exact"}
        assert row["beams"]["4"]["accuracy_mean"] == row["accuracy_mean"]
        assert 0.0 <= row["new_words"]["accuracy_mean"] <= 100.0
        # A third of the corpus has a word that occurs once: it is held out as often as not.
        assert 0.2 < row["new_words"]["share"] < 0.6
        # A beam may miss the likeliest set, and where it is found nothing changes.
        assert row["beams"]["exact"]["proven"] >= 0.95
        expected = pytest.approx(row["accuracy_mean"], abs=5.0)
        assert row["beams"]["exact"]["accuracy_mean"] == expected
    # The size of the paper's training set: 83,547 examples.
    assert 70_000 < document["annotation"]["examples"] < 100_000
    assert len(table_1(document).rows) == 11
