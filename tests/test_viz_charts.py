"""Charts of results: every row is a point, the paper's beside ours, intervals as computed."""

import numpy as np
import pytest

from jaxlangnav.experiments.metrics import wilson_interval
from jaxlangnav.viz import rows, sweep

RANGES = (2.0, 3.0, 5.0)


def row(policy, relation, reach, *, world="2H1C", rate=80.0, way=15.0):
    return {
        "world": world, "range": reach, "relation": relation, "policy": policy, "episodes": 100,
        "success_rate": rate, "success_ci": [rate - 8, rate + 6], "distance_mean": way,
        "distance_sd": 5.0,
    }  # fmt: skip


def document():
    found = [
        row(policy, relation, reach, rate=60 + 5 * reach, way=30 - 4 * reach)
        for policy in ("faithful", "informed", "known")
        for relation in ("behind", "nearest")
        for reach in RANGES
    ]
    paper = [row("paper", "behind", 3.0, rate=67.4, way=18.72)]
    return {
        "episodes": 100, "rows": found, "paper": paper,
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
    assert lines_of(behind_rate)["informed (ours)"][:, 1] == pytest.approx([70, 75, 85])
    assert lines_of(behind_way)[sweep.PAPER_NAME] == pytest.approx(np.array([[3, 18.72]]))
    assert sweep.PAPER_NAME not in lines_of(nearest_way)
    assert behind_way.get_title(loc="left") == "2H1C, “go to the hydrant behind the cone”"
    # Bars are intervals of the mean; those of the paper's rates are of its hundred runs.
    assert sweep.half_interval(row("informed", None, 3.0)) == pytest.approx(1.96 * 5 / 10)
    bars = behind_rate.containers[0].lines[2][0].get_segments()
    assert bars[0][:, 1] == pytest.approx([62, 76])
    (point,) = [one for one in behind_rate.containers if one.get_label() == sweep.PAPER_NAME]
    ends = np.multiply(100, wilson_interval(67, 100))
    assert point.lines[2][0].get_segments()[0][:, 1] == pytest.approx(ends)


def test_table_2_has_a_line_for_each_row():
    found = document()
    found["rows"] += [row("faithful", None, 3.0, world="1H1C")]
    figure = rows.table_figure(found | {"bounds": []})
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert len(labels) == 7
    assert labels[-1] == "1H1C, 3 m, no relation"
    assert labels[0] == "2H1C, 2 m, behind"


@pytest.mark.parametrize("draw", [sweep.range_figure, rows.table_figure])
def test_nothing_to_draw_is_said(draw):
    with pytest.raises(ValueError, match="nothing to draw"):
        draw({"rows": []})


def test_limits_stand_across_their_row():
    found = document()
    found["bounds"] = [
        {"world": world, "range": 3.0, "relation": "behind", "success": 100.0, "known": 10.4}
        for world in ("2H1C", "9H9C")
    ]
    rates, ways = rows.table_figure(found).axes
    marks = [
        [line.get_xdata() for line in axes.lines if line.get_label() == rows.LIMIT_NAME]
        for axes in (rates, ways)
    ]
    assert [len(of_axes) for of_axes in marks] == [2, 2]
    # One without a row of results has its own line.
    assert rates.get_yticklabels()[-1].get_text() == "9H9C, 3 m, behind"
    assert marks[0][0][0] == pytest.approx(100.0)
    assert marks[1][0][0] == pytest.approx(10.4 - 1.5)


def swept(**varied):
    """The summary of a sweep in which some columns vary."""
    found = []
    for policy in ("informed", "known"):
        for values in zip(*varied.values(), strict=True):
            extra = dict(zip(varied, values, strict=True))
            own = extra | ({} if policy == "informed" else dict.fromkeys(extra))
            own = own | {name: extra[name] for name in extra if name.startswith("sensor.")}
            found.append(row(policy, "behind", 3.0) | own)
    return {"name": "a sweep", "rows": found, "varied": [*varied, "policy"], "episodes": 400}


def test_a_sweep_s_settings_and_arms_are_named_by_what_varies():
    document = swept(**{
        "sensor.detection_probability": (0.8, 0.95), "planner.discount": (0.7, 0.9),
        "particles": (64, 256),
    })  # fmt: skip
    lines = rows.summary_lines(document)
    assert [line[0] for line in lines[:2]] == [
        "2H1C, 3 m, behind, detection probability 0.8",
        "2H1C, 3 m, behind, detection probability 0.95",
    ]
    assert [line[1] for line in lines] == [
        "informed, discount 0.7, 64 particles", "informed, discount 0.9, 256 particles",
        "known", "known",
    ]  # fmt: skip
    rates, ways = rows.summary_figure(document).axes
    assert len(rates.get_yticklabels()) == 2
    assert [len(one.containers) for one in (rates, ways)] == [4, 4]
    looks = sweep.policy_styles([line[1] for line in lines[:3]])
    assert len({look[:2] for look in looks.values()}) == 3


def test_a_sweep_too_large_for_a_figure_is_refused():
    many = swept(**{"sensor.noise": np.linspace(0, 1, rows.MAX_LINES + 1).tolist()})
    with pytest.raises(ValueError, match="49 settings, but a figure can show 48"):
        rows.summary_figure(many)


def test_reliability_panels_share_names_and_scale():
    curve = (np.array([0.2, 0.8]), np.array([0.1, 0.9]), np.array([0.0, 0.7]),
             np.array([0.3, 1.0]), np.array([10.0, 40.0]))  # fmt: skip
    figure = rows.reliability_figure(
        {"informed": {"behind": curve}, "faithful": {"behind": curve, "null": curve}}, title="T"
    )
    above, other, below, _ = figure.axes
    assert (above.get_title(loc="left"), other.get_title(loc="left")) == ("informed", "faithful")
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["behind", "null"]
    assert lines_of(above)["behind"] == pytest.approx(np.array([[0.2, 0.1], [0.8, 0.9]]))
    assert below.get_ylim()[1] > 40
    figure.draw_without_rendering()
    assert [tick.get_text() for tick in below.get_yticklabels()] == ["0", "1", "10"]
    with pytest.raises(ValueError, match="no predictions"):
        rows.reliability_figure({"informed": {}}, title="T")


def test_time_bars_are_ranked_with_shares():
    axes = rows.time_figure({"small": 10.0, "large": 30.0}).axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["large", "small"]
    assert [bar.get_width() for bar in axes.patches] == [30.0, 10.0]
    assert {text.get_text() for text in axes.texts} == {"30 µs · 75 %", "10 µs · 25 %"}
    with pytest.raises(ValueError, match="no time"):
        rows.time_figure({})
