"""A navigator drives a robot to an ending; what goes wrong on the way has an ending, too."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from placed import placed

from jaxlangnav.messages import NONE, Fault, Status, default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.robots import driver
from jaxlangnav.robots.driver import drive
from jaxlangnav.robots.kinematic import KinematicRobot
from jaxlangnav.robots.recorded import record_drive
from jaxlangnav.robots.robot import Detection, Ending, NavigationRun, WaypointStatus, observe
from jaxlangnav.viz.html import page_data, render_html
from jaxlangnav.viz.panels import outcome
from jaxlangnav.world.state import CONE, HYDRANT

TEXT = "go to the hydrant behind the cone"
GOAL = (6.0, 0.8)


def put(objects=((HYDRANT, *GOAL), (CONE, 4.0, 0.5)), *, seed: int = 0) -> KinematicRobot:
    scenario = placed(objects, area=(0.0, 9.0, -4.5, 4.5), goal=0)
    scenario = replace(scenario, goal_index=np.int32(NONE))
    sensor = replace(default_sensor(3.0), field_of_view=jnp.float32(np.pi / 2))
    return KinematicRobot(scenario, seed=seed, sensor=sensor)


def go(navigator, robot, text: str = TEXT, **options) -> NavigationRun:
    return drive(navigator, robot, text, key=jax.random.key(1), **options)


def ends(ending: Ending, navigator, robot, **options) -> NavigationRun:
    drive = go(navigator, robot, **options)
    assert drive.ending is ending, drive.why
    assert ending is not Ending.ARRIVED or goal_distance(robot) < 1.5
    return drive


def goal_distance(robot: KinematicRobot, goal=GOAL) -> float:
    return float(np.hypot(*(robot.true_pose[:2] - goal)))


def test_a_sentence_is_carried_out(navigator) -> None:
    robot, told = put(), []
    drive = ends(
        Ending.ARRIVED, navigator, robot, on_step=lambda step, state, info: told.append(step)
    )
    assert tuple(told) == drive.steps
    assert drive.steps[0].status == Status.SEARCHING
    assert drive.steps[-1].status == Status.ARRIVED
    # Decided by odometry, never by the truth: they differ.
    assert not np.allclose(robot.pose(), robot.true_pose, atol=1e-3)
    place = robot.true_pose
    robot.wait(2.0)
    np.testing.assert_array_equal(robot.true_pose, place)


def test_a_camera_that_comes_back_in_time_is_no_ending(navigator) -> None:
    robot = put()
    robot.at(3.0, lambda one: setattr(one, "camera_works", False))
    robot.at(6.0, lambda one: setattr(one, "camera_works", True))
    ends(Ending.ARRIVED, navigator, robot)


def test_a_goal_that_cannot_be_seen_is_not_found(navigator) -> None:
    robot = put([(CONE, 4.0, 0.5)])
    robot.obstacles.append((*GOAL, 0.28))
    assert "hydrant" in ends(Ending.NOT_FOUND, navigator, robot).why


def test_a_goal_that_is_taken_away_is_never_arrived_at(navigator) -> None:
    robot = put()

    def take_away(one: KinematicRobot) -> None:
        if goal_distance(one) >= 2.6:
            one.at(one.seconds + 0.1, take_away)
            return
        is_object = np.array(one.scenario.is_object)
        is_object[0] = False
        one.scenario = replace(one.scenario, is_object=is_object)

    robot.at(0.0, take_away)
    ends(Ending.NOT_FOUND, navigator, robot)


def test_who_is_walled_in_is_blocked(navigator) -> None:
    robot = put()
    turns = np.linspace(0.0, 2.0 * np.pi, 30)[:-1]
    robot.obstacles += [(1.2 * np.cos(one), 1.2 * np.sin(one), 0.2) for one in turns]
    drive = ends(Ending.BLOCKED, navigator, robot)
    assert drive.steps[-1].progress is WaypointStatus.FAILED
    assert robot.travelled < 1.0


def test_a_report_that_cannot_be_makes_it_lost(navigator) -> None:
    robot = put()
    robot._detect = lambda: [Detection(object_type=CONE, range=50.0, bearing=0.0)]
    drive = ends(Ending.LOST, navigator, robot)
    assert "DETECTION" in drive.why
    assert drive.steps[-1].fault == Fault.DETECTION
    assert robot.travelled == 0.0


def test_it_halts_goes_on_and_drops_the_task(navigator) -> None:
    said = {4: "stop!", 8: "go on"}
    robot, places = put(), []

    def listen() -> str | None:
        places.append(robot.pose())
        return said.pop(len(places), None)

    drive = ends(Ending.ARRIVED, navigator, robot, listen=listen)
    assert drive.steps[4].status == Status.HALTED
    np.testing.assert_array_equal(places[5], places[7])
    assert drive.steps[8].target is not None
    robot = put()
    ends(Ending.IDLE, navigator, robot, listen=iter([None, "cancel"]).__next__)
    robot = put()
    ends(Ending.HALTED, navigator, robot, listen=lambda: "stop", max_seconds=4.0)
    assert robot.travelled == 0.0


def test_each_ending_of_the_navigator_is_one_of_the_drive(navigator) -> None:
    loop = driver._DriveLoop(navigator, put(), jax.random.key(0), None)
    for name in ("NOT_FOUND", "BLOCKED", "WHICH_ONE", "IDLE"):
        named, why = loop._end_of(Status[name], navigator.start(TEXT))
        assert named is Ending[name]
        assert why


def test_a_drive_is_recorded_with_the_truth_of_each_look(navigator) -> None:
    robot = put()
    ended, kept = record_drive(robot, TEXT, navigator=navigator, key=jax.random.key(1))
    assert kept.num_steps == len(ended.steps) > 3
    frames = kept.frames
    np.testing.assert_array_equal(frames.position[0], [0.0, 0.0])
    assert (np.diff(frames.distance) >= 0.0).all()
    poses = np.array([step.pose for step in ended.steps])
    np.testing.assert_allclose(frames.odometry, poses[:, :2], atol=1e-5)
    seen = [len(step.detections or ()) for step in ended.steps]
    assert frames.is_detection.sum(axis=1).tolist() == seen
    assert kept.result.is_success == (ended.ending is Ending.ARRIVED)
    assert float(kept.result.goal_distance) == pytest.approx(goal_distance(robot))
    assert kept.pictures == ()
    assert "Says stop" in render_html(kept)


def test_a_camera_that_stops_makes_it_blind_and_a_recording_tells(navigator) -> None:
    robot = put()
    robot.at(3.0, lambda one: setattr(one, "camera_works", False))
    ended, kept = record_drive(robot, TEXT, navigator=navigator, key=jax.random.key(1))
    assert ended.ending is Ending.BLIND
    assert "picture" in ended.why
    assert robot.seconds < 15.0
    assert kept.num_steps == len(ended.steps)
    assert outcome(kept) == "blind"
    assert not np.append(kept.frames.is_detection[-1], kept.frames.num_regrounded[-1]).any()
    np.testing.assert_allclose(kept.frames.position[-1], robot.true_pose[:2], atol=1e-5)
    closing = page_data(kept)["closing"]
    assert "picture" in closing[0]
    assert not any("out of time" in line for line in closing)


def test_a_waypoint_that_cannot_be_stood_on_is_seen_from_all_sides_and_then_given_up() -> None:
    loop = driver._DriveLoop(None, put(), jax.random.key(0), None)
    info, target = SimpleNamespace(fault=0), np.array([0.8, 0.3])
    facing, beyond, end = [], [], None
    while end is None:
        end = loop._check_progress(WaypointStatus.REACHED, target, info)
        facing += [loop.facing] if loop.facing is not None else []
        beyond += [loop.overshoot] if loop.overshoot is not None else []
        assert len(facing) + len(beyond) < 9
    assert end[0] is Ending.BLOCKED
    turned = np.sort(np.mod(facing, 2.0 * np.pi))
    assert np.diff([0.0, *turned, 2.0 * np.pi]).max() < np.pi / 2
    (place,) = beyond
    assert place @ target > target @ target
    assert np.cross([*place, 0.0], [*target, 0.0]) == pytest.approx(0.0, abs=1e-6)


def test_an_observation_keeps_the_nearest() -> None:
    found = [Detection(object_type=k % 2, range=9.0 - k, bearing=0.1 * k) for k in range(9)]
    look = observe(np.array([1.0, 2.0, 0.5]), found, default_sensor(10.0))
    assert look.is_detection.all()
    np.testing.assert_allclose(look.detection_range, np.arange(1.0, 9.0))
    few = observe(np.zeros(3), found[:2], default_sensor(10.0))
    assert int(few.is_detection.sum()) == 2
    assert int(few.detection_type[-1]) == NONE
