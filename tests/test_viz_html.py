"""The interactive recording: one file, everything in it, small, fast, and it runs in a browser."""

import base64
import dataclasses
import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from pages import Page
from recording_fixture import make_recording

from jaxlangnav.viz.html import _page_data, _render_html, write_html

HOSTILE = "</script><script>alert(1)</script><!-- __DATA__ __TITLE__ \x1b[31m \u202e <b> & \"'"
KINDS = {"f4": "<f4", "u2": "<u2", "u1": "u1"}
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
OFFLINE = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--virtual-time-budget=3000",
)  # fmt: skip


def read(recording):
    page = Page(_render_html(recording))
    return page, json.loads(page.data)


def array(data, name):
    entry = data["arrays"][name]
    return np.frombuffer(base64.b64decode(entry["data"]), KINDS[entry["kind"]])


def test_it_needs_nothing_from_outside():
    text = _render_html(make_recording(4, 10))
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
    low, high = data["frame"][:2]
    unpacked = low + x / 65534 * (high - low)
    assert unpacked[is_in] == pytest.approx(frames.hypothesis_x[:, :mentions][is_in], abs=1e-3)
    kinds = array(data, "type").reshape(x.shape)
    assert np.array_equal(kinds[is_in], frames.mention_type[:, :mentions][is_in])
    weight = array(data, "weight").reshape(9, 20) / 65535 * array(data, "heaviest")[:, None]
    assert weight == pytest.approx(frames.weight, rel=1e-4)
    assert np.array_equal(array(data, "value").reshape(9, -1), frames.value)


def test_pictures_of_a_robot_go_with_their_steps():
    one = make_recording(3, 5)
    assert _page_data(one)["pictures"] == []
    pictures = tuple({"From outside": b"\xff\xd8" + bytes([step])} for step in range(3))
    page, data = read(dataclasses.replace(one, pictures=pictures, ended="blocked: <no way>"))
    assert "views" in page.ids
    kept = [base64.b64decode(step["From outside"]) for step in data["pictures"]]
    assert kept == [step["From outside"] for step in pictures]
    assert data["outcome"] == "blocked"
    assert data["closing"][0] == "Blocked: <no way>."


def test_no_hypotheses_at_all():
    one = make_recording(3, 5)
    frames = one.frames
    object.__setattr__(frames, "is_hypothesised", np.zeros_like(frames.is_hypothesised))
    assert _page_data(one)["num_mentions"] == 0


def test_200_steps_of_256_particles_are_small(tmp_path):
    path = write_html(make_recording(200, 256), tmp_path / "long.html")
    assert path.stat().st_size < 10e6


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
    text = _render_html(dataclasses.replace(recording, scene=scene))
    page = Page(text)
    assert "alert(1)</script>" not in text
    assert not any(one in text for one in ("\x1b", "\u202e", "<b>"))
    assert json.loads(page.data)["text"] == HOSTILE.replace("\x1b", r"\x1b").replace(
        "\u202e", r"\u202e"
    )
    assert text.count('id="data"') == 1
