"""World files: what is read, what is written back, and every complaint."""

import copy
import tomllib
from pathlib import Path

import chex
import jax
import numpy as np
import pytest
from placed import world_file

from jaxlangnav.inputs.object_types import attribute_code
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.messages import NONE, default_motion, default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.world.files import (
    WorldFile,
    load_world,
    open_world,
    save_world,
    shipped_worlds,
    world_from_dict,
    world_to_dict,
)
from jaxlangnav.world.scenario import sample_scenario
from jaxlangnav.world.simulator import known_distance
from jaxlangnav.world.state import CONE, HYDRANT, walls_of
from jaxlangnav.world.templates import Template

YARD = """
name = "yard"
instruction = "go to the hydrant behind the cone"
[area]
x_min = 0
x_max = 13.0
y_min = -9.0
y_max = 9.0
[start]
x = 1.0
y = -2.0
heading = 90
[goal]
object = "far hydrant"
[[objects]]
type = "cone"
x = 6.5
y = 1.0
[[objects]]
type = "hydrant"
name = "far hydrant"
x = 9.0
y = 1.5
[sensor]
range = 5.0
field_of_view = 120
"""


def write(folder: Path, text: str, name: str = "yard.toml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_is_read(tmp_path: Path) -> None:
    world = load_world(write(tmp_path, YARD))
    scenario = world.scenario
    assert (world.name, world.instruction) == ("yard", "go to the hydrant behind the cone")
    np.testing.assert_array_equal(scenario.object_type, [1, 0] + [NONE] * 6)
    np.testing.assert_allclose(scenario.object_x, [6.5, 9.0] + [0] * 6)
    np.testing.assert_allclose(scenario.object_y, [1.0, 1.5] + [0] * 6)
    np.testing.assert_array_equal(scenario.is_object, [True] * 2 + [False] * 6)
    np.testing.assert_allclose(scenario.goal, [9.0, 1.5])
    assert int(scenario.goal_index) == 1
    np.testing.assert_allclose(scenario.start, [1.0, -2.0, np.pi / 2], rtol=1e-6)
    np.testing.assert_allclose(scenario.area, [0, 13, -9, 9])
    np.testing.assert_allclose(world.sensor.range_max, 5.0)
    np.testing.assert_allclose(world.sensor.field_of_view, 2 * np.pi / 3, rtol=1e-6)
    np.testing.assert_allclose(world.sensor.noise, 0.1)
    np.testing.assert_allclose(world.motion.odometry_noise, 0.02)
    assert world.object_names[:3] == ("", "far hydrant", "")


def test_defaults(tmp_path: Path) -> None:
    area = "[area]\nx_min=-1\nx_max=9\ny_min=-5\ny_max=5\n"
    text = area + '[goal]\nx=5\ny=1\n[[objects]]\ntype="box"\nx=4\ny=0\n'
    world = load_world(write(tmp_path, text, "plain.toml"))
    assert (world.name, world.instruction) == ("plain", None)
    chex.assert_trees_all_equal(world.sensor, default_sensor())
    chex.assert_trees_all_equal(world.motion, default_motion())
    np.testing.assert_array_equal(world.scenario.start, [0, 0, 0])
    assert int(world.scenario.goal_index) == NONE
    np.testing.assert_allclose(world.scenario.goal, [5, 1])


@pytest.mark.parametrize("kind", ["toml", "json"])
@pytest.mark.parametrize("name", shipped_worlds())
def test_round_trip_of_shipped_worlds(tmp_path: Path, name: str, kind: str) -> None:
    world = open_world(name)
    save_world(world, tmp_path / f"copy.{kind}")
    again = load_world(tmp_path / f"copy.{kind}")
    chex.assert_trees_all_equal(again.scenario, world.scenario)
    chex.assert_trees_all_equal((again.sensor, again.motion), (world.sensor, world.motion))
    assert (again.name, again.instruction) == (world.name, world.instruction)
    assert again.object_names == world.object_names


@pytest.mark.parametrize("seed", range(5))
def test_round_trip_of_sampled_worlds_is_exact(tmp_path: Path, seed: int) -> None:
    key = jax.random.key(seed)
    scenario = sample_scenario(key, template="2H2C", relation="nearest")
    turned = np.asarray(scenario.start) + np.float32([0, 0, jax.random.normal(key)])
    scenario = type(scenario)(**{**vars(scenario), "start": turned})
    world = WorldFile(
        name='it"s a \\ 🌍', scenario=scenario, sensor=default_sensor(), motion=default_motion()
    )
    save_world(world, tmp_path / "sampled.toml")
    again = load_world(tmp_path / "sampled.toml")
    chex.assert_trees_all_equal(again.scenario, scenario)
    assert again.name == world.name
    assert again.object_names[int(scenario.goal_index)] == "goal"


def test_a_heading_of_more_than_a_turn_is_wrapped() -> None:
    world = open_world("yard")
    for degrees, written in ((360.0, 360.0), (-360.0, -360.0), (450.0, 90.0), (-725.0, -5.0)):
        start = np.float32([0.0, 0.0, np.radians(degrees)])
        turned = replace(world, scenario=replace(world.scenario, start=start))
        assert world_to_dict(turned)["start"]["heading"] == pytest.approx(written, abs=1e-4)


def test_shipped_worlds_show_what_they_promise() -> None:
    assert set(shipped_worlds()) == {"yard", "street", "empty-corner", "figure1", "figure4"}
    kinds = set()
    for name in shipped_worlds():
        world = open_world(name)
        assert world.name == name
        assert world.instruction
        kinds |= set(np.asarray(world.scenario.object_type)[np.asarray(world.scenario.is_object)])
    assert len(kinds) >= 6


def test_open_world_tells_templates_shipped_worlds_and_files_apart(tmp_path: Path) -> None:
    assert open_world("2H1C") == Template(name="2H1C", num_hydrants=2, num_cones=1)
    assert isinstance(open_world(str(write(tmp_path, YARD))), WorldFile)
    for text in ("yrad", "", "nonsense"):
        with pytest.raises(ValueError, match=r"unknown world.*1H1C.*yard.*toml") as caught:
            open_world(text)
        assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="has 9 hydrants: choose 1 to 4"):
        open_world("9H1C")


def test_walls_are_read_known_and_written_back(tmp_path: Path) -> None:
    """One straight across the way: round an end of it, and 0.2 m past that."""
    ends = "[[4, -1], [4, 2]]", "[[8, 0], [8, 1]]"
    walls = "".join(f"[[walls]]\nends = {one}\n" for one in ends)
    world = load_world(write(tmp_path, YARD + walls))
    np.testing.assert_array_equal(walls_of(world.scenario), [[4, -1, 4, 2], [8, 0, 8, 1]])
    start, goal, turn = world.scenario.start[:2], world.scenario.goal, np.array([4.0, -1.2])
    straight = np.hypot(*(goal - start))
    around = np.hypot(*(turn - start)) + np.hypot(*(goal - turn))
    assert straight < float(known_distance(world.scenario)) <= around + 0.5
    save_world(world, tmp_path / "again.toml")
    chex.assert_trees_all_equal(load_world(tmp_path / "again.toml").scenario, world.scenario)
    assert len(walls_of(open_world("yard").scenario)) == 0


def change(table: dict, where: str, value: object) -> dict:
    """Set the key at a dotted place; a value of ``...`` deletes it."""
    table = copy.deepcopy(table)
    *parents, last = [int(key) if key.isdigit() else key for key in where.split(".")]
    place = table
    for key in parents:
        place = place[key]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return table


COMPLAINTS = [
    ("area", ..., "area is missing: add it"),
    ("area", 3, "area is 3, but must be a table"),
    ("area.x_max", -1.0, "area.x_max is -1.0, but must be at least 0.1: 0.1 m above x_min"),
    ("area.y_max", "9", "area.y_max is '9', but must be a number, .*: write it without quotes"),
    ("area.x_max", True, "area.x_max is True, but must be a number"),
    ("start.x", 14.0, r"start.x is 14.0, but the area reaches from 0 to 13: move it or enlarge"),
    ("start.heading", 400, "start.heading is 400, but must be a number, .* at most 360"),
    ("goal.object", "hydrant", "goal.object is 'hydrant', but must be .*did you mean .far"),
    ("goal", {"x": 1.0}, "goal.object is missing: name an object, or give x and y"),
    ("goal", {"x": 1.0, "y": 99.0}, "goal.y is 99.0, but the area reaches from -9 to 9"),
    ("goal.x", 1.0, "goal.object is given, and x or y as well: leave one out"),
    ("objects", [], "objects has 0 entries, but must have 1 to 64"),
    ("objects", [{"type": "box", "x": 1.0, "y": 1.0}] * 65, "objects has 65 entries, but must"),
    ("objects", {}, r"objects is \{\}, but must be a list"),
    ("objects.0", 5, r"objects\[0\] is 5, but must be a table"),
    ("objects.1.type", "hidrant", r"\[1\].type is 'hidrant', which looks mistyped. .* 'hydrant'"),
    ("objects.0.type", "", r"objects\[0\].type is '', but must be a text that is not empty"),
    ("objects.0.type", "gaz9ebo", r"objects\[0\].type is 'gaz9ebo', but must be a noun"),
    ("objects.0.type", "the", r"objects\[0\].type is 'the', which has a meaning of its own"),
    ("objects.0.y", ..., r"objects\[0\].y is missing: add it"),
    ("objects.0.y", float("nan"), r"objects\[0\].y is nan, but must be a number, at least"),
    ("objects.0.name", "far hydrant", r"\[1\].name is 'far hydrant' as is objects\[0\]: rename"),
    ("objects.0.weight", 3, r"objects\[0\].weight is unknown: known keys are colour, height, mat"),
    ("objects.0.colour", "reddish", r"\[0\].colour is 'reddish', but must be a colour: red, "),
    ("sensor.range", 0, "sensor.range is 0, but must be a number, at least 0.01"),
    ("sensor.noise", 5.5, "sensor.noise is 5.5, but must be at most 5, the range"),
    ("instruction", " ", "instruction is ' ', but must be a text that is not empty"),
    ("walls", [{"ends": [[1, 1], [99, 1]]}], r"walls\[0\].ends.x is 99.0, but the area reaches"),
    ("walls", [{"ends": [[1, 1], [1, 1]]}], r"walls\[0\].ends are both \[1.0, 1.0\]: give two"),
    ("walls", [{"ends": [[1, 1]]}], r"walls\[0\].ends has 1 entries, but must have 2"),
    ("robots", 1, "robots is unknown: known keys are area, goal, instruction"),
    ("area.x_max", 10**400, "x_max is a whole number of 1329 bits, but must be"),
    ("name", "\x1b]0;title\x07", r"name has the control character U\+001B at place 1: remove"),
    ("name", "x" * 5000, "name has 5000 characters, but must have at most 100: shorten it"),
    ("instruction", "go\x00", r"instruction has the control character U\+0000"),
    ("objects.1.name", "x" * 101, r"objects\[1\].name has 101 characters"),
    ("\x1b[2J" * 50, 1, "is unknown: known keys are"),
    ("objects", [[[[]]]] * 2, "must be a table"),
]


@pytest.mark.parametrize(("where", "value", "message"), COMPLAINTS, ids=range(len(COMPLAINTS)))
def test_complaints_name_file_key_value_limit_and_remedy(where, value, message) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        world_from_dict(change(tomllib.loads(YARD), where, value), file="yard.toml")
    text = str(caught.value)
    assert text.startswith("yard.toml: ")
    assert text.isprintable()
    assert len(text) < 300


@pytest.mark.parametrize(("number", "slots"), [(8, 8), (9, 16), (17, 32), (64, 64)])
def test_a_world_has_the_least_slots_that_hold_its_objects(number, slots) -> None:
    table = tomllib.loads(YARD)
    table["objects"] += [{"type": "box", "x": 1.0, "y": 1.0}] * (number - len(table["objects"]))
    world = world_from_dict(table, file="yard.toml")
    assert world.scenario.is_object.size == slots == len(world.object_names)
    assert int(world.scenario.is_object.sum()) == number
    assert world_to_dict(world)["objects"][-1] == {"type": "box", "x": 1.0, "y": 1.0}


def test_a_goal_may_be_left_out_and_stays_out(tmp_path) -> None:
    table = tomllib.loads(YARD)
    world = world_from_dict(change(table, "goal", ...), file="yard.toml")
    assert not world.has_goal
    assert int(world.scenario.goal_index) == NONE
    save_world(world, tmp_path / "yard.toml")
    assert not load_world(tmp_path / "yard.toml").has_goal
    assert world_from_dict(table, file="yard.toml").has_goal


def test_a_start_left_out_must_lie_in_the_area() -> None:
    table = change(change(tomllib.loads(YARD), "start", ...), "area.x_min", 1.0)
    with pytest.raises(ValueError, match="start is missing, and its default 0, 0 lies outside"):
        world_from_dict(table, file="yard.toml")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    cases = {
        "missing.toml": (None, "no such file"),
        "world.yaml": ("a: 1", "must end in .toml or .json"),
        "broken.toml": ("[area\n", "is no valid TOML: .*line 1"),
        "broken.json": ("{", "is no valid JSON: .*line 1"),
        "list.json": ("[1]", r"the document is \[1\], but must be a table"),
        "empty.toml": ("", "area is missing"),
    }
    for name, (text, message) in cases.items():
        path = tmp_path / name if text is None else write(tmp_path, text, name)
        with pytest.raises(ValueError, match=message) as caught:
            load_world(path)
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe9'")
    with pytest.raises(ValueError, match="is no text: save it as UTF-8"):
        load_world(tmp_path / "latin.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(ValueError, match=r"folder\.toml: is a folder, not a regular file"):
        load_world(tmp_path / "folder.toml")


def test_a_name_that_comes_from_the_file_is_plain_and_short(tmp_path: Path) -> None:
    text = YARD.replace('name = "yard"\n', "", 1)
    world = load_world(write(tmp_path, text, "\x1b[31m\n" + "x" * 150 + ".toml"))
    assert world.name.isprintable()
    assert len(world.name) <= 100


@pytest.mark.parametrize("kind", ["toml", "json"])
def test_deep_and_large_files_are_refused(tmp_path: Path, kind: str) -> None:
    deep = "[" * 50_000
    for text in ("a = " + deep, deep, "a = " + "1" * 5000, "1" * 5000, "#" * 300_000):
        with pytest.raises(ValueError, match=f"bad.{kind}: ") as caught:
            load_world(write(tmp_path, text, f"bad.{kind}"))
        assert "\n" not in str(caught.value)


def test_files_that_cannot_be_written(tmp_path: Path) -> None:
    world = open_world("yard")
    with pytest.raises(ValueError, match=r"must end in \.toml or .json"):
        save_world(world, tmp_path / "yard.txt")
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(ValueError, match=r"yard\.toml: cannot be written: "):
        save_world(world, tmp_path / "file" / "yard.toml")


def test_templates_place_the_types_that_the_lexicon_calls_hydrant_and_cone() -> None:
    names = load_lexicon().type_names
    assert (names[HYDRANT], names[CONE]) == ("hydrant", "cone")


def test_things_of_any_noun_with_their_looks_are_read_and_written_back(tmp_path: Path) -> None:
    things = ("gazebo", 7.0, 0.6), ("Easel", 4.5, 0.5), ("gazebo", 3.0, -4.0)
    table = tomllib.loads(world_file((0.0, 10.0, -5.0, 5.0), *things))
    table["objects"][0] |= {"colour": "white", "height": "tall"}
    table["objects"][2] |= {"colour": "red"}
    world = world_from_dict(table, file="park.toml")
    assert world.type_names[-2:] == ("gazebo", "easel")
    assert world.attribute_groups == ("colour", "height")
    assert world.scenario.object_type[:3].tolist() == [8, 9, 8]
    codes = [attribute_code("white", "tall"), 0, attribute_code("red")]
    assert world.scenario.object_attribute[:3].tolist() == codes
    save_world(world, tmp_path / "park.toml")
    again = load_world(tmp_path / "park.toml")
    jax.tree.map(np.testing.assert_array_equal, again.scenario, world.scenario)
    assert again.type_names == world.type_names
