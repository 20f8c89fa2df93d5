"""Motion planners among things: they get there, touch nothing, and say so where there is no way."""

import itertools

import numpy as np
import pytest

from jaxlangnav.pytree import replace
from jaxlangnav.robots.kinematic import KinematicRobot, OdometryErrors
from jaxlangnav.robots.motion.mover import TICK, MotionPlanner
from jaxlangnav.robots.motion.path import disc_distance, find_path, inflate, is_clear, to_discs
from jaxlangnav.robots.physics.robot import ROBOT_MODELS
from jaxlangnav.robots.robot import Robot, WaypointStatus, wrap_heading
from jaxlangnav.world.state import make_scenario

SURE = OdometryErrors(scale=0.0, noise=0.0, drift=0.0)


def put(discs=(), *, start=(0.0, 0.0, 0.0)) -> KinematicRobot:
    area, pose = np.array([-2.0, 10.0, -6.0, 6.0]), np.array(start)
    scenario = replace(make_scenario(), area=area, start=pose)
    robot = KinematicRobot(scenario, seed=0, errors=SURE)
    robot.obstacles = [tuple(disc) for disc in discs]
    return robot


def go(robot: KinematicRobot, goal, clearance=0.2, speed=1.0, seconds=90.0):
    """Drive to the end; return how that was, and the least gap between body and things."""
    robot.go_to(np.array(goal), speed=speed, clearance=clearance)
    least, progress = np.inf, WaypointStatus.UNDER_WAY
    while progress is WaypointStatus.UNDER_WAY and robot.seconds < seconds:
        progress = robot.wait(0.1)
        pose = robot.true_pose
        gap = disc_distance(*pose[:2, None], robot.disc_obstacles())[0] - robot.mover.body.radius
        least = min(least, float(gap))
    return progress, least


def gets_there(robot: KinematicRobot, goal, **options) -> float:
    """Drive to the end without a touch; return the least gap."""
    progress, least = go(robot, goal, **options)
    assert progress is WaypointStatus.REACHED
    assert least > 0.0
    return least


def field(seed: int) -> np.ndarray:
    """Scatter things so that the body fits between them, away from start and goal."""
    random, number = np.random.default_rng(seed), 14
    discs: list[tuple[float, float, float]] = []
    while len(discs) < number:
        x, y, radius = random.uniform(0.5, 7.5), random.uniform(-3, 3), random.uniform(0.1, 0.4)
        near = [np.hypot(x - a, y - b) - radius - other for a, b, other in discs]
        is_free = min([np.hypot(x, y), np.hypot(x - 8.0, y)]) > radius + 0.8
        if is_free and min(near, default=9.0) > 1.4:
            discs.append((x, y, radius))
        number -= len(discs) < number and random.uniform() < 0.01
    return np.array(discs)


@pytest.mark.parametrize("seed", range(8))
def test_it_gets_through_a_random_field_and_touches_nothing(seed: int) -> None:
    robot = put(field(seed))
    gets_there(robot, (8.0, 0.0))
    assert np.hypot(*(robot.true_pose[:2] - (8.0, 0.0))) < 0.2


@pytest.mark.parametrize("aside", [0.0, 0.1, -0.3])
def test_a_thing_straight_in_the_way_holds_nobody_up(aside: float) -> None:
    robot = put([(2.0, aside, 0.4)])
    gets_there(robot, (4.0, 0.0))
    assert robot.travelled < 6.0


def test_a_pocket_is_no_trap() -> None:
    """Three sides of a box, open towards the robot: a window alone would stay in it."""
    wall = [(3.0, y, 0.15) for y in np.arange(-1.2, 1.3, 0.3)]
    sides = [(x, y, 0.15) for x in (1.8, 2.1, 2.4, 2.7) for y in (-1.2, 1.2)]
    gets_there(put([*wall, *sides]), (5.0, 0.0))


def test_who_is_walled_in_gives_up_and_touches_nothing() -> None:
    turns = np.linspace(0.0, 2.0 * np.pi, 30)[:-1]
    robot = put([(1.5 * np.cos(one), 1.5 * np.sin(one), 0.2) for one in turns])
    progress, least = go(robot, (5.0, 0.0), seconds=40.0)
    assert progress is WaypointStatus.FAILED
    assert least > 0.0
    assert robot.wait(1.0) is WaypointStatus.FAILED


def test_a_person_who_steps_in_the_way_is_not_run_over() -> None:
    robot = put()
    robot.at(2.5, lambda one: one.obstacles.append((one.true_pose[0] + 1.0, 0.0, 0.25)))
    gets_there(robot, (5.0, 0.0))


def test_a_thing_is_gone_up_to_and_faced() -> None:
    robot = put([(3.0, 0.0, 0.3)], start=(0.0, 0.0, 2.0))
    assert gets_there(robot, (3.0, 0.0), clearance=0.6) < 0.35
    x, y, heading = robot.true_pose
    assert abs(np.angle(np.exp(1j * (np.arctan2(-y, 3.0 - x) - heading)))) < 0.2


def test_clearance_and_speed_are_those_asked_for() -> None:
    gap, time = {}, {}
    for clearance, speed in ((0.1, 1.5), (0.6, 0.6)):
        robot = put([(3.0, 0.05, 0.3)])
        gap[clearance] = gets_there(robot, (6.0, 0.0), clearance=clearance, speed=speed)
        time[clearance] = robot.seconds
    assert gap[0.6] > 0.45 > gap[0.1] > 0.0
    assert time[0.6] > 1.8 * time[0.1]


def test_stop_brakes_within_the_bodys_limits() -> None:
    robot = put()
    robot.go_to(np.array([5.0, 0.0]), speed=1.0, clearance=0.0)
    robot.wait(3.0)
    x = robot.true_pose[0]
    robot.stop()
    assert robot.wait(2.0) is WaypointStatus.STANDING
    body = robot.mover.body
    assert robot.true_pose[0] - x < body.speed**2 / (2 * body.acceleration) + 0.1
    assert robot.wait(0.1) is WaypointStatus.STANDING
    assert robot.mover.command == (0.0, 0.0)


def test_odometry_goes_wrong_as_it_is_said_to() -> None:
    """Over many robots, the length that a way seems to have spreads by scale and noise."""
    ends = []
    errors = OdometryErrors(scale=0.02, noise=0.02, drift=0.002)
    scenario = replace(make_scenario(), area=np.array([-1.0, 9.0, -5.0, 5.0]))
    for seed in range(40):
        robot = KinematicRobot(scenario, seed=seed, errors=errors)
        go(robot, (4.0, 0.0))
        ends.append(robot.pose() - robot.true_pose)
    spread, expected = np.std(ends, axis=0), np.hypot(4.0 * 0.02, 0.02 * 2.0)
    # The standard deviation of 40 draws is right to 11 %; the limits are at 5 of these.
    assert 0.45 * expected < spread[0] < 1.55 * expected
    assert spread[2] > 0.002
    assert isinstance(robot, Robot)


def test_way_of_a_body_that_stands_against_a_thing_leads_away() -> None:
    start, goal = np.zeros(2), np.array([2.0, 0.0])
    discs = inflate(np.array([[0.5, 0.0, 0.2]]), start, goal, 0.4, 0.3)
    way = find_path(start, goal, discs)
    np.testing.assert_allclose(way[-1], goal)
    corners = np.vstack([start, way])
    assert all(is_clear(*pair, discs * [1, 1, 0.9]) for pair in itertools.pairwise(corners))


def test_hits_of_one_thing_are_one_disc() -> None:
    angles = np.linspace(-0.5, 0.5, 21)
    ranges = np.full(21, np.inf)
    ranges[3:6], ranges[14:17] = 2.0, 3.0
    discs = to_discs(ranges, angles, np.array([1.0, 0.0, np.pi / 2]))
    assert len(discs) == 2
    nearest = np.hypot(discs[:, 0] - 1.0, discs[:, 1]) - discs[:, 2]
    np.testing.assert_allclose(nearest, [2.0, 3.0], atol=0.08)
    assert (discs[:, 2] < 0.3).all()


@pytest.mark.parametrize("goal", [[np.nan, 0.0], [[1.0, 2.0]]])
def test_a_goal_that_cannot_be_is_refused(goal) -> None:
    with pytest.raises(ValueError, match="goal"):
        put().go_to(np.array(goal), speed=1.0, clearance=0.0)


@pytest.mark.parametrize("name", sorted(ROBOT_MODELS))
@pytest.mark.parametrize("gap", [-0.05, 0.0, 0.02])
def test_a_thing_that_is_all_but_touched_holds_nobody(name: str, gap: float) -> None:
    """A circle is wider than the body: a few centimetres of it are no collision."""
    machine = ROBOT_MODELS[name]
    for heading, bearing in itertools.product((-1.5, 0.0, 0.75, 3.0), (0.3, 1.9, 3.4, 5.0)):
        away = machine.body.radius + 0.25 + gap
        disc = np.array([[away, 0.0, 0.25]])
        goal = np.array([away + 2.2 * np.cos(bearing), 2.2 * np.sin(bearing)])
        mover = MotionPlanner(machine.body)
        mover.go_to(goal, speed=1.0, clearance=0.3)
        pose, least = np.array([0.0, 0.0, heading]), np.inf
        for _ in range(round(60.0 / TICK)):
            speed, turn = mover.tick(pose, disc)
            if mover.progress is not WaypointStatus.UNDER_WAY:
                break
            pose = pose + TICK * np.array([speed * np.cos(pose[2]), speed * np.sin(pose[2]), turn])
            least = min(least, np.hypot(pose[0] - away, pose[1]) - 0.25 - machine.body.radius)
        assert mover.progress is WaypointStatus.REACHED, (heading, bearing)
        assert least > min(gap, 0.0) - 0.1


def test_a_robot_that_has_turned_round_often_starts_within_a_turn() -> None:
    """A navigator takes a heading beyond two turns for degrees."""
    x, y, heading = wrap_heading(np.array([1.0, -2.0, 0.5 + 6.0 * np.pi]))
    assert (x, y) == (1.0, -2.0)
    assert heading == pytest.approx(0.5)
