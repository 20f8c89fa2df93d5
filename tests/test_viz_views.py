"""Other views: a terminal, the rerun viewer, whose extra is optional, and factor graphs."""

import importlib.util
import io
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.patches import Wedge
from recording_fixture import AREA, make_recording
from rich.console import Console

from jaxlangnav.grounding import load_shipped, understand_parse
from jaxlangnav.grounding.symbols import AnnotationSpace, region_symbol, relation_symbol
from jaxlangnav.language.parser import parse
from jaxlangnav.messages import BEHIND, NEAR, ROBOT
from jaxlangnav.pytree import replace
from jaxlangnav.viz import style, terminal
from jaxlangnav.viz.graph import _phrase_beliefs, _symbol_name, graph_figure
from jaxlangnav.viz.html import write_graph
from jaxlangnav.viz.rrd import write_rrd


def cell(x, y, width, height):
    column = int((x - AREA[0]) / (AREA[1] - AREA[0]) * width)
    row = int((AREA[3] - y) / (AREA[3] - AREA[2]) * height)
    return row, column


def test_things_stand_where_they_are():
    one = make_recording(9, 20)
    lines = terminal._draw_map(one.scene, one.at(6), width=52).plain.split("\n")
    height = len(lines)
    assert {len(line) for line in lines} == {52}
    assert height == round(52 * 18 / 13 / 2)
    row, column = cell(6, 1, 52, height)
    assert lines[row][column] == "C"
    robot = one.at(6).robot
    row, column = cell(robot[0], robot[1], 52, height)
    assert lines[row][column] == "→"
    waypoint = one.at(6).waypoint
    row, column = cell(waypoint[0], waypoint[1], 52, height)
    assert lines[row][column] == "×"


@pytest.mark.parametrize(
    ("heading", "arrow"), [(0, "→"), (np.pi / 2, "↑"), (np.pi, "←"), (-0.8, "↘")]
)
def test_the_arrow_turns_with_the_robot(heading, arrow):
    one = make_recording(3, 5)
    frame = replace(one.at(0), heading=np.float32(heading))
    assert arrow in terminal._draw_map(one.scene, frame, width=30).plain


def test_looked_at_ground_is_blank():
    one = make_recording(3, 5)
    nothing = np.zeros_like(one.at(0).is_hypothesised)
    frame = replace(one.at(0), is_hypothesised=nothing)
    text = terminal._draw_map(one.scene, frame, width=40).plain
    share = text.count("·") / (text.count("·") + text.count(" "))
    assert share == pytest.approx(np.mean(frame.miss >= 0.5), abs=0.08)


def test_letters_are_unique():
    letters = terminal._letters(make_recording(2, 3).scene)
    assert len(set(letters.values())) == 8
    assert letters[0] == "H"
    assert letters[1] == "C"


def test_watching_gives_the_recording():
    one = make_recording(6, 10)
    out = io.StringIO()
    console = Console(file=out, width=110, height=40)
    seen = terminal.watch(
        one.scene, [(one.at(step), one.result) for step in range(6)], console=console
    )
    assert seen.num_steps == 6
    assert np.array_equal(seen.frames.weight, one.frames.weight)
    shown = out.getvalue()
    assert "Says stop" in shown
    assert "goal seen" in shown
    assert one.scene.text in shown


def test_it_fits_a_small_screen():
    one = make_recording(3, 10)
    out = io.StringIO()
    console = Console(file=out, width=80, height=24)
    terminal.watch(one.scene, [(one.at(2), one.result)], console=console)
    lines = out.getvalue().rstrip("\n").split("\n")
    assert len(lines) <= 24
    assert max(len(line) for line in lines) <= 80
    with pytest.raises(ValueError, match="at least one step"):
        terminal.watch(one.scene, [], console=console)


HAS_RERUN = importlib.util.find_spec("rerun") is not None


def test_without_rerun_one_clear_line(monkeypatch, tmp_path):
    monkeypatch.setattr(style.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(style.MissingExtraError, match=r"pip install 'jaxlangnav\[rerun\]'"):
        write_rrd(make_recording(3, 5), tmp_path / "episode.rrd")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not HAS_RERUN, reason="the extra rerun is not installed")
def test_all_steps_are_in_the_file(tmp_path):
    path = write_rrd(make_recording(7, 12), tmp_path / "episode.rrd")
    printed = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", "-vv", str(path)],
        capture_output=True, text=True, timeout=120, check=True,
    ).stdout  # fmt: skip
    for entity in ("world/hypotheses/hydrant", "world/robot", "numbers/goal_seen", "story"):
        assert entity in printed
    assert path.stat().st_size < 10e6


PAPER = "go to the hydrant behind the cone"


@pytest.fixture(scope="module")
def model():
    return load_shipped()


def test_the_paper_s_sentence(model):
    figure = graph_figure(parse(PAPER), model)
    said = " ".join(text.get_text() for text in figure.texts)
    assert all(one in said for one in ("2,964 factors", "5,934 random variables", PAPER))
    # Phrases in reading order.
    beliefs = _phrase_beliefs(parse(PAPER), model)
    assert [one.phrase.label for one in beliefs] == ["VP", "PP", "NP", "NP", "PP", "NP"]
    assert [one.parent for one in beliefs[:3]] == [None, (0,), (0, 0)]


def test_probabilities_agree_with_annotation_inference(model):
    tree = parse(PAPER)
    space = AnnotationSpace(len(model.type_names))
    root = _phrase_beliefs(tree, model)[0].probability
    said = understand_parse(tree, model).annotations[0]
    index = space.index[relation_symbol(0, BEHIND, 1)]
    assert said["relation"] == "behind"
    # The figure conditions on the likeliest groundings of the children; inference sums over all.
    assert root[index] >= said["probability"] - 1e-6
    assert np.argmax(root) == index
    assert ((root >= 0) & (root <= 1)).all()


def test_an_untrained_model_knows_nothing_but_superlatives(model):
    parsed = parse("go to the hydrant nearest to the cone")
    for one in _phrase_beliefs(parsed, model.zeroed()):
        assert one.probability == pytest.approx(np.full(494, 0.5))
    assert max(one.rank for one in _phrase_beliefs(parsed, model)) == 1


@pytest.mark.parametrize("number", [1, 3, 5])
def test_every_phrase_shows_its_likeliest_symbols(model, number):
    figure = graph_figure(parse("go to the hydrant"), model, num_symbols=number)
    squares = [line for line in figure.axes[0].lines if line.get_marker() == "s"]
    assert len(squares) == 3 * number + 1  # and one in the key
    wedges = [patch for patch in figure.axes[0].patches if isinstance(patch, Wedge)]
    full = [one for one in wedges if one.theta2 - one.theta1 > 350]
    assert len(full) == 3  # each phrase is sure of one symbol


def test_no_symbols_are_refused(model):
    with pytest.raises(ValueError, match="num_symbols is 0"):
        graph_figure(parse("go to the hydrant"), model, num_symbols=0)


def test_symbol_names():
    types = load_shipped().type_names
    assert _symbol_name(relation_symbol(0, BEHIND, 1), types) == "hydrant behind cone"
    assert _symbol_name(region_symbol(NEAR, ROBOT), types) == "near robot"


def test_it_is_written(model, tmp_path):
    paths = write_graph(parse(PAPER), model, tmp_path)
    assert [path.name for path in paths] == ["graph.png", "graph.svg"]
    assert all(path.stat().st_size > 1000 for path in paths)
