"""Bags of ROS 2: drives are written into them; needs ``rosbags``, not ROS.

Decisions are made by what the messages say, to the last digit, so that a bag replays to the same
ones.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from jax import Array

from jaxlangnav.navigator.api import Navigator
from jaxlangnav.robots.kinematic import SimulatedRobot
from jaxlangnav.robots.libraries import ros
from jaxlangnav.robots.motion.mover import TICK
from jaxlangnav.robots.robot import NavigationRun
from jaxlangnav.robots.ros2.conversions import (
    Scribe,
    compose,
    detections_of_cloud,
    inverse,
    pose_of,
)
from jaxlangnav.robots.ros2.inbox import Inbox
from jaxlangnav.robots.ros2.robot import RosRobot
from jaxlangnav.robots.ros2.session import Session
from jaxlangnav.robots.ros2.simulation import LOOK_EVERY

TEXTS = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id"
    ),
    "vision_msgs/msg/Detection3DArray": (
        "std_msgs/Header header\nvision_msgs/Detection3D[] detections"
    ),
    "apriltag_msgs/msg/Point": "float64 x\nfloat64 y",
    "apriltag_msgs/msg/AprilTagDetection": (
        "string family\nint32 id\nint32 hamming\nfloat32 goodness\nfloat32 decision_margin\n"
        "apriltag_msgs/Point centre\napriltag_msgs/Point[4] corners\nfloat64[9] homography"
    ),
    "apriltag_msgs/msg/AprilTagDetectionArray": (
        "std_msgs/Header header\napriltag_msgs/AprilTagDetection[] detections"
    ),
    "nav2_msgs/action/NavigateToPose_Goal": (
        "geometry_msgs/PoseStamped pose\nstring behavior_tree"
    ),
}
"""Types of messages that the wheels lack: vision_msgs 4, apriltag_msgs 2 and nav2_msgs."""


def typestore() -> Any:
    """Build the types of ROS 2 Kilted with ``TEXTS`` besides; it needs ``rosbags``."""
    systems = ros("rosbags.typesys")
    store = systems.get_typestore(systems.Stores.ROS2_KILTED)
    types: dict[str, Any] = {}
    for name, text in TEXTS.items():
        types.update(systems.get_types_from_msg(text, name))
    store.register(types)
    return store


class Loopback:
    """Carries odometry and looks from a robot, and goals to it."""

    def __init__(self, simulated: SimulatedRobot) -> None:
        """Begin; the robot's odometry begins at zero where it stands, at the first spin."""
        self.simulated, self.inbox = simulated, Inbox()
        self.origin = simulated.pose()
        self._clock, self._ticks = simulated.seconds, 0

    def now(self) -> float:
        """Tell the time, see ``Bus.now``."""
        return self._clock

    def spin(self, seconds: float) -> None:
        """Let the robot's time pass, see ``Bus.spin``."""
        self._clock += seconds
        while self.simulated.seconds + TICK <= self._clock + 1e-6:
            self.simulated.wait(TICK)
            now, self._ticks = self.simulated.seconds, self._ticks + 1
            self.publish("odom", now, compose(inverse(self.origin), self.simulated.pose()))
            found = self.simulated.detections() if self._ticks % LOOK_EVERY == 0 else None
            if found is not None:
                self.publish("detections", now, found)

    def send_goal(self, goal: np.ndarray, *, speed: float, clearance: float) -> None:
        """Send the robot somewhere, see ``Bus.send_goal``."""
        place = compose(self.origin, goal)
        facing = float(place[2])
        self.simulated.go_to(place[None, :2], speed=speed, clearance=clearance, facing=facing)

    def publish(self, topic: str, stamp: float, what: Any) -> None:
        """Carry what the robot says, a pose f64[3] of its odometry or a look, at once."""
        if topic == "odom":
            self.inbox.add_odometry(stamp, what)
        else:
            self.inbox.add_look(stamp, what, self.simulated.seconds)


HEAD_START = 0.3
"""Seconds of odometry before a person says anything."""


class RecordedLoopback(Loopback):
    """Writes down what is said either way, and hands it on as it can be read again."""

    def __init__(self, simulated: SimulatedRobot, num_types: int) -> None:
        """Begin with nothing; there are so many labels."""
        super().__init__(simulated)
        self._store, self._num_types = typestore(), num_types
        self._scribe = Scribe(self._store.types.__getitem__)
        self._written: list[tuple[str, float, Any]] = []

    def publish(self, topic: str, stamp: float, what: Any) -> None:
        """Carry what the robot says, see ``Loopback.publish``."""
        if topic == "odom":
            message = self._scribe.odometry(what, self._scribe.time(stamp))
            what = pose_of(message)
        else:
            message = self._scribe.cloud(what, self._scribe.time(stamp))
            what = detections_of_cloud(message, self._num_types)
        self._written.append((topic, stamp, message))
        super().publish(topic, stamp, what)

    def send_goal(self, goal: np.ndarray, *, speed: float, clearance: float) -> None:
        """Send the robot somewhere, see ``Bus.send_goal``."""
        message = self._scribe.goal(goal, "odom", self._scribe.time(self.now()))
        self._written.append(("goal_pose", self.now(), message))
        super().send_goal(goal, speed=speed, clearance=clearance)

    def write_words(self, topic: str, text: str) -> None:
        """Write down what is said to the robot, or told of it, on a topic."""
        self._written.append((topic, self.now(), self._scribe.words(text)))

    def save(self, path: Path) -> None:
        """Write the bag, MCAP, into a folder that is not there yet, or raise a ValueError."""
        if path.exists():
            raise ValueError(f"{path} is there already: remove it or name another folder")
        bags, store = ros("rosbags.rosbag2"), self._store
        with bags.Writer(path, version=9, storage_plugin=bags.StoragePlugin.MCAP) as writer:
            lines: dict[str, Any] = {}
            for topic, seconds, message in self._written:
                name = message.__msgtype__
                if topic not in lines:
                    lines[topic] = writer.add_connection(topic, name, typestore=store)
                raw = store.serialize_cdr(message, name)
                writer.write(lines[topic], round(1e9 * seconds), raw)


def write_bag(
    path: Path, simulated: SimulatedRobot, text: str, *, navigator: Navigator, key: Array
) -> NavigationRun:
    """Let a robot, at its start, follow a sentence; write what is said either way into a bag.

    Raises:
        ValueError: the folder is there already, or the sentence is refused.
        MissingExtraError: rosbags is not installed.
    """
    bus = RecordedLoopback(simulated, len(navigator.type_names))
    bus.spin(HEAD_START)
    robot = RosRobot(bus, sensor=simulated.sensor, area=simulated.area)

    def tell(status: dict[str, Any]) -> None:
        bus.write_words("navigator_status", json.dumps(status))

    talk = Session(navigator, robot, tell, key=key)
    bus.write_words("instruction", text)
    talk.say(text, bus.now())
    ended = talk.go()
    if ended is None:
        raise ValueError(f"{text!r} is no task")
    bus.save(path)
    return ended
