"""A robot in a place of its own, to try the node on: ``python -m jaxlangnav.robots.ros2 robot``.

A cart without physics, or the paper's Husky and wheelchair in MuJoCo: wheels slip, a camera
renders, tags are found in its pictures. Only what a real robot publishes leaves the process; where
it truly is is said on standard output as it ends, for whoever judges the run.
"""

import contextlib
import dataclasses
import math
from collections.abc import Iterator
from typing import Literal

import jax
import numpy as np

from jaxlangnav.messages import default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.robots.kinematic import KinematicRobot
from jaxlangnav.robots.libraries import check_libraries
from jaxlangnav.robots.perception.figures import as_told
from jaxlangnav.robots.perception.tags import Gates
from jaxlangnav.robots.physics.robot import PhysicsRobot
from jaxlangnav.robots.ros2.serve import RobotServer
from jaxlangnav.robots.simulated import SimulatedRobot
from jaxlangnav.world.scenario import sample_scenario
from jaxlangnav.world.state import Scenario


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotOptions:
    """Drive a simulated robot among things of its own behind topics."""

    robot: Literal["cart", "husky", "wheelchair"] = "cart"
    """A cart without physics; or one of the paper's in MuJoCo, with a rendered camera and tags."""
    world: str = "1H1C"
    """Template of the place."""
    relation: str = "behind"
    range: float = 3.0
    """Metres that its detector sees."""
    field_of_view: float = 90.0
    """Degrees that it sees."""
    start: tuple[float, float, float] | None = None
    """x, y in metres and heading in degrees at which it is switched on, such as those at which a
    former one ended: its odometry begins at zero there. By default the place's own start."""
    faults: float = 0.0
    """Share of messages that are lost, doubled and late, each."""
    seed: int = 0


def simulate(options: RobotOptions) -> None:
    """Run the simulated robot until it is ended, and say at last where it truly is.

    Args:
        options: see ``RobotOptions``.

    Raises:
        ValueError: no such place, or the robot cannot be put there; one line.
        MissingExtraError: a library of the extra ``robot`` is not installed.
        MissingSystemLibraryError: rendering off screen does not work.
    """
    scenario = draw_start(options)
    with switched_on(options, scenario) as robot, contextlib.ExitStack() as stack:
        server = RobotServer(robot, share=options.faults, seed=options.seed)
        stack.callback(server.close)
        try:
            server.run(math.inf)
        finally:
            x, y, heading = robot.true_pose
            away = float(np.hypot(*(robot.true_pose[:2] - np.asarray(scenario.goal))))
            place = f"{x:.2f} {y:.2f} {math.degrees(heading):.1f}"
            print(
                f"ended {away:.2f} m from the goal at {place}, {robot.travelled:.2f} m driven",
                flush=True,
            )


def draw_start(options: RobotOptions) -> Scenario:
    """Draw the place, and where in it the robot is switched on.

    Args:
        options: template, relation, seed and start.

    Returns:
        The place.

    Raises:
        ValueError: no such place, or the start is not in it; one line.
    """
    scenario = sample_scenario(
        jax.random.key(options.seed), template=options.world, relation=options.relation
    )
    if not bool(scenario.is_valid):
        raise ValueError(f"seed {options.seed} draws no {options.world}: take another --seed")
    if options.start is None:
        return scenario
    x, y, degrees = options.start
    x_min, x_max, y_min, y_max = np.asarray(scenario.area).tolist()
    if not (x_min <= x <= x_max and y_min <= y <= y_max and math.isfinite(degrees)):
        raise ValueError(
            f"start {x:g} {y:g} {degrees:g} is not in the place, x {x_min:.1f} to {x_max:.1f} and "
            f"y {y_min:.1f} to {y_max:.1f} metres"
        )
    return replace(scenario, start=np.array([x, y, math.radians(degrees)], np.float32))


@contextlib.contextmanager
def switched_on(options: RobotOptions, scenario: Scenario) -> Iterator[SimulatedRobot]:
    """Put the robot at the start of a place, and close it at last.

    Args:
        options: which robot, and what its detector sees.
        scenario: the place.

    Yields:
        The robot.

    Raises:
        MissingExtraError: a library of the extra ``robot`` is not installed.
        MissingSystemLibraryError: rendering off screen does not work.
    """
    view = math.radians(options.field_of_view)
    sensor = default_sensor(options.range, field_of_view=view)
    if options.robot == "cart":
        yield KinematicRobot(scenario, seed=options.seed, sensor=sensor)
        return
    check_libraries()
    gates = Gates(range=options.range, field_of_view=view)
    told, seed = as_told(gates), options.seed
    robot = PhysicsRobot(options.robot, scenario, seed=seed, gates=gates, sensor=told)
    try:
        yield robot
    finally:
        robot.close()
