"""Views: a terminal, the rerun viewer, whose extra is optional, factor graphs, and the page."""

import base64
import dataclasses
import importlib.util
import io
import json
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.patches import Wedge
from pages import Page
from PIL import Image
from recording_fixture import AREA, make_recording
from rich.console import Console

from jaxlangnav.language.parser import parse
from jaxlangnav.pytree import replace
from jaxlangnav.viz import style, terminal
from jaxlangnav.viz.film import write_film
from jaxlangnav.viz.graph import graph_figure
from jaxlangnav.viz.html import page_data, render_html, write_html
from jaxlangnav.viz.rrd import write_rrd


def cell(x, y, width, height):
    column = int((x - AREA[0]) / (AREA[1] - AREA[0]) * width)
    return int((AREA[3] - y) / (AREA[3] - AREA[2]) * height), column


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


def test_a_film_shows_every_step_beside_what_the_cameras_saw(tmp_path):
    one = make_recording(3, 5)
    picture = io.BytesIO()
    Image.new("RGB", (40, 30), "red").save(picture, "JPEG")
    seen = {"camera": picture.getvalue()}
    one = dataclasses.replace(one, pictures=({}, *[seen] * (one.num_steps - 1)))
    with Image.open(write_film(one, tmp_path / "run.gif")) as film:
        assert (film.size, film.n_frames) == ((920, 480), one.num_steps)
        film.seek(film.n_frames - 1)
        right = np.asarray(film.convert("RGB"))[100:380, 470:910].reshape(-1, 3)
    assert (np.abs(right - np.array([254, 0, 0])).max(axis=1) < 12).mean() > 0.3
    with pytest.raises(ValueError, match=r"run.avi is no film: its name must end in \.gif or"):
        write_film(one, tmp_path / "run.avi")


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


def test_the_paper_s_sentence(model):
    said = " ".join(text.get_text() for text in graph_figure(parse(PAPER), model).texts)
    assert all(one in said for one in ("2,964 factors", "5,934 random variables", PAPER))


def test_every_phrase_shows_its_likeliest_symbols(model):
    figure = graph_figure(parse("go to the hydrant"), model)
    squares = [line for line in figure.axes[0].lines if line.get_marker() == "s"]
    assert len(squares) == 3 * 3 + 1  # and one in the key
    wedges = [patch for patch in figure.axes[0].patches if isinstance(patch, Wedge)]
    full = [one for one in wedges if one.theta2 - one.theta1 > 350]
    assert len(full) == 3  # each phrase is sure of one symbol


HOSTILE = "</script><script>alert(1)</script><!-- __DATA__ __TITLE__ \x1b[31m \u202e <b> & \"'"
KINDS = {"f4": "<f4", "u2": "<u2", "u1": "u1"}
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
OFFLINE = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--virtual-time-budget=3000",
)  # fmt: skip


def read(recording):
    page = Page(render_html(recording))
    return page, json.loads(page.data)


def array(data, name):
    entry = data["arrays"][name]
    return np.frombuffer(base64.b64decode(entry["data"]), KINDS[entry["kind"]])


def test_it_needs_nothing_from_outside():
    text = render_html(make_recording(4, 10))
    page = Page(text)
    assert page.links == []
    assert not re.search(r"https?://|@import|url\(", text)
    assert {"map", "slider", "play", "story", "bars", "chart", "tip"} <= set(page.ids)


def test_all_steps_are_in_it():
    one = make_recording(9, 20)
    _, data = read(one)
    assert data["num_steps"] == 9
    for name in ("story", "headlines", "objects", "detections", "news", "is_done"):
        assert len(data[name]) == 9, name
    assert array(data, "distance") == pytest.approx(one.frames.distance)
    assert array(data, "position").reshape(9, 2) == pytest.approx(one.frames.position)
    assert len(data["objects"][0]) == 0
    assert len(data["objects"][-1]) == 2
    assert all(data["story"])


def test_hypotheses_survive_the_packing():
    one = make_recording(9, 20)
    _, data = read(one)
    mentions, frames = data["num_mentions"], one.frames
    x = array(data, "x").reshape(9, mentions, 20)
    is_in = frames.is_hypothesised[:, :mentions]
    assert np.array_equal(x != 65535, is_in)
    low, high = data["bounds"][:2]
    unpacked = low + x / 65534 * (high - low)
    assert unpacked[is_in] == pytest.approx(frames.hypothesis_x[:, :mentions][is_in], abs=1e-3)
    kinds = array(data, "type").reshape(x.shape)
    assert np.array_equal(kinds[is_in], frames.mention_type[:, :mentions][is_in])
    weight = array(data, "weight").reshape(9, 20) / 65535 * array(data, "max_weight")[:, None]
    assert weight == pytest.approx(frames.weight, rel=1e-4)
    assert np.array_equal(array(data, "value").reshape(9, -1), frames.value)


def test_pictures_of_a_robot_go_with_their_steps():
    one = make_recording(3, 5)
    assert page_data(one)["camera_images"] == []
    pictures = tuple({"From outside": b"\xff\xd8" + bytes([step])} for step in range(3))
    page, data = read(dataclasses.replace(one, pictures=pictures, end_reason="blocked: <no way>"))
    assert "views" in page.ids
    kept = [base64.b64decode(step["From outside"]) for step in data["camera_images"]]
    assert kept == [step["From outside"] for step in pictures]
    assert data["outcome"] == "blocked"
    assert data["closing"][0] == "Blocked: <no way>."


def test_200_steps_of_256_particles_are_small(tmp_path):
    assert write_html(make_recording(200, 256), tmp_path / "long.html").stat().st_size < 10e6


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
def test_it_runs_in_a_browser(tmp_path):
    path = write_html(make_recording(9, 20), tmp_path / "episode.html")
    dom = subprocess.run(
        [
            CHROMIUM, *OFFLINE, f"--user-data-dir={tmp_path}/profile", "--dump-dom",
            f"{path.as_uri()}#step=8",
        ],
        capture_output=True, text=True, timeout=120, check=True,
    ).stdout  # fmt: skip
    body = re.search(r"<body[^>]*>", dom).group()
    assert 'data-ready="9"' in body
    assert "data-error" not in body
    assert "Step 8: says stop" in dom
    assert "step 8 of 8" in dom
    assert "Success: it stands 0.5 m" in dom


def test_a_hostile_sentence_is_only_text():
    recording = make_recording()
    scene = dataclasses.replace(recording.scene, text=HOSTILE)
    text = render_html(dataclasses.replace(recording, scene=scene))
    page = Page(text)
    assert "alert(1)</script>" not in text
    assert not any(one in text for one in ("\x1b", "\u202e", "<b>"))
    assert json.loads(page.data)["text"] == HOSTILE.replace("\x1b", r"\x1b").replace(
        "\u202e", r"\u202e"
    )
    assert text.count('id="data"') == 1
