"""A drive of a simulated robot as a bag: what it said, what it was told, where it was sent.

Needs ``rosbags``, not ROS. Decisions are made by what the messages say, to the last digit, so that
the bag replays to the same ones.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from jax import Array

from jaxlangnav.agent import Navigator
from jaxlangnav.robots.libraries import ros
from jaxlangnav.robots.motion.mover import TICK
from jaxlangnav.robots.robot import Drive
from jaxlangnav.robots.ros2.bags import typestore
from jaxlangnav.robots.ros2.conversions import (
    POINT,
    compose,
    detections_of_cloud,
    inverse,
    pose_of,
    quaternion_of,
    to_cloud,
)
from jaxlangnav.robots.ros2.inbox import Inbox
from jaxlangnav.robots.ros2.robot import RosRobot
from jaxlangnav.robots.ros2.serve import LOOK_EVERY
from jaxlangnav.robots.ros2.session import Session
from jaxlangnav.robots.simulated import SimulatedRobot


class Loopback:
    """Carries odometry and looks from a robot, and goals to it."""

    def __init__(self, simulated: SimulatedRobot) -> None:
        """Begin; the first odometry comes at the first spin.

        Args:
            simulated: the robot; its odometry begins at zero where it now stands.
        """
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
            self._tick()

    def send_goal(self, goal: np.ndarray, *, speed: float, clearance: float) -> None:
        """Send the robot somewhere, see ``Bus.send_goal``."""
        place = compose(self.origin, goal)
        facing = float(place[2])
        self.simulated.go_to(place[None, :2], speed=speed, clearance=clearance, facing=facing)

    def publish(self, topic: str, stamp: float, what: Any) -> None:
        """Carry what the robot says: here it comes at once.

        Args:
            topic: "odom" or "detections".
            stamp: seconds of the robot's clock.
            what: a pose f64[3], odometry frame, or detections.
        """
        if topic == "odom":
            self.inbox.add_odometry(stamp, what)
        else:
            self.inbox.add_look(stamp, what, self.simulated.seconds)

    def _tick(self) -> None:
        self.simulated.wait(TICK)
        now, self._ticks = self.simulated.seconds, self._ticks + 1
        self.publish("odom", now, compose(inverse(self.origin), self.simulated.pose()))
        found = self.simulated.detections() if self._ticks % LOOK_EVERY == 0 else None
        if found is not None:
            self.publish("detections", now, found)


HEAD_START = 0.3
"""Seconds of odometry before a person says anything."""


class Scribe:
    """Builds messages of a type store."""

    def __init__(self) -> None:
        """Load the types."""
        self.store = typestore()
        self._types = self.store.types

    def odometry(self, pose: np.ndarray, seconds: float) -> Any:
        """Build a nav_msgs/Odometry of a pose f64[3], odometry frame."""
        types, unknown = self._types, np.zeros(36)
        zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
        twist = types["geometry_msgs/msg/Twist"](linear=zero, angular=zero)
        there = self._pose(pose)
        return types["nav_msgs/msg/Odometry"](
            header=self.header("odom", seconds),
            child_frame_id="base_link",
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=there, covariance=unknown),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=unknown),
        )

    def cloud(self, found: Any, seconds: float) -> Any:
        """Build a sensor_msgs/PointCloud2 of detections."""
        field = self._types["sensor_msgs/msg/PointField"]
        fields = [
            field(name=name, offset=4 * place, datatype=6 if name == "label" else 7, count=1)
            for place, name in enumerate(POINT.names or ())
        ]
        return self._types["sensor_msgs/msg/PointCloud2"](
            header=self.header("base_link", seconds),
            height=1,
            width=len(found),
            fields=fields,
            is_bigendian=False,
            point_step=POINT.itemsize,
            row_step=POINT.itemsize * len(found),
            data=np.frombuffer(to_cloud(found), np.uint8),
            is_dense=True,
        )

    def goal(self, goal: np.ndarray, seconds: float) -> Any:
        """Build a geometry_msgs/PoseStamped of a pose f64[3], odometry frame."""
        stamped = self._types["geometry_msgs/msg/PoseStamped"]
        return stamped(header=self.header("odom", seconds), pose=self._pose(goal))

    def words(self, text: str) -> Any:
        """Build a std_msgs/String."""
        return self._types["std_msgs/msg/String"](data=text)

    def header(self, frame: str, seconds: float) -> Any:
        """Build a std_msgs/Header."""
        whole, rest = divmod(round(1e9 * seconds), 10**9)
        stamp = self._types["builtin_interfaces/msg/Time"](sec=whole, nanosec=rest)
        return self._types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)

    def _pose(self, pose: np.ndarray) -> Any:
        x, y, yaw = map(float, pose)
        turn = self._types["geometry_msgs/msg/Quaternion"](*quaternion_of(yaw))
        place = self._types["geometry_msgs/msg/Point"](x=x, y=y, z=0.0)
        return self._types["geometry_msgs/msg/Pose"](position=place, orientation=turn)


class RecordedLoopback(Loopback):
    """Writes down what is said either way, and hands it on as it can be read again."""

    def __init__(self, simulated: SimulatedRobot, num_types: int) -> None:
        """Begin with nothing.

        Args:
            simulated: the robot.
            num_types: labels that there are.
        """
        super().__init__(simulated)
        self._scribe, self._num_types = Scribe(), num_types
        self._written: list[tuple[str, float, Any]] = []

    def publish(self, topic: str, stamp: float, what: Any) -> None:
        """Carry what the robot says, see ``Loopback.publish``."""
        if topic == "odom":
            message = self._scribe.odometry(what, stamp)
            what = pose_of(message)
        else:
            message = self._scribe.cloud(what, stamp)
            what = detections_of_cloud(message, self._num_types)
        self._written.append((topic, stamp, message))
        super().publish(topic, stamp, what)

    def send_goal(self, goal: np.ndarray, *, speed: float, clearance: float) -> None:
        """Send the robot somewhere, see ``Bus.send_goal``."""
        self._written.append(("goal_pose", self.now(), self._scribe.goal(goal, self.now())))
        super().send_goal(goal, speed=speed, clearance=clearance)

    def write_words(self, topic: str, text: str) -> None:
        """Write down what is said to the robot, or told of it.

        Args:
            topic: such as "instruction".
            text: the words.
        """
        self._written.append((topic, self.now(), self._scribe.words(text)))

    def save(self, path: Path) -> None:
        """Write the bag, MCAP.

        Args:
            path: folder that is not there yet.

        Raises:
            ValueError: it is there.
        """
        if path.exists():
            raise ValueError(f"{path} is there already: remove it or name another folder")
        bags, store = ros("rosbags.rosbag2"), self._scribe.store
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
) -> Drive:
    """Let a robot follow a sentence and write what is said either way into a bag.

    Args:
        path: folder that is not there yet.
        simulated: the robot, at its start.
        text: the sentence.
        navigator: what decides.
        key: random key of the decisions.

    Returns:
        The drive.

    Raises:
        ValueError: the folder is there, or the sentence is refused.
        MissingExtraError: rosbags is not installed.
    """
    bus = RecordedLoopback(simulated, len(navigator.type_names))
    bus.spin(HEAD_START)
    robot = RosRobot(bus, sensor=simulated.sensor, area=simulated.area)
    talk = Session(
        navigator,
        robot,
        lambda status: bus.write_words("navigator_status", json.dumps(status)),
        key=key,
    )
    bus.write_words("instruction", text)
    talk.say(text, bus.now())
    ended = talk.go()
    if ended is None:
        raise ValueError(f"{text!r} is no task")
    bus.save(path)
    return ended
