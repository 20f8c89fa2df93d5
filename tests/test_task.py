"""One episode in one call: what it refuses, and that it is the episode of the command line."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from placed import world_file

import jaxlangnav
from jaxlangnav.inputs import program_cache


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("go to the car", {}, "no car"),
        ("the hydrant is behind the cone", {}, "asks for nothing to be done"),
        ("go to the hydrant", {"sensing_range": 0.0}, "must be positive"),
        ("go to the hydrant", {"world": "nowhere.toml"}, "nowhere.toml"),
        ("go to the hydrant", {"policy": "infromed"}, "must be one of"),
        ("go to the zorbel", {}, "zorbel"),
    ],
)
def test_refusals_are_one_line(text: str, options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        jaxlangnav.follow(text, **options)
    assert "\n" not in str(caught.value)


@pytest.fixture
def as_commands_do(tmp_path: Path) -> Iterator[None]:
    """Keep programs, as commands do: the episode's is then the one that their tests compile."""
    program_cache.set_cache_dir(tmp_path / "programs")
    yield
    program_cache.set_cache_dir(None)


@pytest.mark.usefixtures("as_commands_do")
def test_a_world_file_is_followed_and_judged(tmp_path: Path) -> None:
    path = tmp_path / "world.toml"
    area, it = (0.0, 6.0, -3.0, 3.0), {"x": 4.0, "y": 0.0}
    path.write_text(world_file(area, ("cone", 4.0, 0.0), goal=it), encoding="utf-8")
    recording = jaxlangnav.follow("go to the cone", world=path, seed=1)
    assert bool(recording.result.is_success)
    assert np.hypot(*(np.asarray(recording.result.final) - [4.0, 0.0])) <= 1.5
    assert recording.scene.text == "go to the cone"
    assert abs(recording.scene.known_distance - 4.0) < 1.6
    again = jaxlangnav.follow("go to the cone", world=path, seed=1)
    np.testing.assert_array_equal(again.frames.waypoint, recording.frames.waypoint)
