"""Simulated robot to test the node: ``python -m jaxlangnav.robots.ros2 robot``.

It publishes ``odom`` and ``detections`` and takes ``goal_pose``, in real time. It stops by itself
when no goal has arrived for a while; messages can be lost, doubled and delayed on purpose. Its
ground-truth pose is printed at the end.
"""

import bisect
import contextlib
import dataclasses
import math
import operator
import time
from collections.abc import Iterator
from typing import Any, Literal

import jax
import numpy as np

from jaxlangnav.inputs.limits import bounded
from jaxlangnav.messages import default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.robots.kinematic import KinematicRobot, SimulatedRobot
from jaxlangnav.robots.libraries import check_libraries, load_ros, ros_class
from jaxlangnav.robots.motion.mover import TICK
from jaxlangnav.robots.physics.robot import PhysicsRobot
from jaxlangnav.robots.physics.tags import Gates
from jaxlangnav.robots.ros2.conversions import MessageBuilder, compose, inverse, pose_of
from jaxlangnav.robots.ros2.node import guarded
from jaxlangnav.world.scenario import sample_scenario
from jaxlangnav.world.state import Scenario

_MAX_DELAY = 1.0  # seconds


class LossyChannel:
    """Message channel that loses, doubles and delays messages."""

    def __init__(self, rate: float, seed: int) -> None:
        """Set the rate, 0 to 0.3 or ``ValueError``, of lost, doubled and delayed messages, each."""
        self._rate = bounded(rate, 0.0, 0.3, "faults", "give the share of messages that are lost")
        self._random = np.random.default_rng(seed)
        self._in_transit: list[tuple[float, Any]] = []

    def put(self, message: Any, now: float) -> None:
        """Send a message at a time in seconds."""
        draw = self._random.uniform() / max(self._rate, 1e-9)
        if draw < 1.0:
            return
        late = self._random.uniform(0.0, _MAX_DELAY) if draw > 2.0 and draw < 3.0 else 0.0
        for delay in (0.0, 0.1) if draw < 2.0 else (late,):
            entry = now + delay, message
            bisect.insort(self._in_transit, entry, key=operator.itemgetter(0))

    def take(self, now: float) -> list[Any]:
        """Receive the messages due by now, in order of arrival."""
        count = bisect.bisect_right(self._in_transit, now, key=operator.itemgetter(0))
        arrived, self._in_transit = self._in_transit[:count], self._in_transit[count:]
        return [message for _, message in arrived]


DETECTION_TICKS = 4  # ticks of 0.1 s from one detector query to the next
_GOAL_TIMEOUT = 5.0  # seconds without a goal: then the robot stops, as the sender may have ended
_STOP_TOLERANCE, _CLEARANCE = 0.1, 0.3  # metres to a goal that means stop; to obstacles


class RobotServer:
    """ROS 2 node of a simulated robot: publishes its sensors, and takes goals."""

    def __init__(self, robot: SimulatedRobot, *, rate: float = 0.0, seed: int = 0) -> None:
        """Open the topics; ``rclpy.init`` has been called.

        The robot's odometry starts at zero; ``rate`` is that of ``LossyChannel``.
        """
        self.robot, self._origin, self._ticks = robot, robot.pose(), 0
        self._channel, self._last_goal = LossyChannel(rate, seed), -math.inf
        self._node = load_ros("rclpy").create_node("simulated_robot")
        self._executor = load_ros("rclpy.executors").SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._builder = MessageBuilder(ros_class)
        publish = self._node.create_publisher
        self._odometry = publish(ros_class("nav_msgs/msg/Odometry"), "odom", 10)
        self._detections = publish(ros_class("sensor_msgs/msg/PointCloud2"), "detections", 10)
        pose_stamped = ros_class("geometry_msgs/msg/PoseStamped")
        on_goal = guarded(self._on_goal, self._node.get_logger().warning)
        self._node.create_subscription(pose_stamped, "goal_pose", on_goal, 1)

    def run(self, seconds: float) -> None:
        """Run in real time for some seconds; infinity: until the process ends."""
        start, start_seconds = time.monotonic(), self.robot.seconds
        while (elapsed := self.robot.seconds - start_seconds) < seconds:
            if self.robot.seconds - self._last_goal > _GOAL_TIMEOUT:
                self.robot.stop()
            self.robot.wait(TICK)
            self._report()
            # A machine too slow for real time runs as fast as possible.
            end = start + elapsed + TICK
            self._executor.spin_once(timeout_sec=0.0)
            while (left := end - time.monotonic()) > 0.0:
                self._executor.spin_once(timeout_sec=left)

    def close(self) -> None:
        """Close the topics."""
        self._executor.shutdown()
        self._node.destroy_node()

    def _report(self) -> None:
        self._ticks += 1
        now, stamp = self.robot.seconds, self._node.get_clock().now().to_msg()
        pose = compose(inverse(self._origin), self.robot.pose())
        self._channel.put((self._odometry, self._builder.odometry(pose, stamp)), now)
        detections = self.robot.detections() if self._ticks % DETECTION_TICKS == 0 else None
        if detections is not None:
            self._channel.put((self._detections, self._builder.cloud(detections, stamp)), now)
        for publisher, message in self._channel.take(now):
            publisher.publish(message)

    def _on_goal(self, message: Any) -> None:
        goal = compose(self._origin, pose_of(message.pose))
        self._last_goal = self.robot.seconds
        offset = compose(inverse(self.robot.pose()), goal)
        if np.hypot(*offset[:2]) < _STOP_TOLERANCE and abs(offset[2]) < _STOP_TOLERANCE:
            self.robot.stop()
            return
        self.robot.go_to(goal[:2], speed=1.0, clearance=_CLEARANCE, facing=float(goal[2]))


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
    """Run the simulated robot until interrupted, then print its ground-truth pose.

    Errors are those of ``draw_start`` and ``open_robot``.
    """
    scenario = draw_start(options)
    with open_robot(options, scenario) as robot:
        server = RobotServer(robot, rate=options.faults, seed=options.seed)
        try:
            server.run(math.inf)
        finally:
            x, y, heading = robot.true_pose
            distance = float(np.hypot(*(robot.true_pose[:2] - np.asarray(scenario.goal))))
            pose = f"{x:.2f} {y:.2f} {math.degrees(heading):.1f}"
            text = f"ended {distance:.2f} m from the goal at {pose}, {robot.travelled:.2f} m driven"
            print(text, flush=True)
            server.close()


def draw_start(options: RobotOptions) -> Scenario:
    """Draw a scenario and set the robot's start, or raise a ValueError of one line."""
    key = jax.random.key(options.seed)
    scenario = sample_scenario(key, template=options.world, relation=options.relation)
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
def open_robot(options: RobotOptions, scenario: Scenario) -> Iterator[SimulatedRobot]:
    """Yield the robot at the start of a scenario, and close it; see ``check_libraries``."""
    view = math.radians(options.field_of_view)
    sensor = default_sensor(options.range, field_of_view=view)
    if options.robot == "cart":
        yield KinematicRobot(scenario, seed=options.seed, sensor=sensor)
        return
    check_libraries()
    gates = Gates(range=options.range, field_of_view=view)
    robot = PhysicsRobot(options.robot, scenario, seed=options.seed, gates=gates)
    with contextlib.closing(robot):
        yield robot
