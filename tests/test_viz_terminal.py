"""The live view: a map of characters that says the same as the frame."""

import io

import numpy as np
import pytest
from recording_fixture import AREA, make_recording
from rich.console import Console

from jaxlangnav.pytree import replace
from jaxlangnav.viz import terminal


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
