"""``follow``: the document scripts read, the goal that is meant, pictures, live view, refusals."""

import dataclasses
import importlib.util
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from placed import world_file
from recording_fixture import make_recording
from test_cli_hostile import document, refused
from test_docs import frozen

import jaxlangnav
from jaxlangnav.cli import main as cli
from jaxlangnav.cli.settings import apply_to_episode
from jaxlangnav.experiments.tasks import Cell, make_tasks
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.inputs import program_cache
from jaxlangnav.messages import Status
from jaxlangnav.pytree import replace
from jaxlangnav.task.follow import follow as follow_text, params_and_config, prepare_episode, score
from jaxlangnav.task.labelled import intended_goals
from jaxlangnav.task.loading import PreparedTask, detector_of, load_task, step_limit
from jaxlangnav.viz.narrative import closing
from jaxlangnav.world.files import open_world

COMMAND = "go to the hydrant behind the cone"
KEYS = {
    name: kind
    for kind, names in (
        (str, "instruction world policy ending"), (int, "seed steps"), (bool, "success stopped"),
        (float, "distance known_distance"),
        (list, "missing goal trajectory annotations pictures"),
    )
    for name in names.split()
}  # fmt: skip


def follow(words: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    return document(["follow", *words], capsys)


@pytest.mark.parametrize("world", ["2H1C", "yard"])
def test_what_is_rehearsed_is_what_is_run(world, capsys, monkeypatch):
    """The thread that compiles ahead compiles the program of the episode."""
    programs: list[tuple[str, str]] = []
    name_of = program_cache._cache_key

    def spy(function: Any, *rest: Any) -> str:
        programs.append((function.__name__, name_of(function, *rest)))
        return programs[-1][1]

    monkeypatch.setattr(program_cache, "_cache_key", spy)
    document = follow([COMMAND, "--world", world], capsys)
    for function, times in (("begin", 2), ("_advance", document["steps"] + 1)):
        names = [name for one, name in programs if one == function]
        assert len(names) == times
        assert len(set(names)) == 1


def test_the_document_has_the_agreed_keys(capsys: pytest.CaptureFixture[str]) -> None:
    document = follow([COMMAND], capsys)
    assert {key: type(document[key]) for key in KEYS} == KEYS
    assert document["instruction"] == COMMAND
    assert (document["world"], document["policy"], document["seed"]) == ("1H1C", "informed", 0)
    assert document["range"] == 3.0
    assert document["success"]
    assert document["stopped"]
    assert (document["ending"], document["missing"]) == ("arrived", [])
    trajectory = np.array(document["trajectory"])
    assert trajectory.shape == (document["steps"] + 1, 2)
    assert trajectory[0].tolist() == [0.0, 0.0]
    lengths = np.linalg.norm(np.diff(trajectory, axis=0), axis=1)
    assert lengths.sum() == pytest.approx(document["distance"], abs=1e-3)
    end = math.dist(trajectory[-1], document["goal"])
    assert end == pytest.approx(document["goal_distance"], abs=1e-3)
    assert end <= 1.5
    assert math.hypot(*document["goal"]) == pytest.approx(document["known_distance"], abs=1e-3)
    assert document["annotations"][0]["relation"] == "behind"
    assert document["pictures"] == []


SHOWN = [one for page in frozen.pages() for one in frozen.shown(page) if " follow " in one[0]]


@pytest.mark.parametrize(("command", "text"), SHOWN)
def test_the_pages_show_what_is_printed(command: str, text: str, tmp_path: Path) -> None:
    """If this fails: make frozen."""
    pytest.importorskip("matplotlib")
    assert frozen.printed(command, tmp_path) == text


def test_live_draws_and_ends_with_the_verdict(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["follow", COMMAND, "--live"]) == 0
    told = capsys.readouterr().out
    assert "looked at" in told
    assert "\nSuccess: " in told
    assert follow([COMMAND, "--live"], capsys)["success"]


def test_settings_reach_the_world_and_the_filter_which_estimates_drift_if_there_is_any() -> None:
    understood = understand(COMMAND, load_shipped())
    still = prepare_episode(understood, open_world("1H1C"), None, "informed", 0, 8)
    opened = apply_to_episode(still, {("motion", "heading_bias"): 0.01, ("sensor", "noise"): 0.2})
    assert opened.config.map.has_drift > still.config.map.has_drift
    assert opened.params.map.motion is opened.prepared.task.motion
    assert float(opened.prepared.task.motion.heading_bias) == pytest.approx(0.01)
    assert float(opened.prepared.task.sensor.noise) == pytest.approx(0.2)


def test_pictures_are_written_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    kinds = ["gif", *(["rrd"] if importlib.util.find_spec("rerun") else [])]
    out = tmp_path / "new" / "folder"
    document = follow([COMMAND, *(f"--{kind}" for kind in kinds), "--out", str(out)], capsys)
    pictures = [Path(name) for name in document["pictures"]]
    named = {"belief.png", "values.png", "episode.html", *(f"episode.{kind}" for kind in kinds)}
    assert {path.name for path in pictures} >= named
    assert all(path.stat().st_size > 100 for path in pictures)
    assert json.loads((out / "episode.json").read_text("utf-8")) == document


@pytest.mark.parametrize(
    ("kind", "library", "extra"), [("rrd", "rerun", "rerun"), ("mp4", "cv2", "robot")]
)
def test_a_kind_of_recording_says_what_it_needs(
    tmp_path, capsys, monkeypatch, kind, library, extra
):
    asked = ["follow", COMMAND, f"--{kind}"]
    told = refused(asked, capsys)
    assert f"--{kind} writes episode.{kind} into the folder of --out" in told
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == library else found(name)
    )
    told = refused([*asked, "--out", str(tmp_path)], capsys)
    assert f'pip install "jaxlangnav[{extra}]"' in told


def test_numbers_on_the_command_line_reach_the_engine(capsys: pytest.CaptureFixture[str]) -> None:
    """A robot that steps 2 m at a time, in the world and in its own mind, needs fewer steps."""
    plain = follow([COMMAND], capsys)
    fast = follow([COMMAND, "--motion.step-length", "200 cm"], capsys)
    assert fast["goal"] == plain["goal"]
    steps = np.linalg.norm(np.diff(np.array(fast["trajectory"]), axis=0), axis=1)
    assert steps.max() == pytest.approx(2.0, abs=0.2)
    plain_steps = np.linalg.norm(np.diff(np.array(plain["trajectory"]), axis=0), axis=1)
    assert plain_steps.max() == pytest.approx(1.0, abs=0.1)


def prepare(text: str, world: str, seed: int = 0) -> PreparedTask:
    understood = understand(text, load_shipped())
    return load_task(open_world(world), understood, sensing_range=None, seed=seed)


def places(prepared: PreparedTask) -> dict[str, list[np.ndarray]]:
    scenario = prepared.task.scenario
    found: dict[str, list[np.ndarray]] = {"hydrant": [], "cone": []}
    for slot in np.flatnonzero(np.asarray(scenario.is_object)):
        name = ("hydrant", "cone")[int(scenario.object_type[slot])]
        found[name].append(np.array([scenario.object_x[slot], scenario.object_y[slot]]))
    return found


def test_the_goal_is_the_thing_meant() -> None:
    prepared = prepare("go to the cone", "1H1C")
    np.testing.assert_allclose(prepared.task.scenario.goal, places(prepared)["cone"][0], atol=1e-5)
    assert int(prepared.task.scenario.goal_index) == 1
    assert not prepared.is_find_task
    assert prepare("find the hydrant", "1H1C").is_find_task


def test_a_region_is_judged_at_its_typical_place() -> None:
    # Behind, seen from the start: 2.4 m further along the line of sight.
    prepared = prepare("move behind the cone", "1H1C")
    cone = places(prepared)["cone"][0]
    away = cone / np.linalg.norm(cone)
    np.testing.assert_allclose(prepared.task.scenario.goal, cone + 2.4 * away, atol=1e-3)
    assert int(prepared.task.scenario.goal_index) == -1
    # To the right of it: 2.4 m across the line of sight, clockwise.
    prepared = prepare("park to the right of the cone", "1H1C")
    right = np.array([away[1], -away[0]])
    np.testing.assert_allclose(prepared.task.scenario.goal, cone + 2.4 * right, atol=1e-3)


def test_the_worlds_of_the_tables_keep_their_goal() -> None:
    """With two hydrants and no relation, the lot decides which is meant, not the robot's model."""
    for text, relation in (("go to the hydrant", "null"), (COMMAND, "behind")):
        prepared = prepare(text, "2H1C", seed=1)
        drawn = make_tasks(Cell(world="2H1C", relation=relation, seed=1), 1).scenario
        np.testing.assert_array_equal(prepared.task.scenario.goal, drawn.goal[0])
        np.testing.assert_array_equal(prepared.task.scenario.object_x, drawn.object_x[0])


def test_a_world_is_drawn_in_which_the_sentence_is_true() -> None:
    prepared = prepare("go to the hydrant in front of the cone", "1H1C")
    assert prepared.goal_exists
    hydrant, cone = places(prepared)["hydrant"][0], places(prepared)["cone"][0]
    assert (hydrant - cone) @ cone < 0


def test_the_known_way_goes_by_where_earlier_commands_end(tmp_path):
    world, text = bare(tmp_path / "park.toml", 4), "go to the bench then go to the car"
    understood = understand(text, load_shipped(), detector_of(open_world(world), ()))
    (goals, car), _ = intended_goals(understood, open_world(world).scenario)
    assert (goals[0].position, car[0].position) == ((18.0, -9.0), (6.0, 0.0))
    found = follow_text(text, world=world, max_steps=1).scene
    assert found.known_distance == pytest.approx(math.hypot(18.0, 9.0) + math.hypot(12.0, 9.0))
    task = load_task(open_world(world), understood, sensing_range=None, seed=0).task
    slow = replace(task, motion=replace(task.motion, step_length=np.float32(0.5)))
    assert [step_limit(one) for one in (task, slow)] == [3 * 400 / 6.0, 3 * 400 / 3.0]
    with pytest.raises(ValueError, match="max_steps"):
        follow_text(text, world=world, max_steps=0)


def bare(path: Path, number: int) -> str:
    """Write a world without a goal: a car, statues behind it, one of them on the left."""
    things = [("car", 6.0, 0.0), ("statue", 9.0, 0.0), ("statue", 5.0, 8.0)]
    things += [("bench", 18.0, -9.0 + 1.5 * i) for i in range(number - len(things))]
    path.write_text(world_file((0.0, 20.0, -10.0, 10.0), *things))
    return str(path)


def test_a_world_of_own_nouns_needs_no_lexicon(tmp_path, capsys):
    world = bare(tmp_path / "park.toml", 4)
    document = follow(["go to the statue behind the car", "--world", world, "--range", "4"], capsys)
    assert document["success"]
    said = document["annotations"][0]
    assert (said["figure"], said["relation"], said["landmark"]) == ("statue", "behind", "car")
    assert "'kiosk' (word 4): my detector has no label for it" in refused(
        ["follow", "go to the kiosk", "--world", world, "--json"], capsys
    )


def prepare_own(text: str, world: str) -> PreparedTask:
    source = open_world(world)
    understood = understand(text, load_shipped(), detector_of(source, ()))
    return load_task(source, understood, sensing_range=None, seed=0)


def test_a_world_without_a_goal_is_judged_by_what_is_said(tmp_path: Path) -> None:
    world = bare(tmp_path / "bare.toml", 4)
    prepared = prepare_own("go to the statue behind the car", world)
    assert prepared.goal_exists
    assert int(prepared.task.scenario.goal_index) == 1
    # Its start stands in for a goal, and is none: here nothing fits.
    nothing = prepare_own("go to the bench behind the statue in front of the car", world)
    assert not nothing.goal_exists
    assert nothing.unscored == "nothing there fits the sentence (no statue is in front of the car)"


def test_a_world_without_a_goal_is_not_judged_where_several_fit_alike(tmp_path: Path) -> None:
    """Two statues and no word of which: whoever stands at one of them has not failed."""
    world = bare(tmp_path / "bare.toml", 4)
    assert not prepare_own("go to the statue behind the car", world).unscored
    either = prepare_own("go to the statue", world)
    assert either.unscored == "2 places fit the sentence alike, and nothing says which is meant"
    recording = make_recording(3, 5)
    end = replace(recording.result, ending=np.int32(Status.ARRIVED), goal_distance=np.float32(8.3))
    found = score(dataclasses.replace(recording, result=end), either)
    assert "Cannot be judged: 2 places" in " ".join(
        closing(found.last_scene, found.at(-1), found.result)
    )
    # A simulated person has one of them in mind.
    assert score(recording, either, has_person=True).scene.is_scored


@pytest.mark.parametrize(("number", "slots"), [(4, 8), (12, 16)])
def test_crowded_worlds_get_the_sizes_for_places_as_they_are(number, slots, tmp_path):
    world = bare(tmp_path / "bare.toml", number)
    params, config = params_and_config(open_world(world), "informed", 32)
    assert config.map.num_particles == 32
    assert config.map.has_doubts == (slots > 8)
    # The search prior is of the worlds of the templates: nowhere else is it of use.
    assert float(params.planner.prior_share) == 0.0
    assert float(params_and_config(open_world("1H1C"), "informed", 32)[0].planner.prior_share) > 0.0


# ``jaxlangnav.follow``: the same in one call.


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("go to the car", {}, "no car"),
        ("the hydrant is behind the cone", {}, "asks for nothing to be done"),
        ("go to the hydrant", {"sensing_range": 0.0}, "range_max is .*give metres"),
        ("go to the hydrant", {"world": "nowhere.toml"}, "nowhere.toml"),
        ("go to the hydrant", {"policy": "infromed"}, "must be one of"),
        ("go to the hydrant", {"seed": 1.5}, r"seed is 1\.5, but must be a whole number"),
        ("go to the zorbel", {}, "zorbel"),
    ],
)
def test_a_refusal_of_the_function_is_one_line(text: str, options: dict, message: str) -> None:
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
