"""Robots in MuJoCo: bodies that turn as they should, tags that are found where they are."""

import dataclasses
import os
import subprocess
import sys
from collections.abc import Iterator

import measure_detector
import measure_odometry
import numpy as np
import pytest
from placed import placed

from jaxlangnav.robots import libraries
from jaxlangnav.robots.motion.steering import WheelCommand, wrap
from jaxlangnav.robots.physics import tags
from jaxlangnav.robots.physics.robot import ODOMETRY_NOISE, ROBOT_MODELS, PhysicsRobot, SensorErrors
from jaxlangnav.robots.robot import Robot, WaypointStatus
from jaxlangnav.robots.table3 import navigator_of
from jaxlangnav.world.state import CONE, HYDRANT

try:
    libraries.check_libraries()
except ValueError as missing:
    pytest.skip(str(missing), allow_module_level=True)

BOTH = pytest.mark.parametrize("machine", sorted(ROBOT_MODELS))
SURE = SensorErrors(wheel_scale=0.0, gyro_bias=0.0, gyro_noise=0.0)
OBJECTS = ((HYDRANT, 3.0, -0.4), (CONE, 2.2, 1.0))


def put(machine: str = "husky", objects=OBJECTS, *, errors: SensorErrors = SURE, seed: int = 0):
    scenario = placed(objects, area=(-1.0, 8.0, -4.0, 4.0))
    return PhysicsRobot(machine, scenario, seed=seed, gates=tags.Gates(range=4.0), errors=errors)


@pytest.fixture(scope="module")
def husky() -> Iterator[PhysicsRobot]:
    robot = put()
    yield robot
    robot.close()


@BOTH
def test_its_wheels_seem_as_far_apart_as_is_known(machine: str) -> None:
    """A skid-steer's effective track is 1.8 to 2.1 times the real one; a chair's is the same."""
    ratios = []
    for turn in (0.5, -0.8):
        robot = put(machine, ())
        data, command = robot.scene.data, WheelCommand(0.0, turn)
        for _ in range(10):
            robot._move(command)
        before, headings = data.qpos[robot._wheels].copy(), [robot.true_pose[2]]
        for _ in range(30):
            robot._move(command)
            headings.append(robot.true_pose[2])
        robot.close()
        turned = np.ptp(np.unwrap(headings)) * np.sign(turn)
        rolled = (data.qpos[robot._wheels] - before) * robot.robot_model.wheel_radius
        apart = rolled[robot._side < 0].mean() - rolled[robot._side > 0].mean()
        ratios.append(apart / turned / robot.robot_model.track)
        assert turned / 3.0 == pytest.approx(turn, rel=0.15)
    low, high = (1.8, 2.1) if machine == "husky" else (0.95, 1.1)
    assert low < min(ratios) <= max(ratios) < high


@BOTH
def test_its_wheels_roll_as_far_as_they_are_said_to(machine: str) -> None:
    robot = put(machine, ())
    robot.go_to(np.array([4.0, 0.0]), speed=1.0, clearance=0.0)
    assert robot.wait(15.0) is WaypointStatus.REACHED
    x, y, heading = robot.true_pose
    assert abs(x - robot.pose()[0]) < 0.01 * x + 0.01
    assert abs(y) < 0.05
    assert abs(heading) < 0.02
    assert robot.travelled == pytest.approx(x, rel=0.02)
    assert isinstance(robot, Robot)
    robot.close()


def test_odometry_drifts_and_never_tells_the_truth() -> None:
    robot = put("husky", (), errors=SensorErrors(), seed=3)
    for goal in ([3.0, 2.0], [0.0, 2.0]):
        robot.go_to(np.array(goal), speed=1.0, clearance=0.0)
        assert robot.wait(15.0) is WaypointStatus.REACHED
    off = robot.pose() - robot.true_pose
    assert 0.005 < np.hypot(*off[:2]) < 0.5
    assert 0.0 < abs(wrap(off[2])) < 0.2
    robot.close()


def test_tags_are_found_where_their_things_are(husky: PhysicsRobot) -> None:
    found = {one.object_type: one for one in husky.detections()}
    assert set(found) == {HYDRANT, CONE}
    for kind, x, y in OBJECTS:
        assert found[kind].range == pytest.approx(np.hypot(x, y), abs=0.02)
        assert found[kind].bearing == pytest.approx(np.arctan2(y, x), abs=0.01)


def test_opencvs_own_detector_sees_the_same_tags(husky: PhysicsRobot) -> None:
    cv2 = libraries.opencv()
    grey = cv2.cvtColor(husky.render("front"), cv2.COLOR_RGB2GRAY)
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, numbers, _ = cv2.aruco.ArucoDetector(book).detectMarkers(grey)
    theirs = [
        (int(one), four.reshape(4, 2).mean(axis=0))
        for one, four in zip(numbers.ravel(), corners, strict=True)
    ]
    ours = tags.find_tags(grey)
    assert len(ours) >= 2
    for tag in ours:
        # OpenCV counts pixels from their middles.
        near = [
            one for one, place in theirs if np.hypot(*(tag.corners.mean(0) - 0.5 - place)) < 1.0
        ]
        assert near == [tag.tag_id]
    assert {one for one, _ in theirs} == {tag.tag_id for tag in ours}


@pytest.mark.parametrize(
    "gates",
    [
        tags.Gates(range=2.8),
        tags.Gates(range=9.0, field_of_view=0.5),
        tags.Gates(range=9.0, view_angle=0.01),
    ],
    ids=["range", "bearing", "view angle"],
)
def test_what_is_out_of_the_gates_is_not_used(husky: PhysicsRobot, gates: tags.Gates) -> None:
    husky.detections()
    wide = tags.Gates(range=9.0, field_of_view=6.0, view_angle=1.5)
    every = tags.to_detections(husky.last_tags, husky.robot_model.camera_ahead, wide)
    kept = tags.to_detections(husky.last_tags, husky.robot_model.camera_ahead, gates)
    assert len(every) == 2
    assert len(kept) < len(every)
    strangers = [dataclasses.replace(one, tag_id=8 * 16) for one in husky.last_tags]
    assert tags.to_detections(strangers, husky.robot_model.camera_ahead, wide) == []


def test_a_covered_tag_is_not_seen_and_a_turned_cube_is() -> None:
    robot = put(objects=((HYDRANT, 2.5, 0.0),))
    for angle in np.linspace(0.0, 1.5, 4):
        robot.scene.set_heading("thing0", angle)
        robot.settle()
        (one,) = robot.detections()
        assert one.range == pytest.approx(2.5, abs=0.02)
    robot.scene.model.geom_matid[:] = -1
    assert robot.detections() == []
    robot.close()


def test_things_and_people_are_seen_by_the_scanner_and_not_run_into() -> None:
    robot = put("wheelchair", ((CONE, 2.0, 0.1),))

    def step_in(one: PhysicsRobot) -> None:
        one.scene.set_position("person", one.true_pose[0] + 1.3, one.true_pose[1])

    robot.at(4.0, step_in)
    robot.go_to(np.array([4.5, 0.0]), speed=1.0, clearance=0.2)
    way = np.array([robot.true_pose[:2] for _ in range(450) if robot.wait(0.1)])
    assert robot.wait(0.1) is WaypointStatus.REACHED
    person = robot.scene.data.mocap_pos[-1, :2]
    assert np.hypot(*(way - (2.0, 0.1)).T).min() > 0.28 + 0.31
    assert np.hypot(*(way[60:] - person).T).min() > 0.25 + 0.31
    robot.close()


@pytest.mark.slow
def test_the_detector_is_as_good_as_the_belief_is_told() -> None:
    found = measure_detector.measure(looks=4, ranges=(1.25, 2.5, 4.0), pictures=("as told",))
    rate = np.mean([one.rate for one in found])
    looks = sum(one.looks for one in found)
    assert rate > tags.RATE - 5 * np.sqrt(tags.RATE * (1 - tags.RATE) / looks)
    assert np.nanmax([one.error for one in found]) < tags.NOISE
    assert sum(one.false for one in found) == 0
    headings, rows = measure_detector.tabulate(found)
    assert len(rows) == 3
    assert len(rows[0]) == len(headings)


@BOTH
def test_the_belief_is_told_how_far_its_odometry_is_out(machine: str) -> None:
    """Neither less than is measured nor twice as much; other drives than those it was told by."""
    found = measure_odometry.measure(machine, drives=6, seed=100)
    told = ODOMETRY_NOISE[machine]
    # Six drives of some twenty cycles: the share is known to a tenth at best.
    assert 0.5 * told < max(found.shares) < 1.3 * told
    assert 0.0 < found.end < found.end_most < 0.15
    headings, rows = measure_odometry.odometry_table([found])
    assert len(rows[0]) == len(headings)


def test_a_robots_navigator_is_told_its_own_odometry() -> None:
    for machine, share in ODOMETRY_NOISE.items():
        motion = navigator_of(machine).params.map.motion
        assert float(motion.odometry_noise) == pytest.approx(share)


@pytest.mark.parametrize(("library", "says"), [("cv2", "robot"), ("mujoco", "robot")])
def test_a_missing_extra_is_said_in_one_line(monkeypatch, library: str, says: str) -> None:
    find = libraries.require.__globals__["importlib"].util.find_spec
    monkeypatch.setattr(
        "importlib.util.find_spec", lambda name: None if name == library else find(name)
    )
    with pytest.raises(ValueError, match=rf"{library}.*jaxlangnav\[{says}\]"):
        libraries.check_libraries()


@pytest.mark.skipif(sys.platform != "linux", reason="how EGL finds its driver on Linux")
def test_a_missing_system_library_is_said_in_one_line(tmp_path) -> None:
    """EGL is told to look for drivers where there are none, as on a machine without them."""
    code = (
        "from jaxlangnav.robots.libraries import check_libraries\n"
        "try: check_libraries()\n"
        "except ValueError as error: print(error)"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"__EGL_VENDOR_LIBRARY_DIRS": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri" in ran.stdout
    assert (ran.stdout + ran.stderr).count("\n") == 1


def test_machines_are_within_their_bodies() -> None:
    for machine in ROBOT_MODELS.values():
        assert machine.body.speed <= machine.body.top_speed
        assert machine.body.radius > 0.5 * machine.track
