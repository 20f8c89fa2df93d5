"""Record drives as ROS 2 bags; needs ``rosbags``, not ROS.

Decisions use exactly the data of the written messages, so that a replay of the bag repeats them.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from jax import Array

from jaxlangnav.navigator.api import Navigator
from jaxlangnav.robots.kinematic import SimulatedRobot
from jaxlangnav.robots.libraries import load_ros
from jaxlangnav.robots.motion.mover import TICK
from jaxlangnav.robots.robot import NavigationRun
from jaxlangnav.robots.ros2.conversions import (
    MessageBuilder,
    compose,
    detections_of_cloud,
    inverse,
    pose_of,
)
from jaxlangnav.robots.ros2.inbox import Inbox
from jaxlangnav.robots.ros2.robot import RosRobot
from jaxlangnav.robots.ros2.session import Session
from jaxlangnav.robots.ros2.simulation import DETECTION_TICKS


def typestore() -> Any:
    """Load the message types of ROS 2 Kilted; needs ``rosbags``."""
    typesys = load_ros("rosbags.typesys")
    return typesys.get_typestore(typesys.Stores.ROS2_KILTED)


class Loopback:
    """In-process bus to a simulated robot: its odometry and detections, and goals."""

    def __init__(self, simulated: SimulatedRobot) -> None:
        """Connect a robot, whose odometry starts at zero."""
        self.simulated, self.inbox = simulated, Inbox()
        self.origin = simulated.pose()
        self._clock, self._ticks = simulated.seconds, 0

    def now(self) -> float:
        """Return the time, see ``Bus.now``."""
        return self._clock

    def spin(self, seconds: float) -> None:
        """Simulate the robot for some seconds, see ``Bus.spin``."""
        self._clock += seconds
        while self.simulated.seconds + TICK <= self._clock + 1e-6:
            self.simulated.wait(TICK)
            now, self._ticks = self.simulated.seconds, self._ticks + 1
            self.publish("odom", now, compose(inverse(self.origin), self.simulated.pose()))
            detections = self.simulated.detections() if self._ticks % DETECTION_TICKS == 0 else None
            if detections is not None:
                self.publish("detections", now, detections)

    def send_goal(self, goal: np.ndarray, *, speed: float, clearance: float) -> None:
        """Send the robot somewhere, see ``Bus.send_goal``."""
        pose = compose(self.origin, goal)
        facing = float(pose[2])
        self.simulated.go_to(pose[:2], speed=speed, clearance=clearance, facing=facing)

    def publish(self, topic: str, stamp: float, what: Any) -> None:
        """Deliver odometry, a pose f64[3], or detections to the inbox."""
        if topic == "odom":
            self.inbox.add_odometry(stamp, what)
        else:
            self.inbox.add_detections(stamp, what, self.simulated.seconds)


LEAD_SECONDS = 0.3
"""Seconds of odometry before the instruction."""


class RecordedLoopback(Loopback):
    """Loopback that records all messages, and delivers what can be read back from them."""

    def __init__(self, simulated: SimulatedRobot, num_types: int) -> None:
        """Start without messages; ``num_types`` is the number of labels."""
        super().__init__(simulated)
        self._store, self._num_types = typestore(), num_types
        self._builder = MessageBuilder(self._store.types.__getitem__)
        self._messages: list[tuple[str, float, Any]] = []

    def publish(self, topic: str, stamp: float, what: Any) -> None:
        """Record and deliver a message of the robot, see ``Loopback.publish``."""
        if topic == "odom":
            message = self._builder.odometry(what, self._builder.time(stamp))
            what = pose_of(message.pose.pose)
        else:
            message = self._builder.cloud(what, self._builder.time(stamp))
            what = detections_of_cloud(message, self._num_types)
        self._messages.append((topic, stamp, message))
        super().publish(topic, stamp, what)

    def send_goal(self, goal: np.ndarray, *, speed: float, clearance: float) -> None:
        """Send the robot somewhere, see ``Bus.send_goal``."""
        message = self._builder.goal(goal, "odom", self._builder.time(self.now()))
        self._messages.append(("goal_pose", self.now(), message))
        super().send_goal(goal, speed=speed, clearance=clearance)

    def write_text(self, topic: str, text: str) -> None:
        """Record a text message on a topic."""
        self._messages.append((topic, self.now(), self._builder.words(text)))

    def save(self, path: Path) -> None:
        """Write the bag, MCAP, into a new folder."""
        rosbag2, store = load_ros("rosbags.rosbag2"), self._store
        with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
            connections: dict[str, Any] = {}
            for topic, seconds, message in self._messages:
                name = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, name, typestore=store)
                data = store.serialize_cdr(message, name)
                writer.write(connections[topic], round(1e9 * seconds), data)


def write_bag(
    path: Path, simulated: SimulatedRobot, text: str, *, navigator: Navigator, key: Array
) -> NavigationRun:
    """Drive a robot from its start by an instruction, and write all messages into a bag.

    Raises:
        ValueError: the folder exists, or the instruction is refused.
        MissingExtraError: rosbags is not installed.
    """
    if path.exists():
        raise ValueError(f"{path} is there already: remove it or name another folder")
    bus = RecordedLoopback(simulated, len(navigator.type_names))
    bus.spin(LEAD_SECONDS)
    robot = RosRobot(bus, sensor=simulated.sensor, area=simulated.area)

    def tell(status: dict[str, Any]) -> None:
        bus.write_text("navigator_status", json.dumps(status))

    session = Session(navigator, robot, tell, key=key)
    bus.write_text("instruction", text)
    session.say(text, bus.now())
    run = session.go()
    if run is None:
        raise ValueError(f"{text!r} is no task")
    bus.save(path)
    return run
