"""``python -m jaxlangnav.robots.ros2 navigator`` is the node, ``robot`` one to try it on."""

import dataclasses
import math
import signal
import sys
from pathlib import Path
from typing import Literal

import jax
import numpy as np
import tyro

from jaxlangnav.agent import Navigator
from jaxlangnav.messages import default_sensor
from jaxlangnav.plain_text import printable
from jaxlangnav.pytree import replace
from jaxlangnav.robots.kinematic import KinematicRobot
from jaxlangnav.robots.ros2.libraries import ros
from jaxlangnav.robots.ros2.node import RosBus
from jaxlangnav.robots.ros2.robot import RosRobot
from jaxlangnav.robots.ros2.serve import RobotServer
from jaxlangnav.robots.ros2.session import Session
from jaxlangnav.world.scenario import sample_scenario

_WAIT = 0.2
"""Seconds between two questions whether anything has been said."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class NavigatorOptions:
    """Follow what is said on the topics instruction and utterance."""

    range: float = 3.0
    """Metres that the detector sees."""
    field_of_view: float = 90.0
    """Degrees that it sees, centred on what is ahead."""
    area: tuple[float, float, float, float] = (-15.0, 15.0, -15.0, 15.0)
    """Operating area x_min x_max y_min y_max, metres, in the odometry's frame."""
    look: Literal["cloud", "boxes"] = "cloud"
    """What detections come as: sensor_msgs/PointCloud2 or vision_msgs/Detection3DArray."""
    kept: Path | None = None
    """File for the words of the running task, which a node that is started anew takes up."""
    max_seconds: float = 600.0
    """After which a drive is broken off."""
    seed: int = 0
    tasks: int | None = None
    """End after as many endings; go on for ever by default."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotOptions:
    """Drive a simulated cart among things of its own behind topics."""

    world: str = "1H1C"
    """Template of the place."""
    relation: str = "behind"
    range: float = 3.0
    """Metres that its detector sees."""
    field_of_view: float = 90.0
    """Degrees that it sees."""
    faults: float = 0.0
    """Share of messages that are lost, doubled and late, each."""
    seed: int = 0


def navigate(options: NavigatorOptions) -> None:
    """Run the node until it is ended.

    Args:
        options: see ``NavigatorOptions``.
    """
    sensor = default_sensor(
        options.range, field_of_view=math.radians(options.field_of_view), noise=0.1
    )
    navigator, said = Navigator.pretrained(), []
    bus = RosBus(navigator.type_names, said.append, look=options.look)
    try:
        bus.tell({"status": "warming_up"})
        navigator.warm_up()
        bus.tell({"status": "waiting_for_odometry"})
        while bus.inbox.track.pose is None:
            bus.spin(_WAIT)
        robot = RosRobot(bus, sensor=sensor, area=options.area)
        session = Session(
            navigator,
            robot,
            bus.tell,
            key=jax.random.key(options.seed),
            max_seconds=options.max_seconds,
            kept=options.kept,
        )
        bus.say = lambda text: session.say(text, bus.now())
        for text in said:
            bus.say(text)
        bus.tell({"status": "ready"})
        left = math.inf if options.tasks is None else options.tasks
        while left > 0:
            left -= session.go() is not None
            bus.spin(_WAIT)
    finally:
        bus.close()


def simulate(options: RobotOptions) -> None:
    """Run the simulated robot until it is ended, and say at last where it truly is.

    Args:
        options: see ``RobotOptions``.
    """
    scenario = sample_scenario(
        jax.random.key(options.seed), template=options.world, relation=options.relation
    )
    view = math.radians(options.field_of_view)
    sensor = replace(default_sensor(options.range), field_of_view=np.float32(view))
    robot = KinematicRobot(scenario, seed=options.seed, sensor=sensor)
    server = RobotServer(robot, share=options.faults, seed=options.seed)
    try:
        server.run(math.inf)
    finally:
        server.close()
        away = float(np.hypot(*(robot.true_pose[:2] - np.asarray(scenario.goal))))
        print(f"ended {away:.2f} m from the goal, {robot.travelled:.2f} m driven", flush=True)


def main() -> int:
    """Run one of the two.

    Returns:
        The exit code: 0 done or ended by a signal, 2 bad input, said in one line.
    """
    choice = tyro.extras.subcommand_type_from_defaults(
        {"navigator": NavigatorOptions(), "robot": RobotOptions()}
    )
    options = tyro.cli(choice, prog="python -m jaxlangnav.robots.ros2")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        rclpy = ros("rclpy")
        # Python's own handling of signals: so the robot can still be told to halt.
        handling = ros("rclpy.signals").SignalHandlerOptions.NO
        rclpy.init(signal_handler_options=handling)
        try:
            navigate(options) if isinstance(options, NavigatorOptions) else simulate(options)
        finally:
            rclpy.try_shutdown()
    except KeyboardInterrupt:
        return 0
    except ValueError as error:
        print(printable(str(error)), file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
