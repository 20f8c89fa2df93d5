"""The export for the rerun viewer; the extra is optional, so is most of this file."""

import importlib.util
import subprocess
import sys

import pytest
from recording_fixture import make_recording

from jaxlangnav.viz import style
from jaxlangnav.viz.rrd import write_rrd

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
