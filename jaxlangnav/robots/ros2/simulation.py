"""A robot in a place of its own, to try the node on: ``python -m jaxlangnav.robots.ros2 robot``.

It publishes ``odom`` and ``detections`` and takes ``goal_pose``, in real time. It halts by itself
when no goal has come for a while; what it sends can be lost, doubled and late on purpose. Where it
truly is is said on standard output as it ends.
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

from jaxlangnav.messages import default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.robots.kinematic import KinematicRobot, SimulatedRobot
from jaxlangnav.robots.libraries import check_libraries, ros, ros_message
from jaxlangnav.robots.motion.mover import TICK
from jaxlangnav.robots.physics.robot import PhysicsRobot
from jaxlangnav.robots.physics.tags import Gates
from jaxlangnav.robots.ros2.conversions import Scribe, compose, inverse, yaw_of
from jaxlangnav.world.scenario import sample_scenario
from jaxlangnav.world.state import Scenario

_LONGEST = 1.0  # seconds by which a message may be late


class UnrulyChannel:
    """Hands on messages as a bad network does."""

    def __init__(self, share: float, seed: int) -> None:
        """Begin; a share, 0 to 0.3, of messages is lost, as many are doubled, as many late."""
        if not 0.0 <= share <= 0.3:
            raise ValueError(f"a share of {share:g} of messages cannot be lost: give 0 to 0.3")
        self._share = share
        self._random = np.random.default_rng(seed)
        self._under_way: list[tuple[float, Any]] = []

    def put(self, message: Any, now: float) -> None:
        """Send a message at seconds."""
        draw = self._random.uniform() / max(self._share, 1e-9)
        if draw < 1.0:
            return
        late = self._random.uniform(0.0, _LONGEST) if draw > 2.0 and draw < 3.0 else 0.0
        for delay in (0.0, 0.1) if draw < 2.0 else (late,):
            later = now + delay, message
            bisect.insort(self._under_way, later, key=operator.itemgetter(0))

    def take(self, now: float) -> list[Any]:
        """Receive what has come by now, in the order in which it comes."""
        come = []
        while self._under_way and self._under_way[0][0] <= now:
            come.append(self._under_way.pop(0)[1])
        return come


LOOK_EVERY = 4
"""Ticks of 0.1 s from one look to the next."""
_ALONE = 5.0  # seconds without a goal after which the robot halts: whoever sent it may have ended
_HERE, _CLEARANCE = 0.1, 0.3  # metres: a goal so near is to halt; and metres kept from things


class RobotServer:
    """Publishes what a simulated robot reports, and sends it where it is told."""

    def __init__(self, robot: SimulatedRobot, *, share: float = 0.0, seed: int = 0) -> None:
        """Open the topics; ``rclpy.init`` has been called.

        The robot's odometry begins at zero where it stands; faults as ``UnrulyChannel`` has them.
        """
        self.robot, self._origin, self._ticks = robot, robot.pose(), 0
        self._channel, self._last_goal = UnrulyChannel(share, seed), -math.inf
        self._node = ros("rclpy").create_node("simulated_robot")
        self._executor = ros("rclpy.executors").SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._scribe = Scribe(ros_message)
        open_topic = self._node.create_publisher
        self._to_odometry = open_topic(ros_message("nav_msgs/msg/Odometry"), "odom", 10)
        self._to_looks = open_topic(ros_message("sensor_msgs/msg/PointCloud2"), "detections", 10)
        pose_stamped = ros_message("geometry_msgs/msg/PoseStamped")
        self._node.create_subscription(pose_stamped, "goal_pose", self._on_goal, 1)

    def run(self, seconds: float) -> None:
        """Let real seconds pass; infinity: for as long as the process lives."""
        began, before = time.monotonic(), self.robot.seconds
        while (gone := self.robot.seconds - before) < seconds:
            if self.robot.seconds - self._last_goal > _ALONE:
                self.robot.stop()
            self.robot.wait(TICK)
            self._report()
            # A machine that is too slow for real time goes on as fast as it can.
            end = began + gone + TICK
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
        self._channel.put((self._to_odometry, self._scribe.odometry(pose, stamp)), now)
        found = self.robot.detections() if self._ticks % LOOK_EVERY == 0 else None
        if found is not None:
            self._channel.put((self._to_looks, self._scribe.cloud(found, stamp)), now)
        for publisher, message in self._channel.take(now):
            publisher.publish(message)

    def _on_goal(self, message: Any) -> None:
        place, turn = message.pose.position, yaw_of(message.pose.orientation)
        goal = compose(self._origin, np.array([place.x, place.y, turn]))
        self._last_goal = self.robot.seconds
        here = self.robot.pose()
        if np.hypot(*(goal - here)[:2]) < _HERE and abs(goal[2] - here[2]) < _HERE:
            self.robot.stop()
            return
        self.robot.go_to(goal[None, :2], speed=1.0, clearance=_CLEARANCE, facing=float(goal[2]))


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

    See ``draw_start`` and ``switched_on`` for what is refused.
    """
    scenario = draw_start(options)
    with switched_on(options, scenario) as robot:
        server = RobotServer(robot, share=options.faults, seed=options.seed)
        try:
            server.run(math.inf)
        finally:
            x, y, heading = robot.true_pose
            away = float(np.hypot(*(robot.true_pose[:2] - np.asarray(scenario.goal))))
            place = f"{x:.2f} {y:.2f} {math.degrees(heading):.1f}"
            said = f"ended {away:.2f} m from the goal at {place}, {robot.travelled:.2f} m driven"
            print(said, flush=True)
            server.close()


def draw_start(options: RobotOptions) -> Scenario:
    """Draw the place and the start in it, or raise a ValueError of one line."""
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
def switched_on(options: RobotOptions, scenario: Scenario) -> Iterator[SimulatedRobot]:
    """Yield the robot at the start of a place, and close it at last; see ``check_libraries``."""
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
