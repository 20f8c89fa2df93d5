"""Things that go wrong with robots in physics: each has its ending, none a false "arrived"."""

from collections.abc import Callable

import jax
import numpy as np
import pytest

from jaxlangnav.experiments.tasks import SENTENCES
from jaxlangnav.robots import libraries
from jaxlangnav.robots.driver import drive
from jaxlangnav.robots.physics.robot import PhysicsRobot
from jaxlangnav.robots.recorded import record_drive
from jaxlangnav.robots.robot import Ending
from jaxlangnav.robots.table3 import TABLE3, make_robot
from jaxlangnav.viz.film import write_film
from jaxlangnav.viz.html import render_html

pytestmark = pytest.mark.slow
HUSKY, CHAIR = TABLE3[6], TABLE3[2]
BOTH = pytest.mark.parametrize("row", [HUSKY, CHAIR], ids=["husky", "wheelchair"])
GOAL = "thing0"
"""Body of the hydrant."""
try:
    libraries.check_libraries()
except ValueError as missing:
    pytest.skip(str(missing), allow_module_level=True)


def near(robot: PhysicsRobot, metres: float, event: Callable[[PhysicsRobot], None]) -> None:
    """Let something happen once the robot has come near to its goal."""

    def look(one: PhysicsRobot) -> None:
        away = np.hypot(*(one.true_pose[:2] - np.asarray(one.scenario.goal)))
        event(one) if away < metres else one.at(one.seconds + 0.1, look)

    robot.at(0.0, look)


def step_in(robot: PhysicsRobot) -> None:
    x, y, heading = robot.true_pose
    robot.scene.set_position("person", x + 1.3 * np.cos(heading), y + 1.3 * np.sin(heading))


def cover_goal(robot: PhysicsRobot) -> None:
    model = robot.scene.model
    tags = [model.geom(f"tag0_{side}").id for side in ("front", "left", "back", "right")]
    model.geom_matid[tags] = -1


def slip(robot: PhysicsRobot) -> None:
    friction = robot.scene.model.geom_friction
    friction[:], before = 0.02, friction.copy()
    robot.at(robot.seconds + 3.0, lambda _: friction.__setitem__(slice(None), before))


@BOTH
@pytest.mark.parametrize(
    ("fault", "endings"),
    [
        (lambda one: one.at(4.0, lambda it: setattr(it, "camera_works", False)), {Ending.BLIND}),
        (lambda one: one.at(0.0, cover_goal), {Ending.NOT_FOUND}),
        (
            lambda one: near(one, 2.2, lambda it: it.scene.set_position(GOAL, 500.0, 500.0)),
            {Ending.NOT_FOUND},
        ),
        (lambda one: one.at(3.0, step_in), {Ending.ARRIVED}),
        (lambda one: one.at(2.0, slip), {Ending.ARRIVED, Ending.NOT_FOUND, Ending.BLOCKED}),
    ],
    ids=["camera", "covered", "moved", "person", "slip"],
)
def test_what_goes_wrong_has_its_ending(navigator, row, fault, endings) -> None:
    robot = make_robot(row, 0, 0)
    fault(robot)
    try:
        ended = drive(
            navigator, robot, SENTENCES[row.relation], key=jax.random.key(3), max_seconds=240.0
        )
        away = np.hypot(*(robot.true_pose[:2] - np.asarray(robot.scenario.goal)))
    finally:
        robot.close()
    assert ended.ending in endings, ended.why
    if ended.ending is Ending.ARRIVED:
        assert away < 1.5


@BOTH
def test_a_motion_planner_that_gives_up_leaves_it_blocked(navigator, row, monkeypatch) -> None:
    monkeypatch.setattr("jaxlangnav.robots.motion.mover.find_path", lambda *given: None)
    robot = make_robot(row, 0, 0)
    ended = drive(navigator, robot, SENTENCES["behind"], key=jax.random.key(0), max_seconds=60.0)
    robot.close()
    assert ended.ending is Ending.BLOCKED, ended.why
    assert robot.travelled < 0.1


def test_a_run_is_recorded_with_what_is_seen_of_it(navigator, tmp_path) -> None:
    robot, key = make_robot(HUSKY, 0, 0), jax.random.key(0)
    ended, kept = record_drive(robot, SENTENCES["behind"], navigator=navigator, key=key)
    robot.close()
    assert kept.num_steps == len(ended.steps) == len(kept.pictures)
    read = libraries.opencv().imdecode
    for step in (0, -1):
        assert len(kept.pictures[step]) == 2
        for jpeg in kept.pictures[step].values():
            assert len(jpeg) < 40_000
            picture = read(np.frombuffer(jpeg, np.uint8), 1)
            assert picture.shape == (300, 400, 3)
            assert picture.std() > 10.0
    first, last = kept.pictures[0], kept.pictures[-1]
    assert all(first[title] != last[title] for title in first)
    assert len(render_html(kept)) < 5_000_000
    pytest.importorskip("matplotlib")
    film = write_film(kept, tmp_path / "run.mp4")
    ok, shown = libraries.opencv().VideoCapture(str(film)).read()
    assert ok
    assert shown.shape == (480, 1380, 3)
