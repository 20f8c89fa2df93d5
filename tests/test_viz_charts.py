"""Charts of results: every row is a point, the paper's beside ours, intervals as computed."""

import numpy as np
import pytest

from jaxlangnav.experiments.metrics import wilson_interval
from jaxlangnav.viz import measures, style, sweep

RANGES = (2.0, 3.0, 5.0)


def row(policy, relation, reach, *, world="2H1C", rate=80.0, way=15.0):
    return {
        "world": world, "range": reach, "relation": relation, "policy": policy, "episodes": 100,
        "success_rate": rate, "success_ci": [rate - 8, rate + 6], "distance_mean": way,
        "distance_sd": 5.0,
    }  # fmt: skip


def document():
    rows = [
        row(policy, relation, reach, rate=60 + 5 * reach, way=30 - 4 * reach)
        for policy in ("faithful", "informed", "known")
        for relation in ("behind", "nearest")
        for reach in RANGES
    ]
    paper = [row("paper", "behind", 3.0, rate=67.4, way=18.72)]
    return {
        "episodes": 100, "rows": rows, "paper": paper,
        "sentences": {"behind": "go to the hydrant behind the cone"},
    }  # fmt: skip


def lines_of(axes):
    return {one.get_label(): one.lines[0].get_xydata() for one in axes.containers if one.lines}


def test_every_row_is_a_point_of_figure_5():
    figure = sweep.range_figure(document())
    assert len(figure.axes) == 4
    behind_way, nearest_way, behind_rate, _ = figure.axes
    ours = lines_of(behind_way)["faithful (the paper's method)"]
    # Policies stand a few per cent apart along the axis of ranges.
    assert ours[:, 0] == pytest.approx([2, 3, 5], rel=0.05)
    assert ours[:, 1] == pytest.approx([22, 18, 10])
    rates = lines_of(behind_rate)["informed (ours)"]
    assert rates[:, 1] == pytest.approx([70, 75, 85])
    assert lines_of(behind_way)[sweep.PAPER_NAME] == pytest.approx(np.array([[3, 18.72]]))
    assert sweep.PAPER_NAME not in lines_of(nearest_way)
    assert behind_way.get_title(loc="left") == "2H1C, “go to the hydrant behind the cone”"


def test_error_bars_are_intervals_of_the_mean():
    assert sweep.half_interval(row("informed", None, 3.0)) == pytest.approx(1.96 * 5 / 10)
    figure = sweep.range_figure(document())
    bars = figure.axes[2].containers[0].lines[2][0].get_segments()
    assert bars[0][:, 1] == pytest.approx([62, 76])


def test_table_2_has_a_line_for_each_row():
    found = document()
    found["rows"] += [row("faithful", None, 3.0, world="1H1C")]
    figure = sweep.table_figure(found)
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert len(labels) == 7
    assert labels[-1] == "1H1C, 3 m, no relation"
    assert labels[0] == "2H1C, 2 m, behind"


@pytest.mark.parametrize("draw", [sweep.range_figure, sweep.table_figure])
def test_nothing_to_draw_is_said(draw):
    with pytest.raises(ValueError, match="nothing to draw"):
        draw({"rows": []})


def test_calibration_bins_by_hand():
    predicted = np.array([0.05, 0.15, 0.15, 0.95, 1.0])
    outcome = np.array([False, True, False, True, True])
    mean, rate, low, high, number = measures.calibration_bins(predicted, outcome, 10)
    assert mean == pytest.approx([0.05, 0.15, 0.975])
    assert rate == pytest.approx([0.0, 0.5, 1.0])
    assert number.tolist() == [1, 2, 2]
    assert (low[1], high[1]) == pytest.approx(wilson_interval(1, 2))


def test_calibrated_predictions_lie_on_the_line():
    rng = np.random.default_rng(0)
    predicted = rng.random(20000)
    outcome = rng.random(20000) < predicted
    mean, rate, _, _, number = measures.calibration_bins(predicted, outcome, 10)
    # Five standard errors of a rate in each bin.
    assert (np.abs(rate - mean) < 5 * np.sqrt(0.25 / number)).all()


@pytest.mark.parametrize(
    ("predicted", "outcome", "bins", "said"),
    [
        ([0.5], [True, False], 10, "do not fit"),
        ([1.5], [True], 10, "outside"),
        ([0.5], [True], 0, "do not fit"),
    ],
)
def test_bad_predictions_are_refused(predicted, outcome, bins, said):
    with pytest.raises(ValueError, match=said):
        measures.calibration_bins(np.array(predicted), np.array(outcome), bins)


def test_calibration_figure(tmp_path):
    curves = {"annotation": (np.array([0.1, 0.9]), np.array([False, True]))}
    figure = measures.calibration_figure(curves)
    assert all(path.exists() for path in style.save(figure, tmp_path / "calibration"))
    with pytest.raises(ValueError, match="no predictions"):
        measures.calibration_figure({})


def test_time_bars_are_ranked_with_shares():
    figure = measures.time_figure({"small": 10.0, "large": 30.0})
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["large", "small"]
    assert [bar.get_width() for bar in axes.patches] == [30.0, 10.0]
    assert {text.get_text() for text in axes.texts} == {"30 µs · 75 %", "10 µs · 25 %"}
    with pytest.raises(ValueError, match="no time"):
        measures.time_figure({})
