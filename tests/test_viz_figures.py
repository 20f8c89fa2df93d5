"""Figures: what is drawn is what was recorded, point by point; files are whole."""

import dataclasses
import sys
import xml.etree.ElementTree as ET

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image
from recording_fixture import make_recording

from jaxlangnav.pytree import replace
from jaxlangnav.terrain.geodesic import among_walls
from jaxlangnav.viz import html, mapping, panels, style
from jaxlangnav.viz.narrative import describe_collision, narrate
from jaxlangnav.viz.panels import belief_figure, values_figure
from jaxlangnav.viz.summary import distinct_nodes


@pytest.fixture(scope="module")
def one():
    return make_recording(9, 20)


def axes_of(recording):
    axes = Figure().add_subplot()
    axes.set(xlim=recording.scene.area[:2], ylim=recording.scene.area[2:])
    return axes


def marks(recording, draw, *args, **options):
    draw(axes := axes_of(recording), *args, **options)
    return axes.collections


def test_every_hypothesis_is_a_point(one):
    for step in (0, 5, 8):
        frame = one.at(step)
        drawn = marks(one, mapping.draw_hypotheses, frame)
        points = np.concatenate([part.get_offsets() for part in drawn] or [np.zeros((0, 2))])
        assert len(points) == frame.is_hypothesised.sum()
        held = frame.hypothesis_x[frame.is_hypothesised]
        assert sorted(points[:, 0]) == pytest.approx(sorted(held))


def test_a_heavier_particle_is_drawn_stronger(one):
    frame = one.at(0)
    drawn = marks(one, mapping.draw_hypotheses, frame)[0]
    chosen = frame.is_hypothesised & (frame.mention_type == 0)
    order = np.argsort(np.broadcast_to(frame.weight, chosen.shape)[chosen])
    assert (np.diff(drawn.get_facecolors()[order, 3]) >= -1e-9).all()
    assert (np.diff(drawn.get_sizes()[order]) >= -1e-9).all()
    # In the value figure hypotheses are empty.
    assert not marks(one, mapping.draw_hypotheses, frame, filled=False)[0].get_facecolors().size


def test_seen_objects_truth_and_a_path_that_ends_at_the_robot(one):
    assert len(marks(one, mapping.draw_objects, one.at(0))) == 0
    assert len(marks(one, mapping.draw_objects, one.at(-1))) == 2
    assert len(marks(one, mapping.draw_truth, one.scene)) == 2
    mapping.draw_path(axes := axes_of(one), one, 5)
    (line,) = axes.lines
    assert line.get_xydata()[-1] == pytest.approx(one.frames.position[5])
    assert len(line.get_xydata()) == 6
    unscored = dataclasses.replace(one, scene=dataclasses.replace(one.scene, is_scored=False))
    assert len(mapping.legend_handles(unscored)) == len(mapping.legend_handles(one)) - 1


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5])
def test_the_robot_points_where_it_heads(heading):
    one = make_recording(3, 5)
    (mark,) = marks(one, mapping.draw_robot, replace(one.at(1), heading=np.float32(heading)))
    tip = mark.get_paths()[0].vertices[0]
    assert np.arctan2(tip[1], tip[0]) == pytest.approx(heading, abs=1e-5)


def test_nodes_carry_their_values_and_the_best_are_in_order_and_open(one):
    frame = one.at(8)
    nodes = next(part for part in marks(one, panels._draw_values, one, 8) if part.zorder == 5)
    values = np.sort(frame.value[np.isfinite(frame.value)])
    assert np.sort(np.asarray(nodes.get_array())) == pytest.approx(values)
    best = distinct_nodes(frame)[:5]
    assert frame.value[best[0]] == pytest.approx(0.9)
    assert (np.diff(frame.value[best]) <= 0).all()
    assert len(distinct_nodes(frame)) == np.isfinite(frame.value).sum()


def test_nodes_that_stand_together_are_one_place():
    frame = make_recording(9, 20).at(7)
    x, y, value = (np.array(leaf) for leaf in (frame.node_x, frame.node_y, frame.value))
    best = distinct_nodes(frame)
    # A copy beside the best place, worth a little less, is no other place; far off it is.
    x[0], y[0], value[0] = x[best[0]] + 0.1, y[best[0]], value[best[0]] - 0.01
    beside = replace(frame, node_x=x, node_y=y, value=value)
    assert 0 not in distinct_nodes(beside)
    far = replace(beside, node_x=np.where(np.arange(len(x)) == 0, x + 2.0, x))
    assert distinct_nodes(far)[1] == 0


def test_bars_add_up_to_the_value_and_where_it_stops_the_reason_stands_instead(one):
    axes, frame = axes_of(one), one.at(7)
    panels._draw_value_terms(axes, frame)
    best = distinct_nodes(frame)[: panels.NUM_BARS]
    widths = np.array([bar.get_width() for bar in axes.patches]).reshape(3, len(best))
    assert widths.sum(axis=0) == pytest.approx(frame.value[best], abs=1e-6)
    axes = axes_of(one)
    panels._draw_value_terms(axes, one.at(8))
    assert not axes.patches
    assert "with probability 90 %" in axes.texts[0].get_text()
    axes = axes_of(one)
    panels._draw_values(axes, one, 8)
    assert not axes.texts


def test_the_best_waypoints_are_numbered_where_they_stand(one):
    axes, frame = axes_of(one), one.at(7)
    panels._draw_values(axes, one, 7)
    best = distinct_nodes(frame)[: panels.NUM_BARS]
    places = zip(frame.node_x[best], frame.node_y[best], strict=True)
    assert [(text.get_text(), text.xy) for text in axes.texts] == [
        (str(rank), place) for rank, place in enumerate(places, start=1)
    ]


def test_walls_are_drawn_and_told_and_one_that_halts_the_robot_too():
    one = make_recording(9, 20)
    x, y = one.frames.position[3] + [0.25, 0.0]
    terrain = among_walls((x, y - 2, x, y + 2), (0, 5, 3, 5))
    scene = dataclasses.replace(one.scene, scenario=replace(one.scene.scenario, terrain=terrain))
    one = dataclasses.replace(one, scene=scene)
    axes = axes_of(one)
    panels.draw_belief(axes, one, 3)
    drawn = [line.get_xydata().tolist() for line in axes.lines if line.get_color() == style.WALL]
    assert drawn == pytest.approx(np.reshape(terrain.view.ends[:2], (2, 2, 2)))
    assert "two walls and nothing that stands there" in narrate(one)[3]
    assert describe_collision(one.steps[3])
    assert html.page_data(one)["walls"] == terrain.view.ends[:2].tolist()


@pytest.mark.parametrize("policy", ["faithful", "informed"])
@pytest.mark.parametrize("number", [1, 3, 6])
def test_figures_have_their_panels(policy, number):
    one = make_recording(9, 20, policy=policy)
    assert len(belief_figure(one, num_panels=number).axes) == number
    assert len(values_figure(one, num_panels=number).axes) == 2 * number


def test_panels_say_step_and_way(one):
    figure = belief_figure(one, steps=[0, -1])
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles == ["(a) step 0 · 0.0 m", "(b) step 8 · 8.6 m"]
    assert any(one.scene.text in text.get_text() for text in figure.texts)
    assert figure.axes[0].get_xlabel() == "x (m)"
    assert figure.axes[0].get_ylabel() == "y (m)"


@pytest.mark.parametrize("words", [8, 20, 40])
def test_texts_stay_on_the_page(words):
    # A headline that runs off the paper was the first fault of the first figure.
    text = " ".join(["hydrants"] * words)
    figure = belief_figure(make_recording(9, 20, text=text), num_panels=1)
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    renderer = FigureCanvasAgg(figure).get_renderer()
    for text in figure.texts:
        box = text.get_window_extent(renderer)
        assert box.x0 >= 0
        assert box.x1 <= figure.bbox.x1, text.get_text()


@pytest.mark.parametrize(
    ("steps", "said"), [([9], "step is 9"), ([-10], "step is -10"), ([], "steps is empty")]
)
def test_unknown_moments_are_refused(steps, said):
    with pytest.raises(ValueError, match=said):
        panels._choose_steps(make_recording(9, 5), steps, 4)


def test_pictures_are_whole_files(tmp_path):
    paths = html.write_report_files(make_recording(5, 12), tmp_path / "new" / "folder")
    assert [path.name for path in paths] == [
        "belief.png", "belief.svg", "values.png", "values.svg", "episode.html", "story.txt",
    ]  # fmt: skip
    for path in paths:
        assert path.stat().st_size > 200
        if path.suffix == ".png":
            with Image.open(path) as image:
                image.load()
                assert min(image.size) > 400
        if path.suffix == ".svg":
            assert ET.parse(path).getroot().tag.endswith("svg")
    # Nothing half-written is left behind.
    assert len(list((tmp_path / "new" / "folder").iterdir())) == len(paths)


def test_the_same_figure_is_the_same_file(tmp_path):
    one = make_recording(4, 10)
    for name in ("one", "two"):
        style.save(belief_figure(one, num_panels=2), tmp_path / name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


def test_the_house_style_does_not_leak():
    before = dict(matplotlib.rcParams)
    belief_figure(make_recording(3, 5), num_panels=1)
    assert dict(matplotlib.rcParams) == before
    assert "matplotlib.pyplot" not in sys.modules or matplotlib.get_backend()


def test_without_matplotlib_one_clear_line(monkeypatch):
    monkeypatch.setattr(style.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(style.MissingExtraError, match=r"pip install 'jaxlangnav\[viz\]'") as error:
        belief_figure(make_recording(3, 5))
    assert "\n" not in str(error.value)


def test_colours_of_neighbouring_types_differ_in_grey():
    # Colours alone never carry a meaning; hydrant and cone must also differ in print.
    def lightness(color):
        red, green, blue = (int(color[at : at + 2], 16) / 255 for at in (1, 3, 5))
        return 0.2126 * red**2.2 + 0.7152 * green**2.2 + 0.0722 * blue**2.2

    assert len(set(style.TYPE_MARKERS)) == len(style.TYPE_COLORS) == 8
    assert len({(style.type_color(kind), style.type_marker(kind)) for kind in range(64)}) == 64
    assert abs(lightness(style.TYPE_COLORS[0]) - lightness(style.TYPE_COLORS[1])) > 0.05
    stops = [lightness(stop) for stop in style.VALUE_STOPS]
    assert stops == sorted(stops, reverse=True)
