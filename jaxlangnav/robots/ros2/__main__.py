"""Commands ``python -m jaxlangnav.robots.ros2``: ``navigator``, the node, and a test ``robot``."""

import dataclasses
import math
import signal
import sys
from pathlib import Path
from typing import Literal

import jax
import tyro

from jaxlangnav.inputs.limits import check_minimum
from jaxlangnav.inputs.sanitize import sanitize
from jaxlangnav.messages import default_sensor
from jaxlangnav.navigator.api import Navigator
from jaxlangnav.robots.libraries import load_ros
from jaxlangnav.robots.robot import Ending
from jaxlangnav.robots.ros2.node import RosBus, TagSetup, read_tag_types
from jaxlangnav.robots.ros2.robot import RosRobot
from jaxlangnav.robots.ros2.session import Session
from jaxlangnav.robots.ros2.simulation import RobotOptions, simulate

_SPIN_SECONDS = 0.2  # from one check for utterances to the next


@dataclasses.dataclass(frozen=True, kw_only=True)
class NavigatorOptions:
    """Follow what is said on the topics instruction and utterance."""

    range: float = 3.0
    """Metres that the detector sees."""
    field_of_view: float = 90.0
    """Degrees that it sees, centred on what is ahead."""
    area: tuple[float, float, float, float] = (-15.0, 15.0, -15.0, 15.0)
    """Operating area x_min x_max y_min y_max, metres, in the odometry's frame."""
    look: Literal["cloud", "boxes", "tf"] = "cloud"
    """What detections come as: sensor_msgs/PointCloud2, vision_msgs/Detection3DArray, or what
    apriltag_ros publishes: /tf, beside apriltag_msgs/AprilTagDetectionArray on detections."""
    tags: tuple[str, ...] = ()
    """With tf: what tags are on, a frame and a type each, such as tag36h11:7=hydrant."""
    camera: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """With tf: x, y in metres and heading in degrees of the camera in the base frame."""
    tag_depth: float = 0.0
    """With tf: metres from a tag to the middle of the thing behind it."""
    kept: Path | None = None
    """File for the words of the running task, which a node that is started anew takes up."""
    max_seconds: float = 600.0
    """After which a drive is broken off."""
    patience: float = 60.0
    """Seconds for which a robot that says nothing, odometry neither, is waited for; or inf."""
    seed: int = 0
    tasks: int | None = None
    """End after as many endings; go on for ever by default."""


def navigate(options: NavigatorOptions) -> None:
    """Run the node until it is interrupted; ``ValueError`` for bad options or a silent robot."""
    _validate(options)
    view = math.radians(options.field_of_view)
    sensor = default_sensor(options.range, field_of_view=view, noise=0.1)
    navigator, texts = Navigator.pretrained(), []
    look = options.look
    if look == "tf":
        x, y, degrees = options.camera
        look = TagSetup(
            types=read_tag_types(options.tags, navigator.type_names),
            range=options.range,
            field_of_view=view,
            mount=(x, y, math.radians(degrees)),
            depth=options.tag_depth,
        )
    bus = RosBus(navigator.type_names, texts.append, look=look)

    def report() -> None:
        bus.tell({"status": "waiting_for_odometry"})
        bus.warn(bus.why_silent("odom"))

    try:
        bus.tell({"status": "warming_up"})
        navigator.warm_up()
        bus.tell({"status": "waiting_for_odometry"})
        end = bus.now() + options.patience
        while bus.inbox.track.pose is None:
            bus.spin(_SPIN_SECONDS)
            if bus.now() >= end:
                reason = bus.why_silent("odom")
                raise ValueError(f"no odometry within {options.patience:g} s: {reason}")
        robot = RosRobot(
            bus, sensor=sensor, area=options.area, patience=options.patience, on_silence=report
        )
        key, limit = jax.random.key(options.seed), options.max_seconds
        session = Session(navigator, robot, bus.tell, key=key, max_seconds=limit, path=options.kept)
        bus.say = lambda text: session.say(text, bus.now())
        for text in texts:
            bus.say(text)
        bus.tell({"status": "ready"})
        remaining = math.inf if options.tasks is None else options.tasks
        while remaining > 0:
            run = session.go()
            if run is not None and run.ending is Ending.BLIND:
                bus.warn(bus.why_silent("detections"))
            remaining -= run is not None
            bus.spin(_SPIN_SECONDS)
    finally:
        bus.close()


def _validate(options: NavigatorOptions) -> None:
    """Validate the options before anything is compiled."""
    x_min, x_max, y_min, y_max = options.area
    if not (x_min < x_max and y_min < y_max and all(map(math.isfinite, options.area))):
        raise ValueError(
            f"area is {' '.join(f'{edge:g}' for edge in options.area)}, but must be x_min x_max "
            "y_min y_max, each pair of finite numbers and rising"
        )
    for name in ("patience", "max_seconds"):
        value = getattr(options, name)
        if not value > 0.0:
            raise ValueError(f"{name.replace('_', '-')} is {value:g}, but must be more than 0 s")
    for name in ("tags", "camera", "tag_depth"):
        if options.look != "tf" and getattr(options, name) != getattr(NavigatorOptions, name):
            raise ValueError(f"--{name.replace('_', '-')} is used with --look tf only: add that")
    check_minimum(1, tasks=1 if options.tasks is None else options.tasks)


def main() -> int:
    """Run one of the two commands; exit code 0: done or interrupted, 2: bad input."""
    choice = tyro.extras.subcommand_type_from_defaults(
        {"navigator": NavigatorOptions(), "robot": RobotOptions()}
    )
    options = tyro.cli(choice, prog="python -m jaxlangnav.robots.ros2")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        rclpy = load_ros("rclpy")
        # Python handles signals, so that the robot can still be stopped.
        rclpy.init(signal_handler_options=load_ros("rclpy.signals").SignalHandlerOptions.NO)
        try:
            navigate(options) if isinstance(options, NavigatorOptions) else simulate(options)
        finally:
            rclpy.try_shutdown()
    except KeyboardInterrupt:
        return 0
    except ValueError as error:
        print(sanitize(str(error)), file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
